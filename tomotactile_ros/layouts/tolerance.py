"""How well people cut a sheet and print its electrodes: what is expected before anything is learned."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.yamlio import Reader

_LEAST = (
    1e-6  # m, and part of a radius: nothing is made so well, and covariances keep their inverse
)
_BY_HAND = 0.005  # of the longer side: sheets of one kind are alike at every size
_MOST = 0.1  # of the sheet: beyond that nothing is known of it to first order


@dataclass(frozen=True)
class Tolerance:
    """Standard deviations of a sheet as it was made from its layout.

    outline : m, of how far out each side lies; its ends are askew by half of that. None: 0.5 % of the
        longer side, 1 mm on 200 mm: cut by hand
    places : m, of electrodes against each other, in x and in y; None: 0.3 % of their spacing
    radius : of electrodes, relative: screen prints and cut foil
    """

    outline: float | None = None
    places: float | None = None
    radius: float = 0.1

    def __post_init__(self):
        for key in ("outline", "places"):
            value = getattr(self, key)
            if value is not None:
                checks.positive(value, key, "length in m", least=_LEAST)
        if checks.positive(self.radius, "radius", "number", _LEAST) > 1:
            raise InputError(f"radius: {self.radius:g} is relative to the radius: 0.1 is 10 %")

    def check(self, size: tuple[float, float]) -> None:
        """Refuse what is wide beside a sheet of this size, m, and was probably given in mm."""
        for key in ("outline", "places"):
            each = getattr(self, key)
            if each is not None and each > _MOST * max(size):
                raise InputError(
                    f"{key}: {each:g} m on a sheet of {max(size):g} m: lengths are in m, was {each:g} mm meant? "
                    f"That is {each / 1e3:g}"
                )

    def cut(self, size: tuple[float, float]) -> float:
        """`outline` of a sheet of this size, m."""
        return _BY_HAND * max(size) if self.outline is None else self.outline

    def to_dict(self) -> dict[str, float]:
        """What a layout file says of it: what is not as usual."""
        usual = asdict(Tolerance())
        return {key: float(each) for key, each in asdict(self).items() if each != usual[key]}


def read_tolerance(reader: Reader) -> Tolerance:
    """The tolerance of a layout file; the usual one where it names none."""
    if "tolerance" not in reader:
        return Tolerance()
    section = reader.section("tolerance", "{outline: 0.002, places: 0.001, radius: 0.1}")
    return section.read(Tolerance)
