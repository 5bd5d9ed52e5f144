"""Maps: what may stand in them and what is refused; when the rows were taken, and what cannot be time."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from csv_files import MAP, Lab

from pam_antagonist.errors import BadInput
from pam_antagonist.recording.csv_import import START_NS
from pam_antagonist.recording.csv_map import example_text, load_map, map_names
from pam_antagonist.recording.plausible import UNITS

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
    "a date that is none": (
        {"time": {"rate": 5, "date": "yesterday"}},
        "time.date is 'yesterday': expected a day such",
    ),
    "a date of long ago": ({"time": {"rate": 5, "date": "1926-01-01"}}, "time.date is '1926-01-01': expected a day"),
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


def test_names_and_numbers_of_a_map_are_read_as_written(lab: Lab) -> None:
    """YAML 1.1 takes no for false, 010 for 8, and 1:30 for 90."""
    lab.map.write_text(
        "time: {rate: 0100}\nvalve_1: {constant: 05, unit: V}\nvalve_2: {column: on, unit: V}\n"
        "pressure_1: {column: no, unit: kPa, reference: absolute}\n"
        "pressure_2: {column: 1:30, unit: kPa, reference: absolute, offset: 010}\n"
    )
    lab.rows([(300 + k, 400, 4) for k in range(5)], ("no", "1:30", "on"))
    recording = lab.read()
    assert recording.sample_period_s == pytest.approx(0.01)
    assert recording.pressure[0] == pytest.approx([300e3, 410e3])
    assert recording.voltage[0] == pytest.approx([5.0, 4.0])


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


def at(lab: Lab, times: Iterable[Any], **time: Any) -> Lab:
    """Rows at some times, with pressures that tell which row is which."""
    lab.rows([(t, 300 + k, 500 - k, 4 + 0.01 * k, 5) for k, t in enumerate(times)])
    return lab.entries(time={"column": "t", "unit": "s", **time})


def milliseconds(stamps: np.ndarray) -> list[float]:
    return ((stamps - stamps[0]) * 1e-6).tolist()


def test_a_rate_replaces_the_column(lab: Lab) -> None:
    lab.entries(time={"rate": 300})
    assert lab.read().stamp_ns.tolist() == [START_NS, START_NS + 3_333_333, START_NS + 6_666_667, START_NS + 10_000_000]


@pytest.mark.parametrize(
    ("times", "unit", "first"),
    [
        (["1700000000.25", "1700000000.251", "1700000000.252"], "s", 1_700_000_000_250_000_000),
        (["1700000000250000000", "1700000000251000000"], "ns", 1_700_000_000_250_000_000),
        (["3800000000.000", "3800000000.001"], "s", START_NS),  # since 1904: does not fit into a stamp
    ],
)
def test_seconds_since_1970_are_kept(lab: Lab, times: list[str], unit: str, first: int) -> None:
    stamps = at(lab, times, unit=unit).read().stamp_ns
    assert stamps[0] == first
    assert milliseconds(stamps) == pytest.approx(range(len(times)), abs=1e-3)


def test_jitter_is_kept_and_a_gap_is_said(lab: Lab) -> None:
    times = 0.01 * np.arange(200) + np.random.default_rng(1).uniform(-0.002, 0.002, 200)
    recording = at(lab, times).read()
    assert milliseconds(recording.stamp_ns) == pytest.approx(((times - times[0]) * 1e3).tolist(), abs=1e-5)
    assert recording.issues == ()
    recording = at(lab, np.concatenate([np.arange(50), 60 + np.arange(50)]) * 0.01).read()
    assert np.diff(recording.stamp_ns).max() == 110_000_000
    hole, said = recording.issues
    assert (hole.kind, hole.size, round(hole.length_s, 3)) == ("hole", 10, 0.11)
    assert said == (
        "1 of 99 intervals between rows are no 10 ms, the longest (110 ms) before line 52: times kept as they are"
    )


UNEVEN = np.cumsum(np.tile([0.001, 0.03, 0.01, 0.01, 0.01], 10))


def test_uneven_rows_are_refused_unless_the_map_says_how_to_resample(lab: Lab) -> None:
    said = at(lab, UNEVEN).refusal()
    for part in ("time (column 't') is uneven", "median of 10 ms (from 1 to 30 ms)", "give time.resample"):
        assert part in said
    recording = at(lab, UNEVEN, resample=50).read()
    grid = np.arange(len(recording)) * 0.02
    assert milliseconds(recording.stamp_ns) == pytest.approx((grid * 1e3).tolist())
    assert UNEVEN[-1] - UNEVEN[0] - 0.02 < grid[-1] <= UNEVEN[-1] - UNEVEN[0]
    times = UNEVEN - UNEVEN[0]
    assert recording.pressure[:, 0] == pytest.approx(np.interp(grid, times, 300e3 + 1e3 * np.arange(50)), rel=1e-9)
    # A voltage is not interpolated: it is that of the row that comes next, whose voltage was on the valve until then.
    following = [int(np.flatnonzero(times >= moment - 1e-9)[0]) for moment in grid]
    assert recording.voltage[:, 0] == pytest.approx(4 + 0.01 * np.array(following))
    said = " | ".join(recording.issues)
    assert "resampled from about 100 to 50 Hz by interpolation" in said
    assert "there is no filter before it, so faster motion is aliased" in said


def test_resampling_leaves_gaps_empty(lab: Lab) -> None:
    recording = at(lab, np.concatenate([np.arange(50), 100 + np.arange(50)]) * 0.01, resample=100).read()
    assert np.flatnonzero(np.isnan(recording.pressure[:, 0])).tolist() == list(range(50, 100))


STRAY: list[Any] = [round(0.01 * k, 2) for k in range(100)]
LATER = [0.01 * k for k in range(50)] + [1.7e9 + 0.01 * k for k in range(50)]


@pytest.mark.parametrize(
    ("times", "time", "says"),
    [
        ([0, 1, 2, 3], {}, "(column 't') declared in s makes 1 s between rows, expected 2e-05 to 0.5 s; steps of 1"),
        ([0, 1, 2, 3], {}, "steps of 1 look like ms; if it only counts"),
        ([0, 0.001, 0.002], {"unit": "ms"}, "steps of 0.001 look like s"),
        ([0, 0.001, 0.002], {"unit": "us"}, "steps of 0.001 look like s"),
        ([0, 1000, 2000], {}, "steps of 1000 look like us"),
        ([0, 1000000, 2000000], {"unit": "us"}, "steps of 1e+06 look like ns"),
        ([0, 30000, 60000, 90000], {}, "steps of 3e+04 look like us"),
        (["0.00"] * 3 + ["0.01"] * 2, {}, "line 3: time (column 't') repeats, 0 s (3 of 5 rows are not later than"),
        (["0.00"] * 3 + ["0.01"] * 2, {}, "where the column has too few decimals but the rows came evenly, give time:"),
        ([0.0, 0.01, 0.02, 0.0, 0.01], {}, "line 5: time (column 't') runs backwards, 0 s after 0.02 s"),
        ([0.0, 0.01, 0.02, 0.0, 0.01], {}, "of a file that holds several recordings, name the column that counts"),
        ([0.0, "", 0.02], {}, "line 3: time (column 't') is missing"),
        (STRAY * 2, {"out_of_order": "drop"}, "line 102: time (column 't') runs backwards"),
        (LATER, {}, "line 52: time (column 't') jumps by 1.7e+09 s"),
        (STRAY, {"begin": 5.0}, "no row from time.begin 5"),
    ],
)
def test_what_cannot_be_the_times_of_rows(lab: Lab, times: list[Any], time: dict[str, Any], says: str) -> None:
    assert says in at(lab, times, **time).refusal()


def test_a_few_stray_rows_are_dropped_where_the_map_says_so(lab: Lab) -> None:
    times = list(STRAY)
    times[40], times[60], times[70] = times[39], 0.05, ""
    recording = at(lab, times, out_of_order="drop").read()
    assert len(recording) == 97
    assert 300e3 + 40e3 not in recording.pressure[:, 0] and 300e3 + 41e3 in recording.pressure[:, 0]
    assert "3 rows are not later than those before them, the first in line 42: dropped" in recording.issues


def test_begin_and_end_cut_a_file(lab: Lab) -> None:
    lab.entries(time={"column": "t", "unit": "s", "begin": 0.01, "end": 0.03})
    assert lab.read().pressure[:, 0].tolist() == [310e3, 320e3]
