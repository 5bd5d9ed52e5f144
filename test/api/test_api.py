"""The Python API: lazy, documented by examples that run, with results that can be saved and looked at as tables."""

from __future__ import annotations

import csv
import doctest
import html
import importlib
import json
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pam_antagonist
from pam_antagonist import (
    BadInput,
    Estimator,
    Recording,
    ReplayResult,
    check,
    diagnose,
    excite,
    identify,
    load_rig,
    new_rig,
    read_bag,
    replay,
    simulate,
    write_bag,
)
from pam_antagonist.api import given
from pam_antagonist.replays.result import columns
from pam_antagonist.rig import Rig

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = (
    "check", "excite", "history", "identify", "import_csv", "load_rig", "new_rig", "read_bag", "replay", "simulate",
    "static", "Estimator",
)  # fmt: skip


@pytest.fixture(scope="module")
def replayed(free: Recording) -> ReplayResult:
    return replay(free.slice(0.0, 2.0), "shin2022")


def test_every_name_is_there_and_nothing_is_loaded_before() -> None:
    code = """
import sys, pam_antagonist
slow = {"numpy", "numba", "rosbags", "pydantic"} & set(sys.modules)
assert not slow, slow
assert set(pam_antagonist.__all__) <= set(dir(pam_antagonist))
from pam_antagonist import *
"""
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
    with pytest.raises(AttributeError, match="no attribute 'replya'"):
        _ = pam_antagonist.replya


def test_functions_are_not_hidden_by_modules() -> None:
    """A module that is imported later would take the place of a function of its name."""
    modules = {path.stem for path in (ROOT / "pam_antagonist").iterdir()}
    assert not modules & {name for name in pam_antagonist.__all__ if not name.startswith("_")}


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_example_in_the_docstring_runs(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    _run_examples(name)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["adapt", "diagnose"])
def test_the_longer_example_in_the_docstring_runs(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    _run_examples(name)


def _run_examples(name: str) -> None:
    item = getattr(pam_antagonist, name)
    module = importlib.import_module(item.__module__)
    found = doctest.DocTestFinder(recurse=True).find(item, name, module=module)
    runner = doctest.DocTestRunner()
    for test in found:
        runner.run(test)
    assert runner.tries > 0, f"{name} has no example"
    assert runner.failures == 0


def test_every_function_has_an_example() -> None:
    functions = {name for name in pam_antagonist.__all__ if name[0].islower()} - {"write_bag"}
    assert functions | {"Estimator"} == {*EXAMPLES, "adapt", "diagnose"}


def test_a_replay_is_saved_as_report_table_and_bag(replayed: ReplayResult, tmp_path: Path) -> None:
    replayed.save(tmp_path / "report", figures=False)
    assert json.loads((tmp_path / "report/report.json").read_text())["samples"] == 2000

    replayed.save(tmp_path / "estimate.csv")
    with (tmp_path / "estimate.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == len(replayed.run.rows)
    last, covariance = replayed.run.rows[-1], replayed.run.rows["covariance"][-1]
    assert int(rows[-1]["stamp_ns"]) == replayed.run.stamp_ns[-1]
    assert float(rows[-1]["angle_rad"]) == pytest.approx(float(last["angle"]), rel=1e-8)
    assert float(rows[-1]["torque_std_Nm"]) == pytest.approx(float(np.sqrt(covariance[2, 2])), rel=1e-8)
    assert float(rows[-1]["innovation_2_Pa"]) == pytest.approx(float(last["innovation"][1]), rel=1e-8)

    replayed.save(tmp_path / "estimate.mcap")
    again = read_bag(tmp_path / "estimate.mcap")
    assert again.estimate is not None
    assert np.array_equal(again.estimate.covariance, replayed.run.rows["covariance"])
    assert np.array_equal(again.estimate.innovation, replayed.run.rows["innovation"], equal_nan=True)
    assert np.array_equal(again.pressure, replayed.recording.pressure)
    content = (tmp_path / "estimate.mcap").read_bytes()
    assert b"pam_antagonist_msgs/msg/JointEstimate" in content and content.startswith(b"\x89MCAP0\r\n")

    for path in ("estimate.csv", "report"):
        with pytest.raises(BadInput, match="exists"):
            replayed.save(tmp_path / path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["estimate.csv", "estimate.mcap", "report"]


def test_an_earlier_result_is_replaced_where_that_is_typed(replayed: ReplayResult, tmp_path: Path) -> None:
    for _ in range(2):
        replayed.save(tmp_path / "estimate.csv", overwrite=True)
        replayed.save(tmp_path / "report", figures=False, overwrite=True)
    (tmp_path / "mine").mkdir()
    with pytest.raises(BadInput, match="exists"):
        replayed.save(tmp_path / "mine", overwrite=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["estimate.csv", "mine", "report"]


def test_results_are_short_in_a_console_and_tables_in_a_notebook(replayed: ReplayResult, free: Recording) -> None:
    for item in (replayed, replayed.report, replayed.run, free, replayed.rig):
        assert len(repr(item)) <= 500 and "\n" not in repr(item)
    assert re.match(r"ReplayResult: .*joint free, rig shin2022; angle RMSE 0\.\d+° \(model alone", repr(replayed))
    assert replayed._repr_html_() == f"<pre>{html.escape(replayed.summary())}</pre>"


def test_a_plan_and_a_check_are_shown_as_results_are(free: Recording, rig: Rig, tmp_path: Path) -> None:
    pytest.importorskip("plotly", reason="the extra [reports] is not installed")
    plan = excite(rig, 6.0)
    assert repr(plan) == f"ExciteResult: 6 s, joint free, rig {rig.name}; .voltage (6000, 2) [V]"
    assert plan.summary().startswith("planned: 6 s, joint free, ") and "joint.inertia" in plan._repr_html_()
    assert [line.name for line in plan.plot().data] == ["valve 1", "valve 2"]
    assert {path.name for path in plan.save(tmp_path / "plan").iterdir()} == {"plan.json", "voltages.csv"}
    checked = check(free, rig)
    assert len(checked.summary().splitlines()) >= len(checked.findings)
    assert checked._repr_html_() == f"<pre>{html.escape(checked.summary())}</pre>"


def test_a_figure_of_a_result_is_plotted(replayed: ReplayResult) -> None:
    pytest.importorskip("plotly", reason="the extra [reports] is not installed")
    plot = replayed.plot()
    assert plot.layout.title.text.startswith("Joint angle") and len(plot.data) > 3
    with pytest.raises(BadInput, match=r"number 99: this result has \d+ figures"):
        replayed.plot(99)


def test_answers_of_a_new_rig_are_judged() -> None:
    for answers, said in (
        ({"radios": "3mm"}, "radios: no such answer"),
        ({"radius": "36.5"}, "radius '36.5': expected a number and its unit"),
        ({"radius": "36.5mm", "muscle": "DMSP-10", "muscle_force": "9N"}, "muscle_force: only with muscle own"),
        ({}, r"missing: radius \(from the axis.*, muscle \("),
    ):
        with pytest.raises(BadInput, match=said):
            new_rig(**answers)


def test_a_value_of_a_rig_is_changed_and_checked_as_in_its_file(rig: Rig) -> None:
    assert rig.with_value("joint.inertia", 0.02).joint == rig.joint.replaced(inertia=0.02)
    assert rig.with_value("effects.leak.area_1", 1e-9).effects == {"leak": {"area_1": 1e-9}}
    assert rig.with_value("uncertainty.friction.shaft", 1e-3).uncertainty["friction.shaft"] == 1e-3
    assert rig.with_value("muscle_1.force.w1", -500.0).muscle_2 == rig.muscle_2
    for name, value, said in (
        ("joint.inertia", -5.0, "joint.inertia: .* greater than"),
        ("joint.inertia", True, "yes or no"),
        ("joint.inertai", 0.02, "did you mean 'joint.inertia'"),
        ("joint__inertia", 0.02, "did you mean 'joint.inertia'"),
        ("inertia", 0.02, "did you mean 'joint.inertia'"),
        ("effects.leek.area_1", 1e-9, "did you mean 'leak'"),
        ("effects.leak.area1", 1e-9, "did you mean 'area_1'"),
        ("effects.leak.area_1", 1.0, "expected 0 to 5e-08 m2"),
        ("uncertainty.joint.inertai", 1e-5, "did you mean 'joint.inertia'"),
        ("supply.pressure", 100e3, "supply.pressure"),
        ("tunings.default.gat", 6.0, "did you mean 'tunings.default.gate'"),
    ):
        with pytest.raises(BadInput, match=said):
            rig.with_value(name, value)
    for change, said in (({"joint__inertia": 0.5}, "joint.inertia.*with_value"), ({"joints": 0.5}, "'joint'")):
        with pytest.raises(BadInput, match=said):
            rig.replaced(**change)
    with pytest.raises(BadInput, match="Joint.replaced: inertia: .* greater than"):
        rig.joint.replaced(inertia=-5.0)
    with pytest.raises(BadInput, match="joint.inertia"):
        simulate(rig.unchecked(joint=rig.joint.unchecked(inertia=-5.0)), duration=0.1)


def test_stiffness_has_one_sign(replayed: ReplayResult) -> None:
    """Positive where the muscles pull back, as on pages and in references."""
    assert columns(replayed)["stiffness_Nm_rad"].min() > 1.0


def _wrong_arguments() -> dict[str, tuple[Callable[[Recording, Rig], object], str]]:
    return {
        "replay swapped": (lambda bag, rig: replay(rig, bag), "rig: found a value of type Recording"),
        "replay an array": (lambda bag, rig: replay(bag.pressure, rig), "recording: found a value of type ndarray"),
        "replay a list": (lambda bag, rig: replay([bag], rig), "recording: found a value of type list"),
        "replay kPa": (lambda bag, rig: replay(replace(bag, pressure=bag.pressure / 1e3), rig), "looks like kPa"),
        "replay percent": (lambda bag, rig: replay(replace(bag, voltage=bag.voltage * 10), rig), "percent"),
        "replay from": (lambda bag, rig: replay(bag, rig, begin_s="a"), "begin_s 'a': expected a number"),
        "lock angle": (lambda bag, rig: replay(bag, rig, joint="locked", lock_angle="a"), "lock_angle 'a'"),
        "identify nothing": (lambda bag, rig: identify([], rig), "no recording"),
        "identify None": (lambda bag, rig: identify(None, rig), "recording: found a value of type NoneType"),
        "identify kPa": (lambda bag, rig: identify(replace(bag, pressure=bag.pressure / 1e3), rig), "looks like kPa"),
        "diagnose degrees": (lambda bag, rig: diagnose(replace(bag, angle=90.0 + 0.0 * bag.angle), rig), "like deg"),
        "check a number": (lambda bag, rig: check(5, rig), "bag: found a value of type int"),
        "estimator": (lambda bag, rig: Estimator(bag), "rig: found a value of type Recording"),
        "read": (lambda bag, rig: read_bag(None), "bag: found a value of type NoneType"),
        "load": (lambda bag, rig: load_rig(rig), "rig: found a value of type Rig"),
        "voltages": (lambda bag, rig: simulate(rig, "steps"), "voltage: expected numbers"),
        "percent": (lambda bag, rig: simulate(rig, np.full((5, 2), 55.0)), "voltage 1 is 55"),
        "duration": (lambda bag, rig: simulate(rig, duration=-1.0), "duration -1.0: expected 0.001"),
        "seed": (lambda bag, rig: simulate(rig, duration=0.1, seed=-1), "seed -1"),
        "slice": (lambda bag, rig: bag.slice("a", 1.0), "start_s 'a'"),
        "no sample": (lambda bag, rig: bag.slice(70.0, 80.0), "no sample"),
        "seconds": (lambda bag, rig: Recording("x", bag.time_s, bag.pressure, bag.voltage), "whole numbers of ns"),
        "write": (lambda bag, rig: write_bag("x", rig), "recording: found a value of type Rig"),
    }


@pytest.mark.parametrize("what", _wrong_arguments())
def test_a_wrong_argument_is_refused_in_one_sentence(what: str, free: Recording, rig: Rig) -> None:
    call, said = _wrong_arguments()[what]
    with pytest.raises(BadInput, match=said) as refusal:
        call(free.slice(0.0, 2.0), rig)
    assert "\n" not in str(refusal.value)


def test_results_are_tables(replayed: ReplayResult, free: Recording) -> None:
    pytest.importorskip("pandas", reason="the extra [import] is not installed")
    frame = replayed.to_dataframe()
    assert len(frame) == len(replayed.run.rows)
    assert np.array_equal(frame["measured_angle_rad"], replayed.measured_angle)
    samples = free.to_dataframe()
    assert list(samples["pressure_2_Pa"]) == list(free.pressure[:, 1])
    assert "external_torque_Nm" not in samples


def test_without_pandas_a_table_says_what_to_install(replayed: ReplayResult, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(BadInput, match=r"pandas is not installed.*'pam_antagonist\[import\]'"):
        replayed.to_dataframe()


def test_a_check_is_saved(free: Recording, tmp_path: Path) -> None:
    checked = check(free.path, "shin2022")
    content = json.loads(checked.save(tmp_path / "check.json").read_text())
    assert content["joint"] == "free" and len(content["findings"]) == len(checked.findings) > 0


def test_a_simulated_recording_needs_no_bag() -> None:
    recording = simulate("shin2022", np.full((300, 2), 5.5))
    assert replay(recording, "shin2022").report.samples == 300
    with pytest.raises(BadInput, match=r"shape \(3,\)"):
        simulate("shin2022", np.zeros(3))
    with pytest.raises(BadInput, match="profile 'stairs'"):
        simulate("shin2022", profile="stairs")


def test_each_step_gives_a_row_of_its_own(rig: Rig) -> None:
    estimator = Estimator(rig)
    rows = [estimator.step(k * 1_000_000, 450e3 + 10.0 * k, 450e3, 5.5, 5.5) for k in range(1, 4)]
    kept = [row.copy() for row in rows if row is not None]
    estimator.step(5_000_000, 460e3, 450e3, 5.5, 5.5)
    assert len(kept) == 3 and all(row.tobytes() == copy.tobytes() for row, copy in zip(rows, kept, strict=True))
    assert len({float(row["pressure"][0]) for row in kept}) == 3
    first = estimator.step_in_place(6_000_000, 461e3, 450e3, 5.5, 5.5)
    before = float(first["angle"])  # type: ignore[index]
    second = estimator.step_in_place(7_000_000, 480e3, 440e3, 5.5, 5.5)
    assert float(first["angle"]) == float(second["angle"]) != before  # type: ignore[index]


def test_a_bag_is_corrected_by_the_calibration_of_its_rig() -> None:
    bag = ROOT / "examples/recordings/leak_free"
    rig = load_rig("shin2022")
    off = rig.replaced(calibration=rig.calibration.replaced(encoder_zero=0.1))
    plain, corrected = (given.as_recording(bag, one) for one in (rig, off))
    assert np.allclose(plain.angle - corrected.angle, 0.1)
    # Read elsewhere, it is taken as it is.
    assert given.as_recording(plain, off) is plain
    assert given.corrections([bag], off).encoder_zero == 0.1 and given.corrections(plain, off).encoder_zero == 0.0


def test_what_a_console_shows_is_short_and_what_it_completes_is_ours() -> None:
    rig = load_rig("shin2022")
    shown = repr(Estimator(rig, joint="locked", lock_angle=0.1))
    assert shown == "Estimator: rig shin2022, tuning default, joint locked at 0.1 rad, angle sensor none"
    for one in (rig, rig.geometry):
        assert not [name for name in dir(one) if name.startswith(("_", "model_")) or name in ("copy", "json", "dict")]
    assert {"geometry", "value", "with_value", "parameters", "plain", "replaced"} <= set(dir(rig))
