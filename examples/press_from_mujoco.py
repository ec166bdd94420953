#!/usr/bin/env python3
"""A finger in MuJoCo pushes and slides on a plate; the simulated tactile sheet feels it.

Beside the nodes of the sensor, in the same ROS domain:

    ros2 launch tomotactile_ros tactile.launch.py scene:=live profile:=accurate viz:=true
    python3 examples/press_from_mujoco.py

Without `ros2`, the nodes start with `scripts/tomotactile tactile scene:=live profile:=accurate`.

What MuJoCo says of the finger's contacts with the plate, place and normal force, goes to the topic
`touches`; what the sensor finds comes back on `contacts`, and both are printed side by side. The
finger is a ball of soft rubber: the radius of its contact is that of Hertz, (3 F R / 4 E*)^(1/3)
(Johnson, Contact Mechanics, 1985, section 4.2). No display is needed.
"""

import argparse
import math
import sys

try:
    import mujoco
except ImportError:
    sys.exit("press_from_mujoco: MuJoCo is missing, install it with: python3 -m pip install mujoco")

import numpy as np
import rclpy
from geometry_msgs.msg import Point
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

from tomotactile_ros.msg import Contact, ContactArray

TIP = 0.01  # m, radius of the fingertip
MODULUS = 2e5  # Pa, E* of soft rubber
PUBLISHED = 0.02  # s of simulation between two messages
REPORTED = 0.5  # s between two lines
MODEL = f"""
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <geom name="plate" type="box" size="0.1 0.1 0.005" pos="0 0 -0.005"/>
    <body name="finger" pos="0 0 0.03" gravcomp="1">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="y" type="slide" axis="0 1 0"/>
      <joint name="z" type="slide" axis="0 0 1" damping="20"/>
      <geom name="tip" type="sphere" size="{TIP}" mass="0.05" friction="0.3"/>
    </body>
  </worldbody>
  <actuator>
    <position joint="x" kp="400" kv="8"/>
    <position joint="y" kp="400" kv="8"/>
    <motor joint="z"/>
  </actuator>
</mujoco>
"""


class Finger:
    """The finger on its three sliders; moves by `step`."""

    def __init__(self):
        self._model = mujoco.MjModel.from_xml_string(MODEL)
        self._data = mujoco.MjData(self._model)

    def step(self, seconds: float) -> None:
        """Let time go on: round an ellipse in 10 s, pushing with 1.5 N to 2.5 N."""
        end = self._data.time + seconds
        while self._data.time < end:
            angle = 2 * math.pi * self._data.time / 10
            push = 2 + 0.5 * math.sin(3 * angle)
            self._data.ctrl[:] = 0.06 * math.cos(angle), 0.05 * math.sin(angle), -push
            mujoco.mj_step(self._model, self._data)

    def touches(self) -> list[tuple[float, float, float, float]]:
        """x, y (m), force (N) and radius (m) of every contact with the plate."""
        found, wrench = [], np.zeros(6)
        for number in range(self._data.ncon):
            mujoco.mj_contactForce(self._model, self._data, number, wrench)
            if wrench[0] > 0:
                x, y, _ = self._data.contact[number].pos
                radius = (0.75 * wrench[0] * TIP / MODULUS) ** (1 / 3)
                found.append((float(x), float(y), float(wrench[0]), radius))
        return found


class Presser(Node):
    """Publishes the finger's touches in real time, and says what the sensor makes of them."""

    def __init__(self, finger: Finger):
        super().__init__("press_from_mujoco")
        self._finger, self._found = finger, "no image yet"
        self._publisher = self.create_publisher(ContactArray, "touches", 1)
        self.create_subscription(ContactArray, "contacts", self._on_contacts, 1)
        self.create_timer(PUBLISHED, self._press)
        self.create_timer(REPORTED, self._report)

    def _press(self):
        self._finger.step(PUBLISHED)
        message = ContactArray()
        message.header.stamp = self.get_clock().now().to_msg()
        for x, y, force, radius in self._finger.touches():
            place = Point(x=x, y=y)
            message.contacts.append(Contact(position=place, force=force, radius=radius))
        self._publisher.publish(message)

    def _on_contacts(self, message):
        places = [(c.position.x, c.position.y, c.force) for c in message.contacts]
        self._found = "; ".join(map(_say, places)) or "nothing"

    def _report(self):
        pressed = "; ".join(_say(touch[:3]) for touch in self._finger.touches()) or "nothing"
        print(f"finger {pressed}   sensor {self._found}", flush=True)


def _say(contact) -> str:
    x, y, force = contact
    return f"({1e3 * x:+6.1f}, {1e3 * y:+6.1f}) mm {force:4.2f} N"


def main() -> None:
    """Press until the time is over or somebody stops it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--duration", type=float, default=math.inf, help="s (default: for ever)")
    duration = parser.parse_args().duration
    rclpy.init(args=[])
    try:
        node = Presser(Finger())
        end = node.get_clock().now().nanoseconds * 1e-9 + duration
        while node.get_clock().now().nanoseconds * 1e-9 < end:
            rclpy.spin_once(node, timeout_sec=0.1)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
