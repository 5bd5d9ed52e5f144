"""A rig file from what a ruler, a scale and data sheets tell."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist import check, load_rig, replay, simulate
from pam_antagonist.cli import new_rig
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.model import muscle, orifice
from pam_antagonist.rig.parts import muscle_parts, regulator_parts, valve_parts

# The joint of the paper, as somebody would measure it who knows neither its force map nor its valves' areas.
MEASURED = {
    "radius": "36.5mm", "muscle": "own", "muscle-diameter": "14mm", "muscle-force": "85N", "muscle-pressure": "5bar",
    "muscle-contraction": "22", "nominal-length": "175mm", "length": "165mm", "supply": "6.1bar", "valve": "shin2022",
    "inertia": "4e-4", "mass": "256g", "shaft-radius": "6mm", "stop": "25deg",
}  # fmt: skip
BOUGHT = {
    "radius": "20mm", "muscle": "dmsp-20", "nominal-length": "0.3m", "length": "285mm", "supply": "6bar",
    "valve": "MPYE-5-M5", "inertia": "0.002", "mass": "0.5kg", "stop": "none",
}  # fmt: skip
OWN = {"drive": "regulator", "regulator": "own", "valve": None}


def typed(answers: dict[str, str], path: Path) -> list[str]:
    return ["--out", str(path), *(word for name, value in answers.items() for word in (f"--{name}", value))]


def written(answers: dict[str, str], path: Path):
    assert new_rig.main(typed(answers, path)) == 0
    return load_rig(path)


def test_a_recording_of_the_joint_passes_the_check_with_the_new_file(tmp_path, capsys):
    rig = written(MEASURED, tmp_path / "rig.yaml")
    shown = capsys.readouterr().out
    assert "identify BAG... --rig" in shown and "commission --rig" in shown
    findings = check(simulate("shin2022", duration=20.0, seed=5, mismatch=0.01), rig).findings
    assert {item.status for item in findings} <= {"good", "untested", "doubtful"}
    assert all("never identified" in item.text for item in findings if item.status == "doubtful")
    # So far off its own joint is the declared one.
    p, true = rig.parameters(), load_rig("shin2022").parameters()
    for angle in (-0.3, 0.0, 0.3):
        at = [muscle.length(0, muscle.leverage(angle, vector)[0], vector) for vector in (p, true)]
        force, real = (muscle.force(0, at[k], 450e3, vector) for k, vector in enumerate((p, true)))
        assert force == pytest.approx(real, rel=0.35)


def test_the_interval_of_the_estimate_knows_what_was_guessed(tmp_path):
    guess = written(MEASURED, tmp_path / "rig.yaml")
    # The joint itself: its valves open later, a muscle is stronger than its data sheet, and a limb weighs on it.
    valves = {name: 0.8 * guess.value(name) for name in guess.priors if name.startswith("valve_")}
    other = {"muscle_1.force.c1": 1.1 * guess.value("muscle_1.force.c1"), "effects.load_torque.constant": 0.06}
    joint = moved(guess, {**valves, **other, "effects.valve_offset.voltage_1": 0.4})
    recording = simulate(joint, duration=15.0, seed=5, mismatch=0.0)
    certain = guess.replaced(uncertainty={})
    now, then = (replay(recording, rig).report.ukf.angle for rig in (guess, certain))
    assert now.coverage95 > 0.85 and now.coverage95 > 3.0 * then.coverage95


def test_a_muscle_has_the_force_of_its_data_sheet(tmp_path):
    rig, part = written(BOUGHT, tmp_path / "rig.yaml"), muscle_parts()["DMSP-20"]
    p, pressure = rig.parameters(), part.pressure + rig.atmosphere.pressure
    # The rubber's force is 0 at a contraction of 0.7 %: below that, the muscle is stretched.
    assert muscle.force(0, 0.3 * (1.0 - 0.007), pressure, p) == pytest.approx(0.98 * part.force, rel=5e-3)
    assert 0.0 <= muscle.force(0, 0.3 * (1.0 - part.contraction), pressure, p) < 3e-3 * part.force
    assert muscle.force(0, 0.3 * (1.0 - part.contraction), rig.atmosphere.pressure, p) >= 0.0, "a muscle does not push"
    # A cylinder of the hose's diameter has about this volume, and a contracted muscle is thicker.
    volumes = [muscle.volume(0, length, p)[0] for length in (0.26, 0.28, 0.3)]
    assert volumes[2] == pytest.approx(np.pi / 4.0 * 0.02**2 * 0.3, rel=0.05)
    assert volumes[0] > volumes[1] > volumes[2]


def test_a_valve_lets_the_nominal_flow_of_its_data_sheet_through(tmp_path):
    rig = written(BOUGHT, tmp_path / "rig.yaml")
    flow = rig.value("valve_1.inflow_area") * orifice.orifice_flow(7e5, 6e5, rig.parameters())
    litres = flow / 1.189 * 60e3  # air of 20 °C and 1 bar
    assert litres == pytest.approx(valve_parts()["MPYE-5-M5"].flow, rel=1e-3)
    assert "no air pass at its middle voltage" in (tmp_path / "rig.yaml").read_text()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"radius": "36.5"}, "--radius '36.5': expected a number and its unit, such as 36.5mm"),
        ({"radius": "36.5m"}, "expected 0.002 to 0.4 m"),
        ({"supply": "6atm"}, "unknown unit"),
        ({"muscle": "DMSP-21"}, "did you mean DMSP-20?"),
        ({"muscle-force": "100N"}, "only with --muscle own"),
        ({"length": "312mm"}, "would be stretched by 7"),
        ({"length": "230mm"}, "expected more than 0"),
        ({"voltage": "10:0"}, "expected the least and the largest voltage"),
        ({"stop": "95deg"}, "expected 1 to 89 deg"),
        ({"name": "my rig"}, "--name 'my rig': expected letters, digits"),
        # Answers that contradict each other are named.
        ({"length": "312mm"}, "error: --radius, --nominal-length, --length, --stop: "),
        ({"length": "230mm"}, "error: --radius, --muscle, --nominal-length, --length, --supply, --stop: "),
        ({**OWN, "regulator-range": "8bar:9bar"}, "error: --supply, --regulator-range: "),
        ({**OWN, "regulator-range": "0bar:1mbar"}, "error: --regulator-range '1mbar': expected"),
        # The end of an order code is often left out, or has more than the size.
        ({"valve": "MPYE-5-1/8"}, "did you mean MPYE-5-1/8-LF or MPYE-5-1/8-HF?"),
        ({"valve": "MPYE-5-M5-010-B"}, "did you mean MPYE-5-M5?"),
        ({"muscle": "dmsp-20-300N"}, "did you mean DMSP-20?"),
    ],
)
def test_what_makes_no_rig_is_refused_in_one_line(tmp_path, refused, changes, message):
    answers = {name: value for name, value in {**BOUGHT, **changes}.items() if value is not None}
    refused(new_rig.main, typed(answers, tmp_path / "rig.yaml"), message)
    assert not (tmp_path / "rig.yaml").exists()


def test_what_is_missing_is_asked_for_until_the_answer_makes_sense(tmp_path, capsys, monkeypatch):
    answers = {name: value for name, value in BOUGHT.items() if name not in ("radius", "stop")}
    told = iter(["", "", "20", "20mm", "", "", "", "", "none", "", "", ""])
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True)
    monkeypatch.setattr("builtins.input", lambda prompt: next(told))
    rig = written(answers, tmp_path / "rig.yaml")
    assert (rig.name, rig.geometry.radius, rig.joint.stop) == ("my_rig", 0.02, None)
    assert "expected a number and its unit" in capsys.readouterr().out


def test_what_is_missing_and_where_no_file_can_be_written_is_named(tmp_path, refused):
    said = refused(new_rig.main, ["--out", str(tmp_path / "rig.yaml"), "--radius", "20mm"], "--muscle", "--inertia")
    assert "--radius" not in said
    refused(new_rig.main, ["--out", str(tmp_path / "none" / "rig.yaml")], "expected a file in a folder that exists")
    (tmp_path / "rig.yaml").write_text("mine")
    refused(new_rig.main, typed(BOUGHT, tmp_path / "rig.yaml"), "exists")
    assert (tmp_path / "rig.yaml").read_text() == "mine"


REGULATED = {
    **{name: value for name, value in MEASURED.items() if name != "valve"}, "drive": "regulator",
    "regulator-range": "0bar:6bar", "regulator-time": "0.035",
}  # fmt: skip


def test_a_joint_with_regulators_is_asked_for_their_range_and_time(tmp_path, capsys):
    path = tmp_path / "rig.yaml"
    assert new_rig.main(typed(REGULATED, path)) == 0
    rig = load_rig(path, regulators=True)
    assert rig.drive == "regulator"
    assert rig.command_limits == pytest.approx((101.3e3, 701.3e3))
    assert 40.0 < rig.value("effects.regulator_lag.frequency_1") < 80.0
    assert not [name for name in rig.priors if name.startswith("valve_")]
    # A joint whose regulators are as quick goes with the file.
    true = load_rig("shin2022_regulators", regulators=True)
    findings = check(simulate(true, duration=10.0, seed=5, mismatch=0.01), rig).findings
    assert {item.status for item in findings} <= {"good", "untested", "doubtful"}
    assert all("never identified" in item.text for item in findings if item.status == "doubtful")
    capsys.readouterr()
    assert new_rig.main(typed({**REGULATED, "valve": "shin2022"}, tmp_path / "other.yaml")) == 2
    assert "--valve: only with --drive valve" in capsys.readouterr().err


def test_a_regulator_of_a_name_has_the_numbers_of_its_source(tmp_path, capsys):
    path, answers = tmp_path / "rig.yaml", {**REGULATED, "supply": "7bar", "regulator": "veaa-d9"}
    del answers["regulator-range"]
    assert new_rig.main(typed(answers, path)) == 0
    assert load_rig(path, regulators=True).command_limits == pytest.approx((104.3e3, 701.3e3))
    assert "Zephyr" in path.read_text() and "hysteresis unknown and taken as none" in path.read_text()
    path = tmp_path / "with_data_sheet.yaml"
    assert new_rig.main(typed({**answers, "regulator": "VEAA-D11"}, path)) == 0
    rig = load_rig(path, regulators=True)
    assert rig.value("effects.regulator_threshold.threshold_2") == 2500.0
    assert rig.command_limits[1] == pytest.approx(801.3e3), "no more than the supply has"
    capsys.readouterr()
    assert new_rig.main(typed({**answers, "regulator-range": "0bar:6bar"}, tmp_path / "other.yaml")) == 2
    assert "--regulator-range: only with --regulator own" in capsys.readouterr().err
    assert all(part.source and part.lowest < part.highest for part in regulator_parts().values())


def test_answers_that_contradict_each_other_are_asked_again_and_no_other(tmp_path, capsys, monkeypatch):
    answers = {name: value for name, value in BOUGHT.items() if name not in ("length", "stop")}
    # Name, kind, length (too short for the muscle to pull), drive, voltage, limb, shaft, stop, three of the sensor;
    # then what belongs to the contradiction: radius, muscle, nominal length, length, supply, stop.
    told = iter([*["", "", "230mm", "", "", "", "", "none", "", "", ""], *["", "", "", "285mm", "", ""]])
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True)
    monkeypatch.setattr("builtins.input", lambda prompt: next(told))
    rig = written(answers, tmp_path / "rig.yaml")
    assert rig.geometry.length == 0.285 and rig.joint.stop is None
    said = capsys.readouterr().out
    assert "Please answer again" in said and "DMSP-10, DMSP-20" in said and "list above" not in said
    assert next(told, None) is None


def test_answers_are_not_lost_where_the_questions_end_early(tmp_path, capsys, monkeypatch):
    told = iter(["left_elbow", "pulley", "21.6mm"])

    def answer(prompt: str) -> str:
        try:
            return next(told)
        except StopIteration:
            raise KeyboardInterrupt from None

    monkeypatch.setattr(sys.stdin, "isatty", lambda: True)
    monkeypatch.setattr("builtins.input", answer)
    path = tmp_path / "rig.yaml"
    assert new_rig.main(["--out", str(path)]) == 130
    said = capsys.readouterr().err
    assert f"new_rig --out {path} --name left_elbow --kind pulley --radius 21.6mm" in said
    assert not path.exists()


@pytest.mark.parametrize(
    ("option", "given", "plain"),
    [
        ("inertia", "0.00005 kg m²", "5e-05"),
        ("inertia", "500 g·cm^2", "5e-05"),
        ("rate", "0.5kHz", "500"),
        ("sensor-bits", "16 bits", "16"),
        ("voltage", "1V : 9 V", "1:9"),
        ("stop", "25 °", "25deg"),
    ],
)
def test_a_unit_may_stand_beside_a_number_that_needs_none(tmp_path, option, given, plain):
    one = written({**BOUGHT, option: given}, tmp_path / "one.yaml")
    assert one.plain() == written({**BOUGHT, option: plain}, tmp_path / "other.yaml").plain()


@pytest.mark.parametrize("given", ["0:6bar", "0 : 6 bar", "0kPa:6bar"])
def test_a_range_may_have_its_unit_once(tmp_path, given):
    assert new_rig.main(typed({**REGULATED, "regulator-range": given}, tmp_path / "rig.yaml")) == 0
    assert load_rig(tmp_path / "rig.yaml", regulators=True).command_limits == pytest.approx((101.3e3, 701.3e3))


@pytest.mark.parametrize(
    ("option", "given", "words"),
    [
        ("inertia", "3 N m", "unknown unit 'N m' of inertia, expected one of kg m2, kg cm2"),
        ("inertia", "9 kg m²", "expected 2e-07 to 5 kg m2"),
        ("rate", "often", "expected a number and its unit, 10 to 10000 Hz"),
        ("mass", "1", "expected a number and its unit, such as 250g"),
        ("voltage", "-12:5", "expected -10 to 10 V"),
        ("voltage", "5:-5", "expected the least and the largest voltage"),
    ],
)
def test_a_number_that_cannot_be_is_refused_with_its_unit(refused, tmp_path, option, given, words):
    refused(new_rig.main, typed({**BOUGHT, option: given}, tmp_path / "rig.yaml"), f"--{option}", words)


def test_valves_behind_a_bipolar_amplifier_take_its_voltages(tmp_path):
    """The same joint, with every voltage counted from the middle; a rig file of the valve alone does not fit."""
    plain, bipolar = (
        written({**BOUGHT, "voltage": given}, tmp_path / name)
        for given, name in (("0:10", "a.yaml"), ("-5:5", "b.yaml"))
    )
    one, other = (simulate(rig, duration=12.0, seed=3) for rig in (plain, bipolar))
    assert np.allclose(other.voltage, one.voltage - 5.0, atol=1e-9) and other.voltage.min() < -1.0
    assert np.array_equal(one.pressure, other.pressure)
    assert {item.status for item in check(other, bipolar).findings} <= {"good", "untested"}
    said = [item.text for item in check(other, plain).findings if "bipolar" in item.text]
    assert len(said) == 1 and "beyond those of the rig's valves, 0 to 10 V" in said[0]
    assert not [item for item in check(one, plain).findings if "beyond those of the rig" in item.text]
