"""Layouts for PlotJuggler, Foxglove and RViz: ``./run python docs/layouts.py --out DIR /left/elbow=left_elbow``.

Without arguments it writes those of one and of two joints in ``config/tools``, which a test holds to this file.
"""

from __future__ import annotations

import argparse
import json
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from pam_antagonist.recording.topics import TOPICS

TOOLS = Path(__file__).resolve().parents[1] / "config" / "tools"
ESTIMATE, EDGE, MEASURED, REFERENCE, SECOND, QUIET = "#d55e00", "#e8a878", "#1a1a1a", "#0072b2", "#009e73", "#8a8f98"
HIGH = 1.96
"""Standard deviations of a 95 % interval."""


class Joint(NamedTuple):
    """One joint: its namespace, and its name in ``joint_states``."""

    namespace: str
    name: str

    def topic(self, name: str) -> str:
        """A topic by its logical name."""
        return TOPICS[name].resolve(self.namespace)

    @property
    def word(self) -> str:
        """The namespace as one word."""
        return self.namespace.strip("/").replace("/", "_")


ONE = (Joint("/pam", "joint"),)
TWO = (Joint("/left/elbow", "left_elbow"), Joint("/left/wrist", "left_wrist"))
SHOWN = (
    "joint_estimate",
    "pressure_1",
    "pressure_2",
    "valve_state",
    "valve_command",
    "measured_joint_states",
    "reference",
)


# ---------------------------------------------------------------- PlotJuggler


def plotjuggler(joints: Sequence[Joint]) -> str:
    """A layout with a tab a joint; the interval's edges are custom series."""
    root = ET.Element("root")
    window = ET.SubElement(root, "tabbed_widget", parent="main_window", name="Main Window")
    for joint in joints:
        tab = ET.SubElement(window, "Tab", tab_name=joint.name, containers="1")
        rows = _curves(joint)
        sizes = ";".join([f"{1 / len(rows):.6f}"] * len(rows))
        container = ET.SubElement(tab, "Container")
        splitter = ET.SubElement(container, "DockSplitter", orientation="-", count=str(len(rows)), sizes=sizes)
        for title, curves in rows:
            area = ET.SubElement(splitter, "DockArea", name=title)
            plot = ET.SubElement(area, "plot", style="Lines", mode="TimeSeries", flip_x="false", flip_y="false")
            ET.SubElement(plot, "limitY")
            for name, color in curves:
                ET.SubElement(plot, "curve", name=name, color=color)
    ET.SubElement(window, "currentTabIndex", index="0")
    ET.SubElement(root, "use_relative_time_offset", enabled="1")
    plugins = ET.SubElement(root, "Plugins")
    plugin = ET.SubElement(plugins, "plugin", ID="ROS2 Topic Subscriber")
    ET.SubElement(plugin, "use_header_stamp", value="true")
    ET.SubElement(plugin, "discard_large_arrays", value="true")
    ET.SubElement(plugin, "max_array_size", value="100")
    listed = ";".join([joint.topic(name) for joint in joints for name in SHOWN] + [TOPICS["diagnostics"].relative])
    ET.SubElement(plugin, "selected_topics", value=listed)
    ET.SubElement(root, "previouslyLoaded_Streamer", name="ROS2 Topic Subscriber")
    equations = ET.SubElement(root, "customMathEquations")
    for joint in joints:
        for name, place in (("angle", 0), ("torque", 8)):
            for sign, edge in (("+", "upper"), ("-", "lower")):
                snippet = ET.SubElement(equations, "snippet", name=f"{joint.namespace}/{name}_95_{edge}")
                ET.SubElement(snippet, "global")
                ET.SubElement(snippet, "function").text = f"return value {sign} {HIGH} * math.sqrt(v1)"
                ET.SubElement(snippet, "linked_source").text = f"{joint.topic('joint_estimate')}/{name}"
                more = ET.SubElement(snippet, "additional_sources")
                ET.SubElement(more, "v1").text = f"{joint.topic('joint_estimate')}/covariance[{place}]"
    ET.indent(root, " ")
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _curves(joint: Joint) -> list[tuple[str, list[tuple[str, str]]]]:
    estimate, measured = joint.topic("joint_estimate"), f"{joint.topic('measured_joint_states')}/{joint.name}"

    def with_interval(name: str, meter: str) -> list[tuple[str, str]]:
        edges = [(f"{joint.namespace}/{name}_95_{edge}", EDGE) for edge in ("lower", "upper")]
        return [*edges, (f"{measured}/{meter}", MEASURED), (f"{estimate}/{name}", ESTIMATE)]

    reference = (f"{joint.topic('reference')}/value", REFERENCE)
    valves, asked = joint.topic("valve_state"), joint.topic("valve_command")
    pressures = [
        (f"{joint.topic(f'pressure_{k}')}/fluid_pressure", color) for k, color in ((1, REFERENCE), (2, SECOND))
    ]
    return [
        ("Angle [rad]: estimate, 95 % interval, encoder, reference", [*with_interval("angle", "position"), reference]),
        ("Torque [N m]: estimate, 95 % interval, torque meter", with_interval("torque", "effort")),
        ("Pressures [Pa]", pressures),
        ("Voltages [V] on the valves", [(f"{valves}/voltage[0]", REFERENCE), (f"{valves}/voltage[1]", SECOND)]),
        (
            "Safety: voltages asked for [V] (others are on the valves where a stop holds them)",
            [(f"{asked}/voltage[0]", REFERENCE), (f"{asked}/voltage[1]", SECOND)],
        ),
        (
            "NIS, 2 on average is right; flags of the estimate",
            [(f"{estimate}/nis", ESTIMATE), (f"{estimate}/flags", QUIET)],
        ),
    ]


# ---------------------------------------------------------------- Foxglove

_SCRIPT = """\
import {{ Input }} from "./types";

type Output = {{
  angle_lower: number;
  angle_upper: number;
  torque_lower: number;
  torque_upper: number;
}};

export const inputs = ["{source}"];
export const output = "{output}";

// The 95 % interval of angle [rad] and torque [N m], from the estimate's covariance.
export default function script(event: Input<"{source}">): Output {{
  const {{ angle, torque, covariance }} = event.message;
  const angleHalf = {high} * Math.sqrt(Number(covariance[0]));
  const torqueHalf = {high} * Math.sqrt(Number(covariance[8]));
  return {{
    angle_lower: angle - angleHalf,
    angle_upper: angle + angleHalf,
    torque_lower: torque - torqueHalf,
    torque_upper: torque + torqueHalf,
  }};
}}
"""


def foxglove(joints: Sequence[Joint]) -> str:
    """A layout with a column a joint; a script in it computes the interval."""
    panels: dict[str, Any] = {}
    scripts: dict[str, Any] = {}
    columns = []
    for joint in joints:
        interval = f"/studio_script/{joint.word}_interval"
        source = joint.topic("joint_estimate")
        scripts[f"{joint.word}_interval"] = {
            "name": f"{joint.word}_interval",
            "sourceCode": _SCRIPT.format(source=source, output=interval, high=HIGH),
        }
        column = []
        for number, (title, lines) in enumerate(_paths(joint, interval)):
            identifier = f"Plot!{joint.word}{number}"
            panels[identifier] = {
                "title": title,
                "foxglovePanelTitle": f"{joint.name}: {title}",
                "paths": [
                    {
                        "value": value, "label": label, "color": color, "enabled": True,
                        "timestampMethod": "receiveTime" if value.startswith("/studio_script") else "headerStamp",
                    }
                    for value, label, color in lines
                ],
                "showXAxisLabels": True,
                "showYAxisLabels": True,
                "showLegend": True,
                "legendDisplay": "floating",
                "isSynced": True,
                "xAxisVal": "timestamp",
                "followingViewWidth": 20,
                "sidebarDimension": 240,
            }  # fmt: skip
            column.append(identifier)
        columns.append(_split(column, "column"))
    panels["DiagnosticSummary!safety"] = {
        "minLevel": 0,
        "pinnedIds": [],
        "hardwareIdFilter": "",
        "topicToRender": TOPICS["diagnostics"].relative,
        "sortByLevel": True,
    }
    layout = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": scripts,
        "playbackConfig": {"speed": 1},
        "layout": {
            "first": _split(columns, "row"),
            "second": "DiagnosticSummary!safety",
            "direction": "row",
            "splitPercentage": 75,
        },
    }
    return json.dumps(layout, indent=1, ensure_ascii=False) + "\n"


def _paths(joint: Joint, interval: str) -> list[tuple[str, list[tuple[str, str, str]]]]:
    estimate, measured = joint.topic("joint_estimate"), joint.topic("measured_joint_states")

    def with_interval(name: str, meter: str, label: str) -> list[tuple[str, str, str]]:
        edges = [(f"{interval}.{name}_{edge}", f"95 % {edge}", EDGE) for edge in ("lower", "upper")]
        return [*edges, (f"{measured}.{meter}[0]", label, MEASURED), (f"{estimate}.{name}", "estimate", ESTIMATE)]

    reference = (f"{joint.topic('reference')}.value", "reference", REFERENCE)
    pair = ((0, REFERENCE), (1, SECOND))
    pressures = [(f"{joint.topic(f'pressure_{k + 1}')}.fluid_pressure", f"muscle {k + 1}", color) for k, color in pair]
    voltages = [(f"{joint.topic('valve_state')}.voltage[{k}]", f"on valve {k + 1}", color) for k, color in pair]
    voltages += [(f"{joint.topic('valve_command')}.voltage[{k}]", f"asked for {k + 1}", QUIET) for k, _ in pair]
    return [
        ("angle [rad]", [*with_interval("angle", "position", "encoder"), reference]),
        ("torque [N m]", with_interval("torque", "effort", "torque meter")),
        ("pressures [Pa]", pressures),
        ("valve voltages [V]", voltages),
        ("NIS, 2 on average is right", [(f"{estimate}.nis", "NIS", ESTIMATE), (f"{estimate}.flags", "flags", QUIET)]),
    ]


def _split(items: Sequence[Any], direction: str) -> Any:
    if len(items) == 1:
        return items[0]
    rest = _split(items[1:], direction)
    return {"first": items[0], "second": rest, "direction": direction, "splitPercentage": 100 / len(items)}


# ---------------------------------------------------------------- RViz


def rviz(joints: Sequence[Joint]) -> str:
    """Displays of each joint's robot model, which its robot_state_publisher describes in the joint's namespace."""
    displays: list[dict[str, Any]] = [
        {
            "Class": "rviz_default_plugins/Grid", "Name": "Grid", "Enabled": True, "Value": True, "Cell Size": 0.1,
            "Plane": "XY", "Plane Cell Count": 10, "Reference Frame": "<Fixed Frame>",
        },
        {"Class": "rviz_default_plugins/TF", "Name": "TF", "Enabled": False, "Value": False, "Marker Scale": 0.1},
    ]  # fmt: skip
    for joint in joints:
        topic = {
            "Value": f"{joint.namespace}/robot_description", "Depth": 1, "History Policy": "Keep Last",
            "Reliability Policy": "Reliable", "Durability Policy": "Transient Local",
        }  # fmt: skip
        displays.append(
            {
                "Class": "rviz_default_plugins/RobotModel",
                "Name": joint.name,
                "Enabled": True,
                "Value": True,
                "Description Source": "Topic",
                "Description Topic": topic,
                "TF Prefix": "",
                "Visual Enabled": True,
                "Collision Enabled": False,
                "Update Interval": 0,
                "Alpha": 1,
            }  # fmt: skip
        )
    view = {
        "Class": "rviz_default_plugins/Orbit", "Name": "Current View", "Distance": 1.0, "Pitch": 1.1, "Yaw": 4.71,
        "Focal Point": {"X": 0, "Y": -0.1, "Z": 0}, "Near Clip Distance": 0.01, "Target Frame": "<Fixed Frame>",
    }  # fmt: skip
    content = {
        "Panels": [
            {"Class": "rviz_common/Displays", "Name": "Displays", "Help Height": 0},
            {"Class": "rviz_common/Views", "Name": "Views"},
        ],
        "Visualization Manager": {
            "Class": "",
            "Enabled": True,
            "Displays": displays,
            "Global Options": {
                "Fixed Frame": f"{joints[0].name}_base",
                "Frame Rate": 30,
                "Background Color": "48; 48; 48",
            },
            "Tools": [{"Class": "rviz_default_plugins/MoveCamera"}, {"Class": "rviz_default_plugins/Select"}],
            "Views": {"Current": view, "Saved": None},
        },
    }
    return yaml.safe_dump(content, sort_keys=False)


# ---------------------------------------------------------------- files


def files(joints: Sequence[Joint], suffix: str) -> dict[str, str]:
    """Name of each file -> its content."""
    return {
        f"plotjuggler{suffix}.xml": plotjuggler(joints),
        f"foxglove{suffix}.json": foxglove(joints),
        f"rviz{suffix}.rviz": rviz(joints),
    }


def main(argv: Sequence[str] | None = None) -> None:
    """Write the files."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("joints", nargs="*", metavar="/NS=JOINT_NAME", help="joints; default: those of config/tools")
    parser.add_argument("--out", type=Path, default=TOOLS, help="folder (default: config/tools)")
    given = parser.parse_args(argv)
    if given.joints:
        made = files([Joint(*text.split("=", 1)) for text in given.joints], "")
    else:
        made = files(ONE, "") | files(TWO, "_two_joints")
    given.out.mkdir(parents=True, exist_ok=True)
    for name, content in made.items():
        (given.out / name).write_text(content, encoding="utf-8")
        print(given.out / name)


if __name__ == "__main__":
    main()
