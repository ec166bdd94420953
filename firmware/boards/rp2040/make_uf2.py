#!/usr/bin/env python3
"""Make the file that is copied to an RP2040 in its boot loader.

    make_uf2.py IMAGE.bin IMAGE.uf2

The image begins at the first byte of the flash. Its bytes 252 to 255 become the checksum without
which the chip's ROM does not run it (RP2040 datasheet, 2.8.1.3.1). Format: github.com/microsoft/uf2.
"""

import struct
import sys
from pathlib import Path

FLASH = 0x10000000
PAYLOAD = 256
MAGIC = (0x0A324655, 0x9E5D5157, 0x0AB16F30)
FAMILY_PRESENT = 0x2000
RP2040 = 0xE48BFF56


def crc32_mpeg2(data: bytes) -> int:
    """CRC-32 without reflection and final inversion."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte << 24
        for _ in range(8):
            crc = (crc << 1 ^ 0x04C11DB7 if crc >> 31 else crc << 1) & 0xFFFFFFFF
    return crc


def uf2(image: bytes) -> bytes:
    """The image with its checksum, in blocks of 512 bytes."""
    image = image[:252] + struct.pack("<I", crc32_mpeg2(image[:252])) + image[256:]
    pieces = [image[at : at + PAYLOAD] for at in range(0, len(image), PAYLOAD)]
    blocks = []
    for number, piece in enumerate(pieces):
        head = struct.pack(
            "<8I", MAGIC[0], MAGIC[1], FAMILY_PRESENT, FLASH + PAYLOAD * number, PAYLOAD, number,
            len(pieces), RP2040,
        )  # fmt: skip
        blocks.append(head + piece.ljust(476, b"\0") + struct.pack("<I", MAGIC[2]))
    return b"".join(blocks)


if __name__ == "__main__":
    Path(sys.argv[2]).write_bytes(uf2(Path(sys.argv[1]).read_bytes()))
