"""Parameters of the reconstruction node, and the settings that they stand for."""

from dataclasses import fields
from typing import Any

from tomotactile_ros.nodes import learning, row_contacts, tare
from tomotactile_ros.nodes.parameters import HARDWARE_ID, PATH_CHANGES, Spec
from tomotactile_ros.reconstruction import Settings
from tomotactile_ros.reconstruction.calibration import load_calibration
from tomotactile_ros.reconstruction.settings import AUTO, IMAGES, PROFILES, UNKNOWN
from tomotactile_ros.scenes.contact import ContactLaw
from tomotactile_ros.sheet import MODELS

SPECS = (
    Spec("layout", "equal-8x8", "Electrodes: a layout file or an installed name", read_only=True),
    Spec(
        "frame_id",
        "",
        "Frame in all headers; empty: that of the voltage frame",
        read_only=True,
        frame=True,
    ),
    HARDWARE_ID,
    Spec("profile", "fast", "How much work goes into an image", choices=PROFILES),
    Spec(
        "deadline",
        0.0,
        "Time from the last row of a frame to its result, s; 0: one frame period",
        low=0.0,
        high=10.0,
    ),
    Spec("image", "", "What images show; empty: as the profile makes them", choices=("", *IMAGES)),
    Spec(
        "unknown",
        (AUTO,),
        f"What is found with the contacts: {', '.join(UNKNOWN)}; {AUTO}: all",
        items=str,
    ),
    Spec("contacts", True, "Look for contacts; false: linear images alone"),
    Spec("resolution", 40, "Cells of the image along the longer side", low=4, high=200),
    Spec(
        "regularization",
        0.0,
        "lambda_J^2 of the image, eq. 1; contacts do not depend on it; 0: chosen from the noise",
        low=0.0,
        high=1e30,
    ),
    Spec("noise", 0.001, "Noise of a reading, V rms", low=1e-7, high=1.0),
    Spec(
        "calibration",
        "",
        "File of `tomotactile calibrate`; overrides the contact law below",
        path=True,
    ),
    Spec(
        "contact_coefficient",
        1e-4,
        "c of the contact law g = c p^m; the default is no calibration",
        low=1e-12,
        high=1e6,
    ),
    Spec("contact_exponent", 1.0, "m of the contact law g = c p^m", low=0.1, high=10.0),
    Spec("contact_radius", 0.005, "Typical radius of a contact, m", low=1e-5, high=1.0),
    Spec(
        "threshold",
        3.0,
        "A frame whose readings stay below this many times the noise is untouched",
        low=0.1,
        high=1000.0,
    ),
    Spec(
        "model", "auto", "Of the sheet; auto: the cheapest that the layout allows", choices=MODELS
    ),
    Spec("excluded", (), "Electrodes that are never used", low=0, high=65535),
    *row_contacts.SPECS,
    *tare.SPECS,
    *learning.SPECS,
    Spec(
        "max_age",
        2.0,
        "s; contacts of older readings are stale, and so are the last ones without new readings; 0: any age",
        low=0.0,
        high=3600.0,
    ),
    Spec(
        "view_range",
        0.0,
        "Brightest colour, Pa; 0: as the peaks ask for, in steps of 1, 2, 5",
        low=0.0,
        high=1e9,
    ),
    Spec("view_overlay", True, "Draw electrodes and contacts into pressure_view"),
    Spec(
        "view_size",
        320,
        "Longer side of the image in pressure_view, pixels; its scale stands beside it",
        low=4,
        high=4096,
    ),
    PATH_CHANGES,
)
# What is no setting of the pipeline: the node goes by it, frame by frame.
OF_THE_NODE = {
    "deadline",
    "publish_every",
    "max_age",
    "tare_frames",
    "view_range",
    "view_overlay",
    "view_size",
}


def settings_of(values: dict[str, Any]) -> Settings:
    """Settings of the pipeline: each parameter of the name of one; InputError where a calibration
    cannot be read."""
    names = {field.name for field in fields(Settings)} - OF_THE_NODE
    given = {name: value for name, value in values.items() if name in names}
    given["regularization"] = values["regularization"] or None
    given["image"] = values["image"] or None
    return Settings(**given, contact_law=_contact_law(values))


def law_in_words(values: dict[str, Any]) -> str:
    """Where newtons come from: a calibration, the parameters, or nothing but their defaults."""
    if values["calibration"]:
        return f"calibration {values['calibration']}"
    given = {name: values[name] for name in ("contact_coefficient", "contact_exponent")}
    law = "g = {contact_coefficient:g} p^{contact_exponent:g}".format(**given)
    defaults = {spec.name: spec.default for spec in SPECS}
    if all(defaults[name] == value for name, value in given.items()):
        return f"{law}, assumed: not calibrated (parameter calibration)"
    return f"{law}, as the parameters say"


def _contact_law(values: dict[str, Any]) -> ContactLaw:
    if values["calibration"]:
        return load_calibration(values["calibration"])
    return ContactLaw(values["contact_coefficient"], values["contact_exponent"])
