"""The sensor as it is: rows in time, real channels, uneven sheets, layouts without a grid, crowds.

`states` has what the electrodes see of many presses, by the reference model; the modules of the parts
make frames of it, `trial` scores any reconstruction on them, `tables` says what came out.
"""
