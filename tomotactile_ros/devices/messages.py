"""Constants and layouts of the wire protocol's packets.

Made from docs/protocol.yaml by `make protocol`; changes belong there.
"""

from struct import Struct

VERSIONS = (1, 2)

MAX_PACKET = 4096  # longest packet before COBS, with its CRC-32, bytes
CRC_SIZE = 4  # bytes of the CRC-32 behind the last field
NO_READING = 0xFFFF  # a reading that is none (0x0000 on the line)
HIGHEST_READING = 0xFFFE  # largest reading
NO_ADDRESS = 0  # a device that has its line to itself; a packet for it
ALL_ADDRESSES = 255  # a command that all obey and none answers
OWN_ORDER = 0  # scan: the device's own order, each electrode in turn

IDENTIFY = 0x01
START = 0x02
STOP = 0x03
SET_RATE = 0x04
SET_SCAN = 0x05
KEEP_ALIVE = 0x06
ROW = 0x10
IDENTITY = 0x11
ACK = 0x12
ERROR = 0x13
STATUS = 0x14

UNKNOWN_COMMAND = 1
BAD_VALUE = 2
UNSUPPORTED_VERSION = 3
HARDWARE_FAULT = 4

# Fields of fixed size, from the type on; None in FIELDS: 0, and ignored
HEADS = {
    (IDENTIFY, 1): Struct("<BBH"),
    (IDENTIFY, 2): Struct("<BBHHBB"),
    (START, 1): Struct("<BBH"),
    (START, 2): Struct("<BBHHBBI"),
    (STOP, 1): Struct("<BBH"),
    (STOP, 2): Struct("<BBHHBB"),
    (SET_RATE, 1): Struct("<BBHf"),
    (SET_RATE, 2): Struct("<BBHHBBf"),
    (SET_SCAN, 2): Struct("<BBHHBB"),
    (KEEP_ALIVE, 2): Struct("<BBHHBB"),
    (ROW, 1): Struct("<BBHHHIIQffH"),
    (ROW, 2): Struct("<BBHHBBIIQffHHHH"),
    (IDENTITY, 1): Struct("<BBHHHBBffIf"),
    (IDENTITY, 2): Struct("<BBHHBBHHIffffI"),
    (ACK, 1): Struct("<BBHBBf"),
    (ACK, 2): Struct("<BBHBBBBfIH"),
    (ERROR, 1): Struct("<BBHBB"),
    (ERROR, 2): Struct("<BBHBBBB"),
    (STATUS, 2): Struct("<BBHBBBBIfQII"),
}
FIELDS = {
    (IDENTIFY, 1): ("tag",),
    (IDENTIFY, 2): ("tag", None, "address", None),
    (START, 1): ("tag",),
    (START, 2): ("tag", "timeout", "address", None, "frames"),
    (STOP, 1): ("tag",),
    (STOP, 2): ("tag", None, "address", None),
    (SET_RATE, 1): ("tag", "rate"),
    (SET_RATE, 2): ("tag", None, "address", None, "rate"),
    (SET_SCAN, 2): ("tag", "count", "address", None),
    (KEEP_ALIVE, 2): ("tag", None, "address", None),
    (ROW, 1): (
        "count",
        "row",
        "rows",
        "sequence",
        "row_end",
        "frame_time",
        "scale",
        "drive_voltage",
        "grounded",
    ),
    (ROW, 2): (
        "scan",
        "row",
        "address",
        None,
        "sequence",
        "row_end",
        "frame_time",
        "scale",
        "drive_voltage",
        "count",
        "rows",
        "grounded",
        "zero",
    ),
    (IDENTITY, 1): (
        "tag",
        "electrodes",
        "rows",
        "adc_bits",
        None,
        "range",
        "rate",
        "line_rate",
        "max_rate",
    ),
    (IDENTITY, 2): (
        "tag",
        "electrodes",
        "address",
        "adc_bits",
        "rows",
        "max_scan",
        "boot",
        "lowest",
        "range",
        "rate",
        "max_row_rate",
        "line_rate",
    ),
    (ACK, 1): ("tag", "command", "streaming", "rate"),
    (ACK, 2): ("tag", "command", "streaming", "address", None, "rate", "sequence", "rows"),
    (ERROR, 1): ("tag", "command", "code"),
    (ERROR, 2): ("tag", "command", "code", "address", None),
    (STATUS, 2): (
        "tag",
        "streaming",
        None,
        "address",
        None,
        "boot",
        "temperature",
        "time",
        "dropped",
        "sequence",
    ),
}
