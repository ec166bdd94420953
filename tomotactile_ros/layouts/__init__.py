"""What a sensor is: the outline of its sheet, its electrodes, the cells of its image."""
