"""config/security/policy.xml allows what the running nodes do, and nothing else; config/diagnostics.yaml has each
of their statuses in one group."""

from pathlib import Path
from xml.etree import ElementTree

import pytest

rclpy = pytest.importorskip("rclpy")

import yaml
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import NodeNameNonExistentError
from sensor_msgs.msg import Image

CONFIG = Path(__file__).resolve().parent.parent / "config"
POLICY = CONFIG / "security" / "policy.xml"
SOMETIMES = {  # by parameters and layout
    "/clock", "/parameter_events", "/sensor_state", "/surface", "/touches", "/tf", "/tf_static",
}  # fmt: skip


def allowed(node: str, kind: str, what: str) -> set[str]:
    """Full names of the topics or services that the policy allows a node."""
    tree = ElementTree.parse(POLICY)
    groups = tree.iterfind(f".//profile[@node='{node}']/{kind}[@{what}='ALLOW']")
    names = {each.text for group in groups for each in group}
    return {n.replace("~", f"/{node}") if n[0] in "~/" else f"/{n}" for n in names}


def test_policy_and_aggregator_know_what_the_nodes_do_and_nothing_else(probe, start):
    small = {"layout": "equal-4x4"}
    start("driver", {"scene": "idle", **small})
    start("reconstruction", small)
    poses = CONFIG / "poses" / "two_sensors.yaml"
    start("skin", {"sensors": "[left, right]", "poses": poses})
    reports = probe.listen(DiagnosticArray, "/diagnostics")
    probe.wait_for(Image, "/pressure")
    for node in ("driver", "reconstruction", "skin"):
        compare(probe, node)
    content = yaml.safe_load((CONFIG / "diagnostics.yaml").read_text("utf-8"))
    groups = [g for g in content["/**/analyzers"]["ros__parameters"].values() if g != "Tactile"]

    def names():
        return {status.name for report in reports for status in report.status}

    probe.until(lambda: len(names()) >= len(groups), "report of each node")
    for name in [*names(), *(f"skin/{name}" for name in names())]:  # also in a namespace
        assert sum(any(part in name for part in group["contains"]) for group in groups) == 1


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
