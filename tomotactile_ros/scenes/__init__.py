"""What happens to a sensor: what presses on it and how, and what is wrong with its readings."""
