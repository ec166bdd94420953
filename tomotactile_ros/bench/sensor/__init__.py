"""The sensor as it is: rows in time, real channels, uneven sheets, layouts without a grid, crowds.

`parts` makes frames, most of them from what the electrodes see by the reference model
(`bench.reference_data`); `trial` scores any reconstruction on them.
"""

TITLES = {
    "time": "Time: touches that begin, end or move while rows are scanned",
    "channels": "Channels and wiring",
    "sheets": "Sheets",
    "layouts": "Layouts",
    "crowd": "Crowd: the strongest with ten times the force of the weakest",
    "wide": "Wide contacts",
    "wide-channels": "Wide contacts on channels that nobody knows",
}
