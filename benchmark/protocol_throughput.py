"""How fast the parser is: MB/s over a stream of rows, read in pieces as a port delivers them."""

from __future__ import annotations

import argparse
import time

import numpy as np

from tomotactile_ros.devices import protocol

SHEETS = {
    "idle": lambda random, size: np.zeros(size),
    "noise": lambda random, size: random.normal(0.0, 1.3, size).clip(0),
    "pressed": lambda random, size: random.integers(0, 4096, size),
    "all zero bytes": lambda random, size: np.full(size, protocol.NO_READING),
}


def stream(electrodes: int, frames: int, sheet: str) -> bytes:
    """Bytes of `frames` frames; `all zero bytes` is the worst case for COBS."""
    random = np.random.default_rng(1)
    packets = []
    for sequence in range(frames):
        counts = SHEETS[sheet](random, (electrodes, electrodes)).astype(np.uint16)
        np.fill_diagonal(counts, protocol.NO_READING)
        constant = (4000, 4000 * sequence, 3.3 / 4096, 3.3)
        packets += [
            protocol.encode(
                protocol.Row(electrodes, row, electrodes, sequence, *constant, row, readings)
            )
            for row, readings in enumerate(map(protocol.pack_counts, counts))
        ]
    return b"".join(packets)


def throughput(data: bytes, piece: int, repeats: int) -> tuple[float, float]:
    """Best MB/s of `repeats` runs, and µs per packet."""
    best, packets = np.inf, 0
    for _ in range(repeats):
        parser = protocol.Parser()
        start = time.perf_counter()
        for at in range(0, len(data), piece):
            parser.feed(data[at : at + piece])
        best = min(best, time.perf_counter() - start)
        packets = parser.counters.packets
    return len(data) / best / 1e6, 1e6 * best / packets


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--piece", type=int, default=4096, help="bytes per read")
    arguments.add_argument("--repeats", type=int, default=5)
    options = arguments.parse_args()
    print(f"{'electrodes':>10}  {'sheet':<14}  {'MB/s':>6}  {'us/packet':>9}")
    for electrodes, frames in ((64, 80), (256, 12)):
        for sheet in SHEETS:
            data = stream(electrodes, frames, sheet)
            speed, each = throughput(data, options.piece, options.repeats)
            print(f"{electrodes:>10}  {sheet:<14}  {speed:6.1f}  {each:9.2f}")


if __name__ == "__main__":
    main()
