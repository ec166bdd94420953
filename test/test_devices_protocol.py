"""The wire protocol: examples of docs/protocol.md, round trips, damage."""

import ctypes
import importlib
import math
import re
import shutil
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from process_support import python

from tomotactile_ros.devices import cobs, protocol

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "benchmark"))
FUZZ = importlib.import_module("fuzz_protocol")
DOCUMENT = (ROOT / "docs" / "protocol.md").read_text(encoding="utf-8")


def vectors() -> dict[str, dict[str, bytes]]:
    """Examples of the document: name -> packet, crc and, of some, wire bytes."""
    found = {}
    for block in re.findall(r"```vector\n(.*?)```", DOCUMENT, re.DOTALL):
        parts = re.split(r"^(name|packet|crc|wire):", block, flags=re.MULTILINE)
        fields = dict(zip(parts[1::2], parts[2::2], strict=True))
        name = fields.pop("name").strip()
        found[name] = {key: bytes.fromhex(text) for key, text in fields.items()}
    return found


VECTORS = vectors()
SCALE = struct.unpack("<f", struct.pack("<f", 3.3 / 4096))[0]
VOLTS = struct.unpack("<f", struct.pack("<f", 3.3))[0]
MEANINGS = {
    "IDENTIFY": protocol.Command(protocol.IDENTIFY, 0x0102),
    "START": protocol.Command(protocol.START, 7),
    "STOP": protocol.Command(protocol.STOP, 8),
    "SET_RATE": protocol.SetRate(9, 15.625),
    "IDENTITY": protocol.Identity(
        0x0102, 64, 64, 12, VOLTS, 15.625, 2_000_000, 31.25, "skin", "1.0.3", "A7"
    ),
    "ROW, 4": protocol.Row(
        4, 0, 4, 258, 1000, 5_000_000_000, SCALE, VOLTS, 0,
        protocol.pack_counts([protocol.NO_READING, 0, 1240, 4095]),
    ),
    "ROW, 130": protocol.Row(
        130, 1, 130, 0, 2000, 0, SCALE, VOLTS, 1, protocol.pack_counts(np.arange(1024, 1154))
    ),
    "ACK": protocol.Ack(9, protocol.SET_RATE, False, 15.625),
    "ERROR": protocol.Error(10, protocol.SET_RATE, 2, "at most 31.25 frames/s"),
    "IDENTITY of a device that speaks both versions": protocol.Identity(
        3, 4, 4, 12, VOLTS, 20.0, 0, 200.0, "skin", "1.0.3", "A7", "v2"
    ),
    "IDENTIFY of version 2": protocol.Command(protocol.IDENTIFY, 0x0102, 2, 7),
    "START of version 2": protocol.Start(7, 5000),
    "SET_RATE of version 2": protocol.SetRate(9, 125.0, 2),
    "SET_SCAN": protocol.SetScan(11, (0, 27, 54, 27)),
    "ROW of version 2": protocol.Row(
        5, 2, 3, 258, 3000, 5_000_000_000, 5 / 4096, VOLTS, 0,
        protocol.pack_counts([20, 2048, 3288, protocol.NO_READING, 1000]),
        scan=11, zero=2048, version=2, address=7,
    ),
    "IDENTITY of version 2": protocol.Identity(
        0x0102, 64, 8, 12, 2.5, 125.0, 2_000_000, 0.0, "skin", "1.0.3", "A7", version=2, address=7,
        max_scan=256, boot=0xC0FFEE01, lowest=-2.5, max_row_rate=2000.0,
    ),
    "ACK of version 2": protocol.Ack(11, protocol.SET_SCAN, True, 125.0, 2, 0, 259, 8),
    "ERROR of version 2": protocol.Error(10, protocol.SET_SCAN, 2, "no electrode 64", 2, 7),
    "STATUS": protocol.Status(12, True, 0xC0FFEE01, 36.5, 5_000_001_000, 3, 259),
}  # fmt: skip


def meaning(name: str) -> protocol.Packet:
    """Packet of the example whose name begins like a key of `MEANINGS`, the longest that does."""
    return MEANINGS[max((key for key in MEANINGS if re.match(rf"{key}\b", name)), key=len)]


def test_every_meaning_has_its_example_in_the_document():
    assert {id(meaning(name)) for name in VECTORS} == {id(packet) for packet in MEANINGS.values()}


def _plain_cobs_decode(data: bytes) -> bytes:
    """The definition, written down without regard to speed."""
    decoded = b""
    while data:
        code, block, data = data[0], data[1 : data[0]], data[data[0] :]
        decoded += block + (b"\0" if code < 255 and data else b"")
    return decoded


@pytest.mark.parametrize("name", VECTORS)
def test_example_is_written_and_read(name):
    packet, example = meaning(name), VECTORS[name]
    wire = protocol.encode(packet)
    assert _plain_cobs_decode(wire[:-1]) == example["packet"] + example["crc"]
    assert wire == example.get("wire", wire) and wire[-1] == 0
    assert protocol.Parser().feed(wire) == [packet]


@pytest.mark.skipif(not shutil.which("cc"), reason="no C compiler")
def test_the_c_code_of_the_firmware_writes_and_reads_the_examples(tmp_path):
    command = ["cc", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", "-o", "wire.so"]
    command += [str(ROOT / "firmware" / "tt_wire.c")]
    subprocess.run(command, cwd=tmp_path, check=True)
    code = ctypes.CDLL(str(tmp_path / "wire.so"))
    code.tt_crc32.restype = ctypes.c_uint32
    for function in (code.tt_cobs_encode, code.tt_cobs_decode):
        function.restype = ctypes.c_size_t
    assert code.tt_crc32(b"123456789", ctypes.c_size_t(9)) == 0xCBF43926
    out = ctypes.create_string_buffer(4200)
    for name, example in VECTORS.items():
        packet, wire = example["packet"] + example["crc"], protocol.encode(meaning(name))
        assert code.tt_crc32(packet, ctypes.c_size_t(len(packet) - 4)) == zlib.crc32(packet[:-4])
        length = code.tt_cobs_encode(packet, ctypes.c_size_t(len(packet)), out)
        assert out.raw[:length] == wire
        length = code.tt_cobs_decode(out, ctypes.c_size_t(len(wire) - 1))
        assert out.raw[:length] == packet


RUNS = st.builds(
    bytes.__mul__, st.just(b"\7"), st.sampled_from([0, 1, 253, 254, 255, 507, 508, 509])
)


@given(RUNS, st.binary(max_size=1500) | st.sampled_from([b"\0", b"\0\0", b"\0\1"]))
def test_cobs_round_trip(run, tail):
    """Also at the edges of full blocks."""
    data = run + tail
    encoded = cobs.encode(data)
    assert 0 not in encoded
    assert len(encoded) <= len(data) + len(data) // 254 + 1
    assert cobs.decode(encoded) == _plain_cobs_decode(encoded) == data


def test_a_final_code_behind_a_full_block_may_be_absent():
    assert cobs.decode(b"\xff" + b"\7" * 254) == b"\7" * 254
    assert cobs.decode(b"\xff" + b"\7" * 254 + b"\1") == b"\7" * 254


SINGLE = st.floats(width=32, allow_nan=False, allow_infinity=False)
POSITIVE = st.floats(min_value=2.0**-120, max_value=2.0**120, width=32)
U8, U16, U32, U64 = (st.integers(0, 2**bits - 1) for bits in (8, 16, 32, 64))
COUNT = st.integers(1, 0xFFFF)
SCALES = st.floats(min_value=2.0**-120, max_value=2.0**19, width=32)
TEXT = st.text(max_size=50).map(lambda text: "".join(filter(str.isprintable, text)))


@st.composite
def rows(draw, version: int) -> protocol.Row:
    count, of = draw(st.integers(1, 2026)), draw(st.integers(1, 0xFFFF))
    newer = {"scan": U16, "zero": U16, "address": U8} if version > 1 else {}
    made = protocol.Row(
        count, draw(st.integers(0, of - 1)), of, draw(U32), draw(U32), draw(U64), draw(SCALES),
        draw(POSITIVE), draw(st.integers(0, count - 1)),
        np.random.default_rng(draw(U32)).bytes(2 * count), version=version,
    )  # fmt: skip
    return made._replace(**{name: draw(values) for name, values in newer.items()})


def packets(version: int):
    """Packets of every type of a version."""
    zero, v = st.just(0), st.just(version)
    address = U8 if version > 1 else zero
    sender = v, address
    identity = U16, COUNT, COUNT, U8, POSITIVE, POSITIVE, U32
    ack = U16, U8, st.booleans(), POSITIVE, *sender
    kinds = [
        rows(version),
        st.builds(protocol.SetRate, U16, SINGLE, *sender),
        st.builds(protocol.Error, U16, U8, U8, TEXT, *sender),
    ]
    if version == 1:
        also, none = st.sampled_from(["", "v2"]), [zero, zero, st.just(0.0), st.just(0.0)]
        return st.one_of(
            *kinds,
            st.builds(protocol.Command, st.sampled_from([1, 2, 3]), U16, *sender),
            st.builds(protocol.Identity, *identity, SINGLE, TEXT, TEXT, TEXT, also, *sender, *none),
            st.builds(protocol.Ack, *ack, zero, zero),
        )
    rest = st.just(0.0), TEXT, TEXT, TEXT, st.just(""), *sender
    newer = U16, U32, POSITIVE.map(float.__neg__), POSITIVE
    order = st.lists(U16, max_size=70).map(tuple)
    return st.one_of(
        *kinds,
        st.builds(protocol.Command, st.sampled_from([1, 3, 6]), U16, *sender),
        st.builds(protocol.Start, U16, U16, U32, *sender),
        st.builds(protocol.SetScan, U16, order, *sender),
        st.builds(protocol.Identity, *identity, *rest, *newer),
        st.builds(protocol.Ack, *ack, U32, U16),
        st.builds(protocol.Status, U16, st.booleans(), U32, SINGLE, U64, U32, U32, *sender),
    )


PACKETS = st.one_of(map(packets, protocol.VERSIONS))


@given(st.lists(PACKETS, max_size=5), st.integers(1, 300))
def test_packets_survive_the_line_in_pieces_of_any_size(packets, piece):
    data = b"".join(map(protocol.encode, packets))
    parser, found = protocol.Parser(), []
    for at in range(0, len(data), piece):
        found += parser.feed(data[at : at + piece])
    assert found == packets
    assert parser.counters.packets == len(packets)
    assert parser.pending == 0


ROW, NEWER = MEANINGS["ROW, 4"], MEANINGS["IDENTITY of version 2"]
WRONG = {
    "row index": ROW._replace(row=4),
    "grounded electrode": ROW._replace(grounded=4),
    "scale zero": ROW._replace(scale=0.0),
    "scale negative": ROW._replace(scale=-1.0),
    "scale not a number": ROW._replace(scale=math.nan),
    "scale infinite": ROW._replace(scale=math.inf),
    "readings that are not finite": ROW._replace(scale=3e38),
    "drive voltage": ROW._replace(drive_voltage=-1.0),
    "drive voltage not a number": ROW._replace(drive_voltage=math.nan),
    "too few readings": ROW._replace(count=5),
    "half a reading": ROW._replace(readings=b"\1\2\3\4\5\6\7"),
    "rate of an identity": MEANINGS["IDENTITY"]._replace(rate=math.nan),
    "rate infinite": MEANINGS["ACK"]._replace(rate=math.inf),
    "rate zero": MEANINGS["ACK"]._replace(rate=0.0),
    "row rate zero": NEWER._replace(max_row_rate=0.0),
    "lowest voltage": NEWER._replace(lowest=1.0),
    "lowest voltage not a number": NEWER._replace(lowest=math.nan),
    "temperature": MEANINGS["STATUS"]._replace(temperature=math.inf),
}


@pytest.mark.parametrize("what", WRONG)
def test_right_checksum_does_not_excuse_wrong_content(what):
    parser = protocol.Parser()
    assert parser.feed(protocol.encode(WRONG[what])) == []
    assert parser.counters.malformed == 1


def test_texts_of_a_device_are_fit_for_one_line():
    identity = MEANINGS["IDENTITY"]._replace(name="skin\n\0", serial="\x1b[31mµ")
    error = MEANINGS["ERROR"]._replace(message="no\r\nADC")
    found = protocol.Parser().feed(protocol.encode(identity) + protocol.encode(error))
    assert (found[0].name, found[0].serial, found[1].message) == ("skin??", "?[31mµ", "no??ADC")


SKIPPED = {
    "empty": b"",
    "type only": b"\x10",
    "no fields": b"\x10\x01",
    "cut field": b"\x01\x01\x00",
    "unknown type": b"\x77\x01\x00\x00",
    "version 3": b"\x01\x03\x05\x00",
    "type of version 2 only": b"\x05\x01\x05\x00",
    "longer than it should be": b"\x01\x02\x05\x00\x00\x00\x00\x00\x00",
    "shorter than it says": b"\x05\x02\x05\x00\x02\x00\x00\x00\x01\x00",
}


@pytest.mark.parametrize("content", SKIPPED.values(), ids=SKIPPED)
def test_short_unknown_and_future_packets_are_counted_and_skipped(content):
    parser = protocol.Parser()
    good = protocol.encode(protocol.Command(protocol.START, 1))
    assert parser.feed(protocol.frame(content) + good) == [protocol.Command(protocol.START, 1)]
    assert parser.counters.malformed == 1
    assert parser.counters.resynchronisations == 1


def test_an_endless_packet_is_not_kept():
    parser = protocol.Parser()
    for _ in range(200):
        parser.feed(b"\x55" * 1000)
        assert parser.pending <= protocol.MAX_WIRE
    good = protocol.Command(protocol.STOP, 3)
    assert parser.feed(b"\0" + protocol.encode(good)) == [good]
    assert parser.counters.framing_errors == 1


def test_the_longest_packet_passes():
    row = ROW._replace(count=2029, readings=bytes(range(1, 254)) * 16 + b"\1" * 10)
    assert protocol.Parser().feed(protocol.encode(row)) == [row]


@settings(max_examples=16, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from(protocol.VERSIONS))
def test_damaged_streams(seed, version):
    """100 kB each: nothing accepted that was not sent, back in step at the second packet."""
    figures = FUZZ.damage_run(100_000, seed, version)
    assert figures["packets accepted"] > 0 and figures["whole frames"] > 0
    assert figures["checksum errors"] + figures["framing errors"] > 0


@given(st.binary(max_size=300))
def test_any_bytes_as_stream_and_as_content(data):
    FUZZ.one_input(data)


def test_what_is_made_of_the_tables_is_up_to_date():
    """The constants of Python and C, and the tables of the document."""
    done = python(ROOT / "scripts/protocol", "--check")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
