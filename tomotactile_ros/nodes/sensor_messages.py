"""The message `SensorState`: what is known of a sensor, with deviations."""

import math

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point32
from std_msgs.msg import Header

from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.learning import findings
from tomotactile_ros.learning.state import PARTS, SensorState
from tomotactile_ros.msg import SensorState as SensorMessage


def sensor_to_message(
    state: SensorState, operator: SheetOperator, layout: Layout, frame_id: str
) -> SensorMessage:
    """All that is known of a sensor."""
    whole, part = divmod(round(state.time * 1e9), 10**9)
    ratio, direction, deviation = findings.anisotropy(state, operator)
    logarithm, logarithm_deviation = findings.field(state, operator)
    evidence = findings.evidence(state, operator)
    (sides, spread), (radius, radius_deviation) = findings.made(state, operator)
    message = SensorMessage(
        header=Header(stamp=Time(sec=whole, nanosec=part), frame_id=frame_id),
        layout_id=layout.id,
        touches=state.touches,
        frames=state.frames,
        untouched=state.idle,
        unknown=list(evidence),
        evidence=list(evidence.values()),
        outline=sides,
        outline_deviation=spread,
        radius=radius,
        radius_deviation=radius_deviation,
        tears=[each for tear in state.tears for each in tear],
        places=[Point32(x=x, y=y, z=0.0) for x, y in operator.field.centres.tolist()],
        logarithm=logarithm.tolist(),
        logarithm_deviation=logarithm_deviation.tolist(),
        anisotropy=ratio,
        anisotropy_deviation=deviation,
        anisotropy_direction=math.radians(direction),
    )
    for name in PARTS[1:]:
        values, spread = findings.of_channels(state, operator, name)
        setattr(message, name, values.tolist())
        setattr(message, f"{name}_deviation", spread.tolist())
    return message
