"""Damaged streams to the wire protocol's receiver.

Streams of rows are mutated, cut, doubled, reordered and mixed with noise, and fed in pieces of any size.
No exception; every accepted packet and every frame is one that was sent; after damage, the second whole
packet at the latest is found; memory stays bounded.
"""

from __future__ import annotations

import time
import tracemalloc

import numpy as np

from tomotactile_ros.bench.program import options
from tomotactile_ros.devices import protocol
from tomotactile_ros.devices.assembly import FrameAssembler, RunAssembler

ELECTRODES = 12
SCAN, ZERO = 0x0707, 100
ORDER = (3, 0, 3, 11, 1, 1, 5, 7, 2, 9, 4, 6)


def order_of(version: int) -> tuple[int, ...]:
    """The electrodes that are grounded."""
    return ORDER if version == 2 else tuple(range(ELECTRODES))


class Sender:
    """Sends frames with random readings, and remembers what it has sent lately.

    Version 1 in the device's own order, version 2 in `ORDER`, with readings around `ZERO`.
    """

    def __init__(self, random: np.random.Generator, version: int) -> None:
        self._random, self._version = random, version
        self._sequence = int(random.integers(1 << 32))
        self._time = int(random.integers(1 << 40))
        self.frames: dict[tuple[int, int], np.ndarray] = {}

    def packets(self) -> list[protocol.Row]:
        """Rows of one frame; each reading is drawn anew, often zero or without zero bytes."""
        top = int(self._random.choice([1, 256, 4096, 65536]))
        counts = self._random.integers(0, top, (ELECTRODES, ELECTRODES)).astype(np.uint16)
        self._sequence = (self._sequence + 1) & 0xFFFFFFFF
        self._time += 4000
        self.frames[self._sequence, self._time] = counts
        constant = (300, self._time, 0.5, 3.25)
        newer = {"scan": SCAN, "zero": ZERO, "version": 2} if self._version == 2 else {}
        return [
            protocol.Row(
                ELECTRODES, row, ELECTRODES, self._sequence, *constant, electrode, readings, **newer
            )
            for row, (electrode, readings) in enumerate(
                zip(order_of(self._version), map(protocol.pack_counts, counts))
            )
        ]


def flip(random: np.random.Generator, data: bytes) -> bytes:
    """Flip bits at some places."""
    damaged = np.frombuffer(data, np.uint8).copy()
    at = random.integers(damaged.size, size=random.integers(1, 9))
    damaged[at] ^= (1 << random.integers(8, size=at.size)).astype(np.uint8)
    return damaged.tobytes()


def cut(random: np.random.Generator, data: bytes) -> bytes:
    """Lose a stretch."""
    first, last = np.sort(random.integers(len(data) + 1, size=2))
    return data[:first] + data[last:]


def double(random: np.random.Generator, data: bytes) -> bytes:
    """Repeat a stretch."""
    first, last = np.sort(random.integers(len(data) + 1, size=2))
    return data[:last] + data[first:]


def reorder(random: np.random.Generator, data: bytes) -> bytes:
    """Send the packets in another order."""
    packets = data.split(b"\0")
    return b"\0".join(packets[i] for i in random.permutation(len(packets)))


def swap(random: np.random.Generator, data: bytes) -> bytes:
    """Exchange two stretches, wherever they begin."""
    a, b, c = np.sort(random.integers(len(data) + 1, size=3))
    return data[:a] + data[b:c] + data[a:b] + data[c:]


def noise(random: np.random.Generator, data: bytes) -> bytes:
    """Insert random bytes, sometimes more than the longest packet and without any delimiter."""
    at = random.integers(len(data) + 1)
    low = int(random.integers(2))
    inserted = random.integers(low, 256, random.choice([1, 30, 1000, 10000]), dtype=np.uint8)
    return data[:at] + inserted.tobytes() + data[at:]


def zeros(random: np.random.Generator, data: bytes) -> bytes:
    """Overwrite a stretch with delimiters."""
    at, length = random.integers(len(data)), random.integers(1, 20)
    return data[:at] + bytes(length) + data[at + length :]


DAMAGES = (flip, cut, double, reorder, swap, noise, zeros)


class Receiver:
    """Parser and assembler under test, with what they let through checked at once."""

    def __init__(self, random: np.random.Generator, version: int) -> None:
        self._random, self._version = random, version
        self.parser = protocol.Parser()
        self.assembler = FrameAssembler(ELECTRODES, ELECTRODES)
        self.assembler.expect_order(SCAN, ORDER)
        self.runs = RunAssembler(5)
        self.frames = 0

    def take(self, data: bytes, sent: set[protocol.Row], frames: dict) -> list[protocol.Packet]:
        """Feed `data` in pieces; return what was accepted."""
        accepted, at = [], 0
        while at < len(data):
            piece = int(self._random.choice([1, 7, 64, 500, 4096, 65536]))
            accepted += self.parser.feed(data[at : at + piece])
            assert self.parser.pending <= protocol.MAX_WIRE, "memory of the parser grows"
            at += piece
        for packet in accepted:
            assert packet in sent, f"accepted what was never sent: {packet}"
            done = self.assembler.feed(packet)
            for frame in done:
                counts = frames[frame.sequence, frame.frame_time]
                assert self._same(frame.voltages, counts), f"wrong frame {frame.sequence}"
                self.frames += 1
            for run in self.runs.feed(packet) if self.assembler.accepted else ():
                assert len(run.grounded) <= 5, "a run that is too long"
        return accepted

    def _same(self, voltages: np.ndarray, counts: np.ndarray) -> bool:
        zero = ZERO if self._version == 2 else 0
        volts = (counts.astype(np.float32) - np.float32(zero)) * np.float32(0.5)
        expected = np.where(counts == protocol.NO_READING, np.float32(np.nan), volts)
        if self._version == 1:
            np.fill_diagonal(expected, np.nan)
        return np.array_equal(voltages, expected, equal_nan=True)


def damage_run(total: int, seed: int, version: int = 1) -> dict[str, float]:
    """Feed at least `total` bytes of damaged streams; return what was seen, or fail."""
    random = np.random.default_rng(seed)
    sender, receiver = Sender(random, version), Receiver(random, version)
    sent: set[protocol.Row] = set()
    begin = time.perf_counter()
    while receiver.parser.counters.bytes < total:
        if len(sender.frames) > 64:
            sent.clear()
            sender.frames.clear()
        rows = sender.packets() + sender.packets()
        clean = sender.packets()
        sent.update(rows, clean)
        data = b"".join(map(protocol.encode, rows))
        for _ in range(random.integers(0, 4)):
            data = DAMAGES[random.integers(len(DAMAGES))](random, data) or b"\1"
        receiver.take(data, sent, sender.frames)
        found = receiver.take(b"".join(map(protocol.encode, clean)), sent, sender.frames)
        assert found[-(ELECTRODES - 1) :] == clean[1:], "not back in step at the second packet"
    counters = receiver.parser.counters
    return {
        "bytes": counters.bytes, "packets accepted": counters.packets,
        "whole frames": receiver.frames, "checksum errors": counters.crc_errors,
        "framing errors": counters.framing_errors, "malformed": counters.malformed,
        "resynchronisations": counters.resynchronisations,
        "seconds": round(time.perf_counter() - begin, 1),
    }  # fmt: skip


def one_input(data: bytes) -> None:
    """Any bytes: as a stream in two pieces, and as the content of a packet."""
    parser = protocol.Parser()
    middle = len(data) // 3
    for packet in parser.feed(data[:middle]) + parser.feed(data[middle:]):
        protocol.encode(packet)
    assert parser.pending <= protocol.MAX_WIRE
    assembler = FrameAssembler(3, 3, partial=True)
    for packet in protocol.Parser().feed(protocol.frame(data)):
        again = protocol.Parser().feed(protocol.encode(packet))
        assert repr(again) == repr([packet]), f"{packet} encodes to {again}"
        if isinstance(packet, protocol.Row):
            assembler.feed(packet)


def main() -> None:
    asked = options(__doc__, bytes=(1e8, "of both versions together"), seed=1)
    damage_run(100_000, asked.seed)
    tracemalloc.start()
    damage_run(1_000_000, asked.seed)
    peak = tracemalloc.get_traced_memory()[1] / 1e6
    tracemalloc.stop()
    for version in protocol.VERSIONS:
        figures = damage_run(int(asked.bytes / len(protocol.VERSIONS)), asked.seed, version)
        print(f"damaged streams, version {version}, seed {asked.seed}")
        for name, value in figures.items():
            print(f"  {name:<20}{value:>14,}")
    print(
        f"  {'peak memory, MB':<20}{peak:>14.2f}   (parser, assembler and what was sent, 1e6 bytes)"
    )


if __name__ == "__main__":
    main()
