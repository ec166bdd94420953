"""`sensor.yaml`: what was learned about one sensor, format tomotactile-sensor/1 (docs/learning.md).

Numbers that people read stand in plain lists with their deviations. Correlations and the modes of
the sheet are packed: float32, little endian, zlib, base64. Modes are kept as values at places on
the sheet: eigenvectors differ between machines in sign and order, and a later release may take
others; what was learned is brought into the modes of the machine that reads. Resistances to ground
stand as people want them, with all that they may be off; the distribution is that of `excess`, which has
in it what the model's electrodes err.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import os
import zlib
from dataclasses import replace

import numpy as np

from tomotactile_ros.estimation.as_cut import COUNT, torn
from tomotactile_ros.estimation.channels import ChannelPrior
from tomotactile_ros.estimation.operator import SheetOperator, operator_for
from tomotactile_ros.estimation.rim import WAYS
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.learning import findings
from tomotactile_ros.learning.kept_out import GROUPS
from tomotactile_ros.learning.state import PARTS, SensorState
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.yamlio import Reader, write_mapping

FORMAT = "tomotactile-sensor/1"
MAX_BYTES = 16_000_000  # 256 electrodes have 2 MB
_MOST_MODES, _MOST_PLACES = 1000, 10_000  # of a sheet: ours have some 40, at up to 256 cells
_DIGITS = 9  # of a number in the file: more than float32 has
_ASIDE = "aside_x", "aside_y"  # parts that earlier files lack: nothing was known of them
_RIM = "outline"  # how far out and askew its sides are; lacking in earlier files, as `_ASIDE`
_RADIUS = "electrode_radius"  # m, of all in the mean; lacking likewise
_LEFT_OUT = "left_out"
_TEARS = "tears"  # [x, y, x, y] of the ends of each, m; lacking where there is none
_EXCESS = "excess"  # earlier files have it as `resistance`
_NEARLY = 1e-6  # smallest eigenvalue of correlations: rounding to float32 leaves as much


def geometry(layout: Layout) -> str:
    """Eight characters that tell layouts apart: of outline and electrodes, to a micrometre."""
    rings = [layout.outline.shell, *layout.outline.holes, layout.positions]
    text = b"".join(np.round(ring * 1e6).astype("<i8").tobytes() + b";" for ring in rings)
    return hashlib.sha256(text + f"{layout.radius:.6e}".encode()).hexdigest()[:8]


def save_sensor(
    path: str | os.PathLike, layout: Layout, operator: SheetOperator, state: SensorState
) -> None:
    """Write what is known about a sensor with `layout`, whole or not at all."""
    field, known, spread = operator.field, state["sheet"], state.std("sheet")
    uneven, turned = slice(0, field.count), slice(field.count, operator.of_cut.start)
    expected = [state.expected[state.slice(part)][0] for part in PARTS]
    every = np.arange(layout.electrodes)
    alone = replace(ChannelPrior().for_layout(layout), resistance=0.0, aside=1 / operator.pitch)
    unit = alone.deviations(operator, 1.0, every)
    expected[3] = np.sqrt(expected[3] ** 2 - unit[2][0] ** 2)  # without what radii make of them
    expected[4:] = expected[4] / unit[3][0], expected[5] / unit[4][0]  # a common way taken off
    content = {
        "format": FORMAT,
        "layout": layout.id,
        "geometry": geometry(layout),
        "learned": {
            "touches": state.touches,
            "frames": state.frames,
            "untouched": state.idle,
            "time": float(state.time),
            **({_LEFT_OUT: list(state.left_out)} if state.left_out else {}),
        },
        "expected": {part: _round(each) for part, each in zip(PARTS, expected)},
    }
    for part in PARTS[1:]:
        values, deviations = findings.of_channels(state, operator, part)
        content[part], content[f"{part}_deviation"] = _round(values), _round(deviations)
    content[_EXCESS] = _round(state["resistance"])
    content[f"{_EXCESS}_deviation"] = _round(state.std("resistance"))
    deviation = state.deviation
    correlation = state.covariance / deviation[:, None] / deviation
    content["sheet"] = {
        "anisotropy": _round(known[turned]),
        "anisotropy_deviation": _round(spread[turned]),
        "places": _round(field.centres),
        "logarithm": _round(field.modes @ known[uneven], 5),
        "logarithm_deviation": _round(state.std_across(field.modes), 5),
        "coefficients": _round(known[uneven]),
        "coefficients_deviation": _round(spread[uneven]),
        "modes": _pack(field.modes),
    }
    content[_RIM] = _round(known[operator.of_rim])
    content[f"{_RIM}_deviation"] = _round(spread[operator.of_rim])
    radius = layout.radius * float(np.exp(known[-1]))
    content[_RADIUS], content[f"{_RADIUS}_deviation"] = _round(radius), _round(radius * spread[-1])
    if state.tears:
        content[_TEARS] = _round(state.tears)
    content["correlation"] = _pack(correlation[np.triu_indices(len(correlation), 1)])
    write_mapping(path, content)


def load_sensor(path: str | os.PathLike, layout: Layout, model: str = "auto") -> SensorState:
    """Read what is known of a sensor; InputError where it is not of `layout`, or not whole.

    `model` of the sheet, as the estimator takes it.
    """
    reader = Reader.open(path, FORMAT, MAX_BYTES)
    named = (*PARTS[1:], _EXCESS, _RIM, _RADIUS)
    keys = [f"{part}{end}" for part in named for end in ("", "_deviation")]
    reader.only(
        "format", "layout", "geometry", "learned", "expected", "sheet", "correlation", _TEARS, *keys
    )
    _check_layout(reader, path, layout)
    operator = operator_for(layout, model)
    count = layout.electrodes
    parts = [part for part in PARTS[1:] if part not in _ASIDE or part in reader]
    if _EXCESS in reader:
        parts[parts.index("resistance")] = _EXCESS
    keys = [f"{part}{end}" for part in parts for end in ("", "_deviation")]
    channels = {key: np.array(reader.numbers(key, count)) for key in keys}
    for key in keys:
        if (key.endswith("_deviation") and not (channels[key] > 0).all()) or (
            key == "gain" and not (channels[key] > 0).all()
        ):
            reader.refuse(key, float(channels[key].min()), "is not a positive number")
    sheet = reader.section("sheet")
    modes = len(sheet.items("coefficients"))
    if modes > _MOST_MODES:
        sheet.refuse("coefficients", f"{modes} numbers", f"are more than {_MOST_MODES}")
    if len(sheet.items("places")) > _MOST_PLACES:
        sheet.refuse(
            "places", f"{len(sheet.items('places'))} points", f"are more than {_MOST_PLACES}"
        )
    coefficients = np.array(sheet.numbers("coefficients", modes))
    spread = np.array(sheet.numbers("coefficients_deviation", modes))
    anisotropy = sheet.numbers("anisotropy", 2)
    anisotropic = sheet.numbers("anisotropy_deviation", 2)
    places = sheet.points("places")
    values = _unpack(sheet, "modes", len(places) * modes).reshape(len(places), modes)
    made: list[float] = []
    spread_of_made: list[float] = []
    if _RIM in reader:
        made += reader.numbers(_RIM, WAYS)
        spread_of_made += reader.numbers(f"{_RIM}_deviation", WAYS)
    if _RADIUS in reader:
        radius, deviation = (reader.number(f"{_RADIUS}{end}") for end in ("", "_deviation"))
        if not radius > 0:
            reader.refuse(_RADIUS, radius, "is not a positive number")
        made.append(float(np.log(radius / layout.radius)))
        spread_of_made.append(deviation / radius)
    mean = np.concatenate([coefficients, anisotropy, made, *(channels[part] for part in parts)])
    deviation = np.concatenate(
        [spread, anisotropic, spread_of_made, *(channels[f"{part}_deviation"] for part in parts)]
    )
    size = len(mean)
    if not (deviation > 0).all():
        sheet.refuse("coefficients_deviation", float(deviation.min()), "is not a positive number")
    correlation = _correlation(_unpack(reader, "correlation", size * (size - 1) // 2), size)
    covariance = correlation * deviation[:, None] * deviation
    expected = _expected(reader, operator)
    of_sheet = modes + 2 + COUNT
    lacking = np.zeros(of_sheet + (len(PARTS) - 1) * count, bool)  # of earlier files
    lacking[modes + 2 : of_sheet - 1] = _RIM not in reader
    lacking[of_sheet - 1] = _RADIUS not in reader
    lacking[of_sheet + len(parts) * count :] = True
    unknown = np.concatenate([np.zeros(modes), expected[operator.field.count :]])
    whole = np.diag(np.where(lacking, unknown, 0.0) ** 2)
    whole[np.ix_(~lacking, ~lacking)] = covariance
    covariance, found = whole, mean
    mean = np.zeros(len(lacking))
    mean[~lacking] = found
    counts = {**_counts(reader), _TEARS: _tears(reader, layout)}
    return _in_modes(operator, places, values, mean, covariance, expected, counts)


def _check_layout(reader, path, layout):
    name, found = reader.text("layout"), reader.text("geometry")
    if found != geometry(layout):
        raise InputError(
            f"{path}: geometry: the sensor was learned with layout '{checks.show(name).strip(chr(39))}', its "
            f"electrodes are not those of '{layout.id}'"
        )


def _tears(reader, layout):
    if _TEARS not in reader:
        return ()
    found = tuple(tuple(each.numbers(name, 4)) for name, each in reader.entries(_TEARS))
    try:
        torn(layout, found)
    except InputError as error:
        reader.refuse(_TEARS, list(map(list, found)), f"are no tears of this sheet: {error}")
    return found


def _counts(reader):
    learned = reader.section("learned")
    learned.only("touches", "frames", "untouched", "time", _LEFT_OUT)
    counts = {
        ours: learned.integer(key, 0)
        for ours, key in (("touches", "touches"), ("frames", "frames"), ("idle", "untouched"))
    }
    left_out = tuple(learned.items(_LEFT_OUT)) if _LEFT_OUT in learned else ()
    for each in left_out:
        if each not in GROUPS:
            learned.refuse(_LEFT_OUT, each, f"is none of {', '.join(GROUPS)}")
    return {**counts, "time": learned.number("time", 0.0), _LEFT_OUT: left_out}


def _expected(reader, operator):
    section = reader.section("expected")
    section.only(*PARTS)
    usual = ChannelPrior().for_layout(operator.layout)
    aside = usual.aside * operator.pitch
    found = [section.number(part, *([aside] if part in _ASIDE else [])) for part in PARTS]
    for part, value in zip(PARTS, found):
        if not value > 0:
            section.refuse(part, value, "is not a positive number")
    gain, offset, resistance, aside, _ = found[1:]
    every = np.arange(operator.layout.electrodes)
    prior = replace(
        usual, gain=gain, offset=offset, resistance=resistance, aside=aside / operator.pitch
    )
    return np.concatenate([operator.deviation, *prior.deviations(operator, 1.0, every)])


def _correlation(upper, size):
    """(D, D) from its upper triangle; rounded so that no direction is known better than it can
    be."""
    correlation = np.eye(size)
    correlation[np.triu_indices(size, 1)] = upper
    correlation = correlation + correlation.T - np.eye(size)
    least = np.linalg.eigvalsh(correlation)[0]
    if least < -1e-3:
        raise InputError(f"correlation: is none, its smallest eigenvalue is {least:.3g}")
    if least < _NEARLY:
        correlation += (_NEARLY - least) * np.eye(size)
    return correlation


def _in_modes(operator, places, values, mean, covariance, expected, counts) -> SensorState:
    """The state with the modes of `operator`, from one with other modes (places (C, 2), values (C,
    F))."""
    field, modes = operator.field, values.shape[1]
    if len(places) != len(field.centres) or np.abs(places - field.centres).max() > 1e-6:
        apart = ((field.centres[:, None] - places) ** 2).sum(axis=-1)
        values = values[apart.argmin(axis=1)]
    turn = np.linalg.lstsq(field.modes, values, rcond=None)[0]
    own = turn.shape[0]
    rest = len(mean) - modes
    whole = np.zeros((own + rest, modes + rest))
    whole[:own, :modes] = turn
    whole[own:, modes:] = np.eye(rest)
    covariance = whole @ covariance @ whole.T
    missing = np.eye(own) - turn @ turn.T
    size, ways = np.linalg.eigh((missing + missing.T) / 2)
    new = (ways * np.where(size > 1e-3, size, 0.0)) @ ways.T  # modes that the file does not have
    covariance[:own, :own] += new * expected[0] ** 2
    return replace(
        SensorState(own + 2 + COUNT, whole @ mean, (covariance + covariance.T) / 2, expected),
        **counts,
    )


def _round(values, digits=_DIGITS):
    array = np.asarray(values, float)
    if array.ndim == 0:
        return float(f"{array:.{digits}g}")
    return [_round(each, digits) for each in array]


def _pack(array: np.ndarray) -> str:
    return base64.b64encode(zlib.compress(np.asarray(array, "<f4").tobytes(), 6)).decode()


def _unpack(reader: Reader, key: str, count: int) -> np.ndarray:
    """(count,) numbers of a packed array."""
    text = reader.text(key)
    complaint = InputError(f"{reader.place}{key}: is not {count} packed numbers")
    try:
        packed = base64.b64decode("".join(text.split()), validate=True)
        unpacker = zlib.decompressobj()
        data = unpacker.decompress(packed, 4 * count + 1)
    except (binascii.Error, zlib.error, ValueError):
        raise complaint from None
    if len(data) != 4 * count:
        raise complaint
    array = np.frombuffer(data, "<f4").astype(float)
    if not np.isfinite(array).all():
        raise complaint
    return array
