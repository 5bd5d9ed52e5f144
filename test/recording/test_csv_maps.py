"""Maps: what may stand in them, what is refused and how; the ones that come with the package."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from csv_files import MAP, Lab

from pam_antagonist.errors import BadInput
from pam_antagonist.recording.csv_map import example_text, load_map, map_names
from pam_antagonist.recording.units import UNITS

GAUGE = {"column": "p1", "unit": "kPa", "reference": "gauge"}
ABSOLUTE = {"column": "p1", "unit": "kPa", "reference": "absolute"}
ANGLE = {"column": "a", "unit": "deg"}
VOLT = {"unit": "V"}

REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "no pressure": ({"pressure_2": None}, "pressure_2 is missing"),
    "no valve": ({"valve_1": None}, "valve_1 is missing"),
    "no time": ({"time": None}, "time is missing"),
    "a typo": ({"presure_1": GAUGE, "pressure_1": None}, "unknown key 'presure_1' (did you mean 'pressure_1'?)"),
    "an unknown key": ({"angle": {**ANGLE, "sign": -1}}, "unknown key 'angle.sign'"),
    "no reference": ({"pressure_1": {"column": "p1", "unit": "kPa"}}, "reference is missing: whether 0 is the atmo"),
    "another reference": ({"pressure_1": {**GAUGE, "reference": "relative"}}, "pressure_1.reference: "),
    "no atmosphere": ({"pressure_1": GAUGE}, "bags hold absolute pressure; write atmosphere: {pressure"),
    "a number for an atmosphere": ({"atmosphere": 101325.0}, "atmosphere: expected entries pressure, unit (found 101"),
    "entries for a name": ({"episode": {"column": "trial"}}, "episode: "),
    "a decimal comma": ({"angle": {**ANGLE, "scale": "1,5"}}, "decimals are written after a point"),
    "a decimal comma in braces": ({"angle": {**ANGLE, "scale": 1, 5: None}}, "written after a point"),
    "an atmosphere in kPa as bar": (
        {"atmosphere": {"pressure": 101.325, "unit": "bar"}},
        "atmosphere.pressure is 101.325 bar = 1.01325e+07 Pa, expected 50000 to 120000 Pa absolute",
    ),
    "time without a unit": ({"time": {"column": "t"}}, "time.unit is missing: expected one of s, ms, us, ns"),
    "time twice": ({"time": {"column": "t", "unit": "s", "rate": 100}}, "time: expected either column"),
    "no time in time": ({"time": {}}, "time: expected either column"),
    "a rate of zero": ({"time": {"rate": 0}}, "time.rate: "),
    "an endless rate": ({"time": {"rate": float("inf")}}, "time.rate: "),
    "an empty valve": ({"valve_2": VOLT}, "valve_2: expected either column or constant"),
    "a valve twice": ({"valve_2": {**VOLT, "column": "u", "constant": 5}}, "valve_2: expected either"),
    "sealed without a voltage": ({"valve_1": {**VOLT, "sealed": True}}, "valve_1 is sealed: expected constant, the"),
    "sealed with a column": ({"valve_1": {**VOLT, "sealed": True, "column": "u1"}}, "is sealed: expected constant"),
    "a constant with a scale": ({"valve_1": {**VOLT, "constant": 5, "scale": 2}}, "expected no scale"),
    "a scale of zero": ({"angle": {**ANGLE, "scale": 0}}, "angle.scale is 0"),
    "a scale in words": ({"angle": {**ANGLE, "scale": "minus"}}, "angle.scale: "),
    "a column that YAML takes for yes": ({"valve_1": {**VOLT, "column": True}}, "valve_1.column is yes or no"),
    "column 0": ({"valve_1": {**VOLT, "column": 0}}, "valve_1.column is 0: columns are counted from 1"),
    "a column of a half": ({"valve_1": {**VOLT, "column": 1.5}}, "valve_1.column"),
    "one column for two": ({"pressure_2": ABSOLUTE}, "pressure_2 and pressure_1 are the same column, 'p1'"),
    "names without a header": ({"file": {"header": False}}, "time.column is 't', but the file has no header"),
    "a delimiter of two letters": ({"file": {"delimiter": "::"}}, "file.delimiter: "),
    "an unknown encoding": ({"file": {"encoding": "latin-99"}}, "unknown encoding 'latin-99'"),
    "lines after no header": (
        {"file": {"header": False, "skip_after_header": 1}},
        "file.skip_after_header is given, but the file has no header",
    ),
}


@pytest.mark.parametrize(("changes", "says"), REFUSED.values(), ids=REFUSED.keys())
def test_what_is_refused(lab: Lab, changes: dict[str, Any], says: str) -> None:
    assert says in lab.entries(**changes).refusal()


@pytest.mark.parametrize(
    ("entry", "unit", "hint"),
    [("pressure_1", "KPA", "did you mean kPa?"), ("pressure_2", "psig", "did you mean psi?"),
     ("pressure_1", "mPa", "did you mean MPa?"), ("valve_1", "volt", ""), ("angle", "grad", "did you mean"),
     ("torque", "nm", "did you mean N m?"), ("time", "sec", ""), ("external_torque", "N", "")],
)  # fmt: skip
def test_unknown_units_list_the_known_ones(lab: Lab, entry: str, unit: str, hint: str) -> None:
    quantity = {"valve_1": "voltage", "external_torque": "torque"}.get(entry, entry.partition("_")[0])
    said = lab.entries(**{entry: {**MAP.get(entry, {"column": "x"}), "unit": unit}}).refusal()
    assert f"{entry}.unit: unknown unit {unit!r} of {quantity}, expected one of {', '.join(UNITS[quantity])}" in said
    assert hint in said


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "expected a mapping of names to values, as in pam import_csv --example"),
        ("- time\n", "expected a mapping"),
        ("time: {rate: 5}\ntime: {rate: 6}\n", "key 'time' stands twice"),
        ("a: !!python/object/apply:os.system [ls]\n", "not valid YAML"),
        ("#" * 200_000, "which is no map file"),
    ],
)
def test_files_that_are_no_maps(lab: Lab, text: str, says: str) -> None:
    lab.map.write_text(text)
    assert says in lab.refusal()


def test_maps_are_found_by_name_or_path(tmp_path: Path) -> None:
    assert load_map("sealed_joint").sealed == (1, 2)
    for name in map_names():
        load_map(name)
    with pytest.raises(BadInput, match="unknown map 'sealed_join': .*did you mean 'sealed_joint'"):
        load_map("sealed_join")
    with pytest.raises(BadInput, match="no such map file"):
        load_map(tmp_path / "absent.yaml")


def test_the_example_is_a_map_that_reads_the_file_it_describes(lab: Lab) -> None:
    lab.map.write_text(example_text(), encoding="utf-8")
    header = ("t", "p1", "p2", "u1", "u2", "angle", "torque", "load")
    lab.rows([(0.01 * k, 366, 340, 5.5, 5.4, -12 + k, 0.5, 0.1) for k in range(10)], header)
    recording = lab.read()
    assert recording.pressure[0] == pytest.approx([467325.0, 441325.0])
    assert recording.angle is not None and recording.torque is not None and recording.external_torque is not None
    assert recording.issues == ()
