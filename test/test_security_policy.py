"""config/security/policy.xml: allows what the running nodes do, and nothing else."""

from pathlib import Path
from xml.etree import ElementTree

import pytest

rclpy = pytest.importorskip("rclpy")

from rclpy.node import NodeNameNonExistentError
from sensor_msgs.msg import Image

POLICY = Path(__file__).resolve().parent.parent / "config" / "security" / "policy.xml"
SOMETIMES = {  # by parameters and layout
    "/clock", "/parameter_events", "/sensor_state", "/surface", "/touches", "/tf", "/tf_static",
}  # fmt: skip


def allowed(node: str, kind: str, what: str) -> set[str]:
    """Full names of the topics or services that the policy allows a node."""
    tree = ElementTree.parse(POLICY)
    groups = tree.iterfind(f".//profile[@node='{node}']/{kind}[@{what}='ALLOW']")
    names = {each.text for group in groups for each in group}
    return {n.replace("~", f"/{node}") if n[0] in "~/" else f"/{n}" for n in names}


def test_the_policy_allows_what_the_nodes_do_and_nothing_else(probe, start):
    small = {"layout": "equal-4x4"}
    start("driver", {"scene": "idle", **small})
    start("reconstruction", small)
    poses = POLICY.parent.parent / "poses" / "two_sensors.yaml"
    start("skin", {"sensors": "[left, right]", "poses": poses})
    probe.wait_for(Image, "/pressure")
    for node in ("driver", "reconstruction", "skin"):
        compare(probe, node)


def compare(probe, node):
    """What a running node does with what the policy allows it."""

    def names(look) -> set[str]:
        try:
            return {name for name, _ in look(node, "/")}
        except NodeNameNonExistentError:  # not discovered yet
            return set()

    me = probe.node
    wanted = {
        ("topics", "publish"): me.get_publisher_names_and_types_by_node,
        ("topics", "subscribe"): me.get_subscriber_names_and_types_by_node,
        ("services", "reply"): me.get_service_names_and_types_by_node,
    }
    for (kind, what), look in wanted.items():
        may = allowed(node, kind, what)
        probe.until(lambda look=look, may=may: names(look) >= may - SOMETIMES, f"all {kind}")
        assert names(look) <= may
    assert names(me.get_client_names_and_types_by_node) == set()
