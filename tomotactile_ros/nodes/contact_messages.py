"""Between contacts and their messages: places on the flat sheet here, positions in space there."""

from collections.abc import Sequence

import numpy as np
from geometry_msgs.msg import Point, Point32, Vector3, Wrench, WrenchStamped
from std_msgs.msg import Header

from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.msg import Contact, ContactArray, SensorLayout
from tomotactile_ros.nodes.conversions import vector, vectors
from tomotactile_ros.reconstruction import ContactEstimate
from tomotactile_ros.scenes.touches import Touch
from tomotactile_ros.spatial import SpatialContacts


def contacts_to_message(
    contacts: Sequence[ContactEstimate],
    placed: SpatialContacts,
    header: Header,
    stale: str = "",
    complete: bool = True,
    alternative: tuple[Sequence[ContactEstimate], SpatialContacts] | None = None,
) -> ContactArray:
    """Contact estimates, strongest first, and where they are; `stale` says why that is too old,
    `complete` whether all was tried in time, `alternative` what may be as well."""
    others, elsewhere = alternative or ((), placed)
    return ContactArray(
        ambiguous=alternative is not None,
        alternative=[_contact(c, elsewhere, i) for i, c in enumerate(others)],
        header=header,
        state=ContactArray.STALE if stale else ContactArray.VALID,
        reason=stale,
        complete=complete,
        contacts=[_contact(c, placed, i) for i, c in enumerate(contacts)],
    )


def withheld_message(
    header: Header, reason: str, state: int = ContactArray.WITHHELD, complete: bool = True
) -> ContactArray:
    """Contacts that are not known, and why; `complete` : whether all was tried."""
    return ContactArray(header=header, state=state, reason=reason, complete=complete)


def _contact(contact: ContactEstimate, placed: SpatialContacts, number: int) -> Contact:
    position, frame = placed.positions[number], placed.frames[number]
    return Contact(
        position=vector(Point, position),
        force=float(contact.force),
        pressure=float(contact.pressure),
        area=float(contact.area),
        radius=float(contact.radius),
        position_covariance=placed.covariances[number].ravel(),
        force_std=float(contact.force_std),
        probability=float(contact.probability),
        id=int(contact.id),
        age=float(contact.age),
        velocity=vector(Vector3, placed.velocities[number]),
        normal=vector(Vector3, frame[:, 2]),
        tangent=vector(Vector3, frame[:, 0]),
    )


def message_to_contacts(message: ContactArray, layout: Layout | None) -> list[ContactEstimate]:
    """Contact estimates on the flat sheet of a message, in its order; without what only space
    has. Where the layout is not known, x and y are those of the sensor's frame."""
    return _estimates(message.contacts, layout)


def message_to_alternative(
    message: ContactArray, layout: Layout | None
) -> list[ContactEstimate] | None:
    """The same of what may be as well; None where nothing is nearly as likely."""
    return _estimates(message.alternative, layout) if message.ambiguous else None


def _estimates(contacts: Sequence[Contact], layout: Layout | None) -> list[ContactEstimate]:
    return [
        ContactEstimate(
            float(x),
            float(y),
            c.force,
            c.pressure,
            c.area,
            c.radius,
            tuple(c.position_covariance.tolist()),
            force_std=c.force_std,
            probability=c.probability,
            id=c.id,
            age=c.age,
        )
        for (x, y), c in zip(_on_sheet(contacts, layout), contacts, strict=True)
    ]


def message_to_touches(message: ContactArray, layout: Layout) -> list[Touch]:
    """Place on the flat sheet, force and radius of each contact of a message."""
    return [
        Touch(float(x), float(y), c.force, c.radius)
        for (x, y), c in zip(_on_sheet(message.contacts, layout), message.contacts, strict=True)
    ]


def message_to_spatial(message: ContactArray) -> SpatialContacts:
    """Where the contacts of a message are in space, in its order."""
    contacts = message.contacts
    normals, tangents = (
        vectors([c.normal for c in contacts]),
        vectors([c.tangent for c in contacts]),
    )
    return SpatialContacts(
        vectors([c.position for c in contacts]),
        np.stack([tangents, np.cross(normals, tangents), normals], axis=-1),
        vectors([c.velocity for c in contacts]),
        np.array([c.position_covariance for c in contacts]).reshape(-1, 2, 2),
        np.array([c.force for c in contacts], float),
    )


def _on_sheet(contacts: Sequence[Contact], layout: Layout | None) -> np.ndarray:
    positions = vectors([c.position for c in contacts])
    if layout is None:
        return positions[:, :2]
    return layout.surface.nearest(positions, layout.outline.size)


def wrench_to_message(force: np.ndarray, torque: np.ndarray, header: Header) -> WrenchStamped:
    """Force (3,), N, and torque (3,), N m."""
    wrench = Wrench(force=vector(Vector3, force), torque=vector(Vector3, torque))
    return WrenchStamped(header=header, wrench=wrench)


def layout_to_message(layout: Layout, grid: Grid, header: Header) -> SensorLayout:
    """The cells of an image and the electrodes, in metres."""
    width, height = grid.cell_size
    x, y = grid.centres[0]
    return SensorLayout(
        header=header,
        layout_id=layout.id,
        surface=layout.surface.kind,
        height=grid.height,
        width=grid.width,
        cell_width=width,
        cell_height=height,
        first_x=float(x),
        first_y=float(y),
        cells=[vector(Point32, place) for place in layout.surface.to_3d(grid.centres)],
        electrodes=[vector(Point32, place) for place in layout.surface.to_3d(layout.positions)],
        electrode_radius=float(layout.radius),
    )
