"""The sensor as it is: rows in time, real channels, uneven sheets, layouts without a grid, crowds.

`parts` makes frames, most of them from what the electrodes see by the reference model
(`bench.reference_data`); `trial` scores any reconstruction on them, `tables` says what came out.
"""
