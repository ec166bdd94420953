"""The settings of the reconstruction, and its results."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from tomotactile_ros.estimation.channels import UNKNOWN
from tomotactile_ros.scenes.contact import ContactLaw
from tomotactile_ros.sheet import MODELS
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError, meant

IMAGES = ("none", "paper", "contacts")
PROFILES = ("fast", "balanced", "accurate", "auto", "paper")
AUTO = "auto"
IN_TIME = 0.05  # s: a robot that grasps is told within a twentieth of a second
PAPER = 1000.0  # lambda_J^2 of Kojima et al. 2023
# of the shipped scenes, of the nodes' parameters, and of frames that say nothing of theirs
DEFAULT_LAW = ContactLaw(coefficient=1.0e-4, exponent=1.0)
NOISY = 2.0  # times what was said: so much more scatter is worth telling
UNSETTLED = 1e-3  # part of the row before that a reading keeps, which is worth telling
LARGEST_REGULARIZATION = 1e30  # of a profile: its square still is a number


@dataclass(frozen=True)
class Settings:
    """How frames become images.

    Parameters
    ----------
    profile : `fast` (one linear step to an image, contacts from it), `balanced` and `accurate`
        (contacts, sheet and channels fitted to the readings together; `balanced` looks no further
        than a fit that explains them), `auto`: `accurate` within a deadline of 50 ms if none is given, or
        `paper`: the potential image is that of Kojima et al. 2023, eq. 1, all else as in `fast`.
    resolution : image cells along the longer side of the sheet.
    regularization : lambda_J^2 of eq. 1, without unit, 0 to 1e30; given, the potential image is that of
        eq. 1 in any profile; None: 1000 where it is. Contacts and their pressure do not depend on it.
    noise : of a reading, V rms, or less: what readings show to be more is taken as that.
    contact_law : conductance per area against pressure, from calibration; None: there is none, as
        of bare conductors and sensors that are not calibrated, and results have no forces.
    contact_radius : typical radius of a contact, m. Frames hardly tell how large a small contact
        is.
    deadline : time for one frame, s; None: as long as it takes. See `deadline.Within`.
    excluded : electrodes whose readings are never used.
    threshold : a frame is idle while its mean reading stays below this many times the noise.
    model : of the sheet, `auto`, `closed_form` or `fem`.
    image : `none`; `paper`, its potential by eq. 1; `contacts`, as the profile finds them; None: `paper` with
        that profile, else `contacts`.
    contacts : whether contacts are looked for; without, the pressure is that of one linear step: blurred over
        the distance of electrodes, and at most the true one, as the sheet around a contact holds currents back
        and only contacts tell how much.
    unknown : what is found with the contacts, of `UNKNOWN`: gains, offsets, resistances to ground and places of
        electrodes, the sheet (uneven, cut or printed otherwise), what readings keep of the row before, contacts
        that are no discs, contacts that move within a frame. The others are as the layout has them, or as learned.
        `auto`: all; what readings do not ask for then stays as it was. Of `balanced`, `accurate` and `auto`.
    """

    profile: str = "fast"
    resolution: int = 40
    regularization: float | None = None
    noise: float = 0.001
    contact_law: ContactLaw | None = DEFAULT_LAW
    contact_radius: float = 0.005
    deadline: float | None = None
    excluded: tuple[int, ...] = ()
    threshold: float = 3.0
    model: str = "auto"
    image: str | None = None
    contacts: bool = True
    unknown: tuple[str, ...] = (AUTO,)

    def __post_init__(self):
        if self.profile not in PROFILES:
            raise InputError(
                f"profile: {checks.show(self.profile)} is none of {', '.join(PROFILES)}"
            )
        if self.image not in (None, *IMAGES):
            raise InputError(f"image: {checks.show(self.image)} is none of {', '.join(IMAGES)}")
        if not self.contacts and self.image in ("none", "contacts"):
            left = "leaves nothing to do" if self.image == "none" else "draws the contacts"
            raise InputError(f"contacts: are not looked for, and image {self.image} {left}")
        if self.model not in MODELS:
            raise InputError(f"model: {checks.show(self.model)} is none of {', '.join(MODELS)}")
        if self.regularization is not None:
            value = checks.not_negative(self.regularization, "regularization", "number")
            if value > LARGEST_REGULARIZATION:
                raise InputError(f"regularization: {value:g} is above {LARGEST_REGULARIZATION:g}")
        if self.contact_law is not None:
            checks.instance(self.contact_law, "contact_law", ContactLaw)
        checks.integer(self.resolution, "resolution", 2, 200)
        checks.positive(self.noise, "noise", "voltage in V")
        checks.length(self.contact_radius, "contact_radius")
        if self.deadline is not None:
            checks.positive(self.deadline, "deadline", "time in s")
        elif self.profile == "auto":
            object.__setattr__(self, "deadline", IN_TIME)
        checks.positive(self.threshold, "threshold", "number")
        unknown = (self.unknown,) if isinstance(self.unknown, str) else tuple(self.unknown)
        for each in unknown:
            if each not in (AUTO, *UNKNOWN):
                names = f"{AUTO}, {', '.join(UNKNOWN)}"
                hint = meant(str(each), UNKNOWN)
                raise InputError(f"unknown: {checks.show(each)} is none of {names}{hint}")
        if AUTO in unknown and len(unknown) > 1:
            raise InputError(f"unknown: {AUTO} is all, and stands alone")
        object.__setattr__(self, "unknown", unknown)
        excluded = tuple(checks.integer(e, "excluded", 0, 65534) for e in self.excluded)
        object.__setattr__(self, "excluded", excluded)

    @property
    def asked(self) -> tuple[str, ...]:
        """What is found with the contacts."""
        return UNKNOWN if self.unknown == (AUTO,) else self.unknown

    @property
    def law(self) -> ContactLaw:
        """The law that estimates are made with, also where none gives forces: without one it only
        says in which numbers conductances are written down on the way."""
        return DEFAULT_LAW if self.contact_law is None else self.contact_law

    @property
    def level(self) -> float | None:
        """lambda_J^2 of the potential image; None: it is not one of eq. 1."""
        if self.image in ("none", "contacts"):
            return None
        of_paper = "paper" in (self.image, self.profile)
        return PAPER if self.regularization is None and of_paper else self.regularization


def _plus_minus(spread: float, unit: str) -> str:
    return f" ± {spread:.2g} {unit}" if math.isfinite(spread) else ""


@dataclass(frozen=True)
class ContactEstimate:
    """One contact: centre x, y (m), force (N), pressure (Pa): force over area, area on the sheet (m²),
    radius of the disc of its area (m).

    force, pressure and force_std are NaN where there is no contact law: they are not known.

    position_covariance : of x and y, row by row, m²; force_std : N, inf of a bare conductor, whose
        force is at least what is given; probability : that it is there. NaN where nothing was
        estimated of them.
    conductance : of the whole contact, S, whatever the contact law.
    id : of the same contact as long as it lasts, 0 where nobody follows it; age : s since it began;
        velocity : m/s along x and y of the sheet.
    """

    x: float
    y: float
    force: float
    pressure: float
    area: float
    radius: float
    position_covariance: tuple[float, float, float, float] = (math.nan,) * 4
    force_std: float = math.nan
    probability: float = math.nan
    id: int = 0
    age: float = 0.0
    velocity: tuple[float, float] = (0.0, 0.0)
    conductance: float = math.nan

    def __post_init__(self) -> None:
        for name in ("x", "y", "force", "pressure", "area", "radius", "force_std", "conductance"):
            object.__setattr__(self, name, float(getattr(self, name)))  # numpy's print their type

    def __repr__(self) -> str:
        """What people ask of a contact, in their units; each number is there under its name."""
        spread = math.sqrt(max(self.position_covariance[0], self.position_covariance[3], 0.0))
        place = f"({1e3 * self.x:.1f}, {1e3 * self.y:.1f}) mm" + _plus_minus(1e3 * spread, "mm")
        if math.isnan(self.force):
            strength = f"{1e6 * self.conductance:.3g} µS"
        else:
            least = checks.at_least(self.force_std)
            strength = f"{least}{self.force:.3g} N" + _plus_minus(self.force_std, "N")
        known = f", id {self.id}, {self.age:.2f} s old" if self.id else ""
        return f"<contact at {place}, {strength}, radius {1e3 * self.radius:.1f} mm{known}>"


@dataclass
class Result:
    """What one frame says.

    Attributes
    ----------
    potential : (H, W) potential input distribution of eq. 1, V; NaN outside the outline.
    pressure : (H, W) Pa; NaN outside the outline, and everywhere where `conductance` is given.
    contacts : strongest first.
    excluded : electrodes that were left out of this frame.
    idle : nothing above the noise; the image is zero.
    regularization : lambda_J^2 in use.
    state : `valid`, or `withheld`: nothing explains the readings, and `reason` says why. Then there
        are no contacts, and the image is NaN unless only the deadline came before they were known: that is
        not the same as nothing that touches.
    misfit : chi-squared per reading, about 1 where noise alone is left; NaN where nothing was
        fitted.
    faults : {electrode: why its channel is left out}
    holds : s after the frame's first row, the time for which its contacts hold: that of the last row
        where rows were estimated at their own times, the middle where all were taken for rows of one
        state of the sheet.
    noise : of a reading, V rms, as the readings show it, what the settings say at the least; NaN
        where nothing was fitted.
    settling : part of the row before that readings keep, mean of the channels; 0 where none was found.
    complete : whether all was tried; else the deadline came before: contacts are those of a glance, with wide
        deviations, or one contact stands for all, or they are withheld. Or all that is tried for one frame left more
        over than noise: too much touches at once, and some may be missing or stand for several.
    alternative : other contacts that explain the readings nearly as well, with odds of 1 : 19 at least, and differ from
        `contacts` by more than their deviations, one long contact for two beside each other, say; None: there are
        none.
    conductance : (H, W) S/m², of contacts per area, where there is no contact law that makes
        pressures of it: then these, and the forces of contacts, are NaN. None where there is one.
    """

    potential: np.ndarray
    pressure: np.ndarray
    contacts: list[ContactEstimate]
    excluded: tuple[int, ...]
    idle: bool
    regularization: float
    state: str = "valid"
    reason: str = ""
    misfit: float = math.nan
    faults: dict[int, str] = field(default_factory=dict)
    holds: float = 0.0
    noise: float = math.nan
    settling: float = 0.0
    complete: bool = True
    conductance: np.ndarray | None = None
    alternative: list[ContactEstimate] | None = None

    @property
    def ambiguous(self) -> bool:
        """Whether the readings allow other contacts as well: `alternative`."""
        return self.alternative is not None

    @property
    def calibrated(self) -> bool:
        """Whether forces and pressures are known."""
        return self.conductance is None

    @property
    def image(self) -> np.ndarray:
        """(H, W) what there is to show: the pressure, Pa, or without a contact law the conductance,
        S/m²."""
        return self.pressure if self.conductance is None else self.conductance

    def without_law(self, law: ContactLaw) -> Result:
        """The same result of a sensor without a contact law, made with the linear `law` as if it had
        one: what the law was asked for is taken back."""
        nan, other = math.nan, self.alternative
        contacts, alternative = (
            [replace(contact, force=nan, pressure=nan, force_std=nan) for contact in found]
            for found in (self.contacts, other or ())
        )
        unknown = np.full_like(self.pressure, nan)
        conductance = law.coefficient * self.pressure
        told = replace(self, contacts=contacts, pressure=unknown, conductance=conductance)
        return replace(told, alternative=None if other is None else alternative)


def doubt_of_noise(noise: float, expected: float) -> str:
    """A line where readings scatter, `noise` V rms, far more than was `expected`; else nothing."""
    if not noise > NOISY * expected:
        return ""
    return f"readings scatter by {1e3 * noise:.2g} mV rms, not {1e3 * expected:.2g} mV (noise)"


def doubt_of_settling(part: float) -> str:
    """A line where readings keep a `part` of the row before; else nothing."""
    if not part > UNSETTLED:
        return ""
    return f"readings keep {100 * part:.2g} % of the row before: the multiplexer is read too early"
