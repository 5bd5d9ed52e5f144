"""Learned laws in a rig file: read by names, refused with a hint, written and read again, with their uncertainty."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.inference.free_parameters import free_parameters
from pam_antagonist.model import parameters as par
from pam_antagonist.rig import Rig, fingerprint, load_rig
from pam_antagonist.rig.file import write_rig
from pam_antagonist.rig.learned import LAWS, Law, laws_of, value_path, with_law

LAW = Law("flow", (-1e5, 0.0, 1e5), (0.0, 1e-6, 3e-6), 2, "pressure_difference", "lag", 0.5, std=(1e-7, 2e-7, 3e-7))
PATH = partial(value_path, 1)
FILE = """
based_on: shin2022
name: trial
signals: {next_pressure: 4.0e+5}
effects:
  learned:
    law1:
      place: flow
      muscle: 2
      argument: pressure_difference
      operator: lag
      time: 0.5
      nodes: [-1.0e+5, 0.0, 1.0e+5]
      values: [0.0, 1.0e-6, 3.0e-6]
    law3: {place: friction, argument: next_pressure, nodes: [2.0e+5, 6.0e+5], values: [0.01, 0.03]}
"""


def written(folder: Path, **changes: str) -> Path:
    """The file with lines of its first law replaced; an empty text leaves the line out."""
    lines = []
    for line in FILE.splitlines():
        key = line.strip().split(":")[0]
        new = changes.get(key) if line.startswith("      ") else None
        if new is None:
            lines.append(line)
        elif new:
            lines.append(f"      {new}")
    path = folder / "rig.yaml"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def test_a_file_names_what_a_law_is_made_of(tmp_path: Path) -> None:
    rig = load_rig(written(tmp_path))
    assert laws_of(rig) == {
        1: replace(LAW, std=()),
        3: Law("friction", (2e5, 6e5), (0.01, 0.03), argument="next_pressure"),
    }
    p = rig.parameters()
    assert par.added_states(p) == ["law1_memory_2"]
    assert p[par.INDEX[value_path(1, 3)]] == 3e-6


def test_what_is_written_is_what_was_there(tmp_path: Path) -> None:
    rig = with_law(load_rig(written(tmp_path)), LAW, number=1)
    path = tmp_path / "again.yaml"
    write_rig(rig, path)
    text = path.read_text(encoding="utf-8")
    assert "place: flow" in text and "argument: pressure_difference" in text
    assert "the flow into muscle 2 depends on P1 - P2 with a lag of 0.5 s" in text
    again = load_rig(path)
    assert again == rig and laws_of(again)[1] == LAW and fingerprint(again) == fingerprint(rig)
    assert np.array_equal(again.parameters(), rig.parameters())


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"place": "place: flwo"}, ["law1.place", "'flwo'", "did you mean 'flow'", "expected one of flow, leak"]),
        ({"place": ""}, ["law1.place is missing"]),
        ({"place": "placce: flow"}, ["law1", "'placce'", "did you mean 'place'"]),
        ({"muscle": "muscle: 3"}, ["law1.muscle", "found 3", "1, 2 or both"]),
        ({"muscle": ""}, ["law1.muscle", "expected 1, 2 or both, since flow is a place of a muscle"]),
        ({"place": "place: torque"}, ["law1.muscle", "torque is a place of the joint"]),
        (
            {"argument": "argument: pressure_diference"},
            ["law1.argument", "did you mean 'pressure_difference'", "lengt"],
        ),
        ({"argument": "argument: draw"}, ["law1.argument", "'draw'", "expected, at flow, none, pressure_1"]),
        ({"operator": "operator: lagg"}, ["law1.operator", "did you mean 'lag'", "high_pass, play, stop"]),
        ({"time": ""}, ["law1.time: 0, expected above 0 with the operator lag"]),
        ({"operator": ""}, ["law1.time: 0.5, expected none with the operator none"]),
        ({"time": "time: 1.0e-5"}, ["law1_time", "0.0005 s", "integration"]),
        ({"time": "time: half"}, ["law1.time", "found 'half'", "expected a number"]),
        ({"nodes": "nodes: [0.0, -1.0, 2.0]"}, ["law1.nodes: -1 follows 0, expected increasing values [Pa]"]),
        ({"nodes": "nodes: [0.0, 1.0]"}, ["law1.values: 3 of them, expected 2, one for each node"]),
        ({"nodes": f"nodes: {list(range(16))}"}, ["law1.nodes: 16 of them, expected 1 to 15"]),
        ({"nodes": "nodes: 3.0"}, ["law1.nodes: expected a list of numbers"]),
        ({"nodes": "nodes: [0.0, 1.0, .nan]"}, ["law1.nodes and values: expected finite numbers"]),
        ({"nodes": "nodes: [0.0, 1.0, yes]"}, ["law1.nodes", "found 'yes', expected a number"]),
        ({"values": "values: [0.0, 0.0, 0.0]"}, ["law1.values: all are 0"]),
        ({"argument": "argument: time"}, ["law1.operator: lag, expected none with the argument time"]),
    ],
)
def test_refused_in_one_line_with_what_was_expected(tmp_path: Path, refusal, changes, words) -> None:
    message = refusal(written(tmp_path, **changes))
    assert message.startswith("effects.learned") and all(word in message for word in words), message


def test_laws_take_the_places_that_are_free(rig: Rig) -> None:
    many = rig
    for _ in LAWS:
        many = with_law(many, LAW)
    assert list(laws_of(many)) == list(range(1, 13))
    with pytest.raises(BadInput, match=r"12 learned laws, expected at most 12$"):
        with_law(many, LAW)
    other = Law("torque", (0.0,), (0.1,))
    assert laws_of(with_law(many, other, number=11))[11] == other


def test_a_covariance_is_carried_in_three_directions_that_keep_each_deviation(rig: Rig) -> None:
    root = np.random.default_rng(2).normal(size=(3, 3)) * 1e-7
    covariance = root @ root.T
    uncertain = with_law(rig, LAW.measured(np.array(LAW.values), covariance))
    assert laws_of(uncertain)[1].std == pytest.approx(np.sqrt(np.diag(covariance)))
    steps = np.array([list(changes.values()) for changes in uncertain.directions.values()])
    assert steps.T @ steps == pytest.approx(covariance, rel=1e-6)
    nodes = tuple(float(k) for k in range(8))
    wide = with_law(rig, Law("torque", nodes, nodes, argument="angle").measured(np.array(nodes), np.eye(8)))
    assert len(wide.directions) == 3 and laws_of(wide)[1].std == pytest.approx(np.ones(8))
    assert not with_law(wide, Law("torque", (0.0,), (0.1,)), number=1).directions


def test_a_fit_moves_its_values_and_nothing_else_of_it(rig: Rig) -> None:
    free = [item for item in free_parameters(with_law(rig, LAW)) if "learned" in item.name]
    assert {item.name: item.prior_std for item in free} == dict(zip(map(PATH, (1, 2, 3)), LAW.std, strict=True))


def test_a_report_s_entry() -> None:
    entry = json.loads(json.dumps(LAW.to_json()))
    assert entry["name"] == "learned" and entry["place"] == "flow_2" and entry["arguments"] == ["pressure_difference"]
    law = entry["law"]
    assert (law["nodes"], law["values"], law["std"]) == (list(LAW.nodes), list(LAW.values), list(LAW.std))
    assert law["unit"] == "kg/s" and law["range"] == [-1e5, 1e5] and entry["like"] == []


@pytest.mark.parametrize(
    ("rig", "words"), [("sealed_joint", "is sealed"), ("shin2022_regulators", "has pressure regul")]
)
@pytest.mark.parametrize("law", [Law("command", (4.0, 6.0), (0.1, 0.2), 1, "voltage"), Law("supply", (0.0,), (0.1,))])
def test_a_law_of_valves_that_a_rig_does_not_have_is_refused(rig: str, words: str, law: Law) -> None:
    with pytest.raises(BadInput, match=f"law1: place {law.place}, but the rig {words}"):
        with_law(load_rig(rig, regulators=True), law)
