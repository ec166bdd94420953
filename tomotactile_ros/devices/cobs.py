"""Consistent Overhead Byte Stuffing: packets without zero bytes, so that zero can delimit them.

Cheshire and Baker, "Consistent Overhead Byte Stuffing", IEEE/ACM Trans. Networking 7 (1999) 159.
A code byte c announces c - 1 non-zero bytes, followed by a zero of the data unless c is 255 or the
packet ends there.
"""

from __future__ import annotations

_CODES = [bytes([n + 1]) for n in range(255)]


def encode(data: bytes) -> bytes:
    """Return `data` without zero bytes; one byte longer per started 254 bytes, at most."""
    parts: list[bytes] = []
    for block in data.split(b"\0"):
        while len(block) >= 254:
            parts += (b"\xff", block[:254])
            block = block[254:]
        parts += (_CODES[len(block)], block)
    return b"".join(parts)


def decode(encoded: bytes) -> bytes | None:
    """Return the data of one `encoded` packet (without delimiter), None if it is damaged.

    `encoded` must not contain a zero byte.
    """
    data = bytearray(encoded)
    surplus = []
    position, end = 0, len(encoded)
    while position < end:
        code = encoded[position]
        data[position] = 0
        position += code
        if code == 255:
            surplus.append(position)
    if position != end:
        return None
    for code_after_full_block in reversed(surplus):
        del data[code_after_full_block : code_after_full_block + 1]
    del data[:1]
    return bytes(data)
