"""Files for other tools: layouts load as their tools would load them; the JSON schema of rig files fits the rigs."""

from __future__ import annotations

import json
import re
import runpy
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pages
import pydantic
import pytest

from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.recording.cdr import typestore
from pam_antagonist.recording.topics import TOPICS
from pam_antagonist.rig.learned import LAWS

TOOLS = pages.ROOT / "config" / "tools"
LAYOUTS = runpy.run_path(str(pages.ROOT / "docs" / "layouts.py"))
JOINTS = {"": ("/pam",), "_two_joints": ("/left/elbow", "/left/wrist")}
JUGGLED = {"joint": "/pam", "left_elbow": "/left/elbow", "left_wrist": "/left/wrist"}


def check_field(path: str, namespaces: tuple[str, ...]) -> None:
    """A path such as ``/pam/joint_estimate/covariance[0]`` leads to a number of a message."""
    found = [
        (name, topic)
        for name, topic in TOPICS.items()
        for namespace in namespaces
        if re.match(re.escape(topic.resolve(namespace)) + r"[/.]", path)
        for namespace in (namespace,)
    ]
    assert found, f"{path} is of no topic of this package"
    _, topic = max(found, key=lambda item: len(item[1].relative))
    (rest,) = {
        path[len(topic.resolve(namespace)) + 1 :] for namespace in namespaces if path.startswith(f"{namespace}/")
    }
    if topic.type == "sensor_msgs/msg/JointState":  # PlotJuggler names the joint, Foxglove its place
        assert re.fullmatch(r"(\w+/(position|velocity|effort))|((position|velocity|effort)\[0\])", rest), path
        return
    name, index = re.fullmatch(r"(\w+)(?:\[(\d+)\])?", rest).groups()  # type: ignore[union-attr]
    (description,) = [kind for field, kind in typestore().fielddefs[topic.type][1] if field == name]
    if index is not None:
        assert int(index) < description[1][1], path  # an array of that length at least
    else:
        assert description[1][0].startswith(("float", "uint", "int")), path


@pytest.mark.parametrize("suffix", JOINTS)
def test_the_files_are_those_of_the_script(suffix: str) -> None:
    joints = LAYOUTS["TWO" if suffix else "ONE"]
    assert tuple(joint.namespace for joint in joints) == JOINTS[suffix]
    for name, content in LAYOUTS["files"](joints, suffix).items():
        assert (TOOLS / name).read_text() == content, "run ./run python docs/layouts.py"


@pytest.mark.parametrize("suffix", JOINTS)
def test_plotjuggler(suffix: str) -> None:
    root = ET.parse(TOOLS / f"plotjuggler{suffix}.xml").getroot()
    computed = {}
    for snippet in root.iter("snippet"):
        sources = [snippet.findtext("linked_source"), snippet.findtext("additional_sources/v1")]
        for source in sources:
            check_field(str(source), JOINTS[suffix])
        assert "math.sqrt(v1)" in str(snippet.findtext("function"))
        computed[snippet.attrib["name"]] = sources
    curves = [curve.attrib["name"] for curve in root.iter("curve")]
    assert set(computed) <= set(curves)
    for curve in set(curves) - set(computed):
        check_field(curve, JOINTS[suffix])
    (selected,) = root.iter("selected_topics")
    known = {topic.resolve(namespace) for topic in TOPICS.values() for namespace in JOINTS[suffix]}
    topics = set(selected.attrib["value"].split(";"))
    assert topics <= known
    used = {curve for curve in curves if curve not in computed} | {
        str(item) for pair in computed.values() for item in pair
    }
    assert all(any(path.startswith(f"{topic}/") for topic in topics) for path in used)
    assert [tab.attrib["tab_name"] for tab in root.iter("Tab")] == [
        n for n, s in JUGGLED.items() if s in JOINTS[suffix]
    ]
    for splitter in root.iter("DockSplitter"):
        assert len(splitter) == int(splitter.attrib["count"]) == len(splitter.attrib["sizes"].split(";"))


def panels_of(layout: Any) -> Iterator[str]:
    if isinstance(layout, str):
        yield layout
    else:
        assert layout["direction"] in ("row", "column") and 0 < layout["splitPercentage"] < 100
        for part in ("first", "second"):
            yield from panels_of(layout[part])


@pytest.mark.parametrize("suffix", JOINTS)
def test_foxglove(suffix: str) -> None:
    layout = json.loads((TOOLS / f"foxglove{suffix}.json").read_text())
    panels = layout["configById"]
    assert sorted(panels_of(layout["layout"])) == sorted(panels)
    outputs = {}
    for script in layout["userNodes"].values():
        code = script["sourceCode"]
        (source,) = re.findall(r'inputs = \["([^"]+)"\]', code)
        check_field(f"{source}/angle", JOINTS[suffix])
        assert code.count(f'Input<"{source}">') == 1 and code.count("{") == code.count("}")
        (output,) = re.findall(r'output = "([^"]+)"', code)
        outputs[output] = set(re.findall(r"^  (\w+): number;", code, re.MULTILINE))
    for name, panel in panels.items():
        if not name.startswith("Plot!"):
            assert panel["topicToRender"] == TOPICS["diagnostics"].relative
            continue
        for path in panel["paths"]:
            topic, _, field = path["value"].rpartition(".")
            if topic in outputs:
                assert field in outputs[topic]
                assert path["timestampMethod"] == "receiveTime"  # what a script publishes has no header
            else:
                check_field(path["value"], JOINTS[suffix])


ROOT = pages.ROOT
SCHEMA = ROOT / "config" / "rig.schema.json"
RIGS = sorted((ROOT / "config" / "rigs").glob("*.yaml"))


@pytest.mark.skipif(pydantic.VERSION.startswith("1."), reason="pydantic 2 makes the schema")
def test_the_file_is_what_the_code_makes() -> None:
    schema = runpy.run_path(str(ROOT / "docs" / "rig_schema.py"))["rig_json_schema"]()
    assert json.loads(SCHEMA.read_text(encoding="utf-8")) == schema, "run ./run python docs/generate.py"


@pytest.mark.parametrize("path", RIGS, ids=lambda path: path.stem)
def test_every_rig_file_names_it(path: Path) -> None:
    first = path.read_text(encoding="utf-8").splitlines()[0]
    assert first == "# yaml-language-server: $schema=../rig.schema.json"
    assert (path.parent / first.split("=")[1]).resolve() == SCHEMA


def test_it_knows_every_effect_and_parameter() -> None:
    schema = json.loads(SCHEMA.read_text(encoding="utf-8"))
    for name, effect in CATALOGUE.items():
        known = schema["properties"]["effects"]["properties"][name]["properties"]
        if effect.of_tables:
            assert list(known) == list(LAWS)
            continue
        for item in effect.parameters:
            assert (known[item.name]["minimum"], known[item.name]["maximum"]) == (item.low, item.high)
