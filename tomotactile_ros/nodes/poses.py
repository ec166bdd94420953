"""Where a sensor is: from tf2 where it is installed, or from a file of fixed poses."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from geometry_msgs.msg import Transform
from rclpy.node import Node
from rclpy.time import Time
from scipy.spatial.transform import Rotation
from std_msgs.msg import Header

from tomotactile_ros.nodes.parameters import Spec
from tomotactile_ros.skin import load_poses
from tomotactile_ros.spatial import Pose
from tomotactile_ros.support.errors import InputError

POSES = Spec("poses", "", "File of the sensors' fixed poses; empty: from tf2", read_only=True)
Locate = Callable[[Header], Pose]
OLDEST = 0.5  # s between contacts and the newest transform: five of one that comes at 10 Hz


def make_locator(node: Node, frame_id: str, file: str) -> Locate:
    """What says where the frame of a header is in `frame_id`; it raises InputError if it is not
    known.

    A transform of tf2 holds for the stamp of the header, or it is the newest one where that is at
    most `OLDEST` away: an arm whose transforms have stopped may be anywhere by now.

    Parameters
    ----------
    node : listens to transforms.
    frame_id : of the skin.
    file : of fixed poses; empty for tf2.
    """
    if file:
        return _fixed(load_poses(Path(file), frame_id), frame_id)
    try:
        from tf2_ros import Buffer, TransformException, TransformListener
    except ImportError:
        raise InputError(
            "poses: tf2_ros is not installed here: name a file of poses, or install it"
        ) from None
    buffer = Buffer(node=node)
    listener = TransformListener(buffer, node)

    def locate(header: Header) -> Pose:
        source = header.frame_id
        try:
            try:
                found = buffer.lookup_transform(frame_id, source, Time.from_msg(header.stamp))
            except TransformException:  # newer than the last transform: that one, then
                found = buffer.lookup_transform(frame_id, source, Time())
                _check_age(header, found.header)
        except TransformException as error:
            raise InputError(f"no transform from {source} to {frame_id}: {error}") from None
        return _pose(found.transform)

    locate.listener = listener  # type: ignore[attr-defined] # lives as long as what it serves
    return locate


def _fixed(poses: Mapping[str, Pose], frame_id: str) -> Locate:
    here = Pose(np.zeros(3), Rotation.identity())

    def locate(header: Header) -> Pose:
        if header.frame_id == frame_id:
            return here
        if header.frame_id not in poses:
            known = ", ".join(poses) or "none"
            raise InputError(f"poses: none of frame '{header.frame_id}', only of {known}")
        return poses[header.frame_id]

    return locate


def _check_age(contacts: Header, transform: Header) -> None:
    """Refuse a transform that is of another time than contacts; a stamp of 0 is no time."""
    late = (Time.from_msg(contacts.stamp) - Time.from_msg(transform.stamp)).nanoseconds / 1e9
    if abs(late) > OLDEST:
        when = "older" if late > 0 else "newer"
        raise InputError(
            f"the newest transform of {contacts.frame_id} is {abs(late):.1f} s {when} than its contacts"
        )


def _pose(transform: Transform) -> Pose:
    t, r = transform.translation, transform.rotation
    return Pose(np.array([t.x, t.y, t.z]), Rotation.from_quat([r.x, r.y, r.z, r.w]))
