"""A recording in the wrong units or with the wrong wiring is recognised, and nothing is said of one that is right."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist import simulate
from pam_antagonist.checks import Checked, check_recording, wiring
from pam_antagonist.checks.prediction import Prediction
from pam_antagonist.errors import BadInput
from pam_antagonist.recording import Recording, read_bag
from pam_antagonist.recording.corrections import Corrections
from pam_antagonist.rig import Rig

RIG_A = Path(__file__).resolve().parents[2].parent / "shared" / "data"
Damage = Callable[[Recording], Recording]

DAMAGES: dict[str, tuple[Damage, set[str]]] = {
    "gauge": (lambda r: replace(r, pressure=r.pressure - 101_325.0), {"--gauge"}),
    "gauge kPa": (lambda r: replace(r, pressure=(r.pressure - 101_325.0) / 1e3), {"--gauge", "--pressure-unit kPa"}),
    "bar": (lambda r: replace(r, pressure=r.pressure / 1e5), {"--pressure-unit bar"}),
    "psi": (lambda r: replace(r, pressure=r.pressure / 6894.757), {"--pressure-unit psi"}),
    "pressure lines": (lambda r: replace(r, pressure=r.pressure[:, ::-1]), {"--swap-pressures"}),
    "valves": (lambda r: replace(r, voltage=r.voltage[:, ::-1]), {"--swap-valves"}),
    "encoder's sign": (lambda r: replace(r, angle=-r.angle), {"--flip-angle"}),  # type: ignore[operator]
    "degrees": (lambda r: replace(r, angle=np.degrees(r.angle)), {"--angle-unit deg"}),  # type: ignore[arg-type]
    "lines and degrees": (
        lambda r: replace(r, pressure=r.pressure[:, ::-1], angle=np.degrees(r.angle)),  # type: ignore[arg-type]
        {"--swap-pressures", "--angle-unit deg"},
    ),
}


def wrong(checked: Checked) -> set[str]:
    """Options of everything that is certainly wrong."""
    return {option for finding in checked.wrong for option in finding.options}


def test_nothing_is_said_of_a_good_recording(free: Recording, locked: Recording, rig: Rig) -> None:
    for recording in (free, locked):
        checked = check_recording(recording, rig)
        assert not checked.wrong
        assert not [finding.text for finding in checked.findings if finding.status == "doubtful"]
        assert checked.corrections == Corrections()


def test_a_rig_at_the_edge_of_what_a_file_may_hold_is_no_bad_input(rig: Rig) -> None:
    """A delay is told with areas that are 2 % larger, which no file could hold."""
    near = rig.replaced(valve_1=rig.valve_1.replaced(inflow_area=9.95e-5))
    assert check_recording(simulate(near, duration=20.0, seed=1), near).findings


@pytest.mark.parametrize("damage", DAMAGES)
def test_what_is_wrong_is_named_with_what_to_type(free: Recording, rig: Rig, damage: str) -> None:
    change, expected = DAMAGES[damage]
    damaged = change(free)
    checked = check_recording(damaged, rig)
    assert wrong(checked) == expected
    # What was found makes it the recording that it was.
    corrected = checked.corrections.applied(damaged)
    # The rig file's atmosphere is added, which is 25 Pa from the one that was subtracted.
    np.testing.assert_allclose(corrected.pressure, free.pressure, rtol=1e-4)
    np.testing.assert_array_equal(corrected.voltage, free.voltage)
    np.testing.assert_allclose(corrected.angle, free.angle, atol=1e-12)  # type: ignore[arg-type]
    assert not check_recording(corrected, rig).wrong


def test_a_torque_that_counts_the_wrong_way_round(locked: Recording, rig: Rig) -> None:
    assert wrong(check_recording(replace(locked, torque=-locked.torque), rig)) == {"--flip-torque"}  # type: ignore[operator]


def test_without_angle_and_torque_it_is_not_known_which_is_exchanged(free: Recording, rig: Rig) -> None:
    checked = check_recording(replace(free, pressure=free.pressure[:, ::-1], angle=None, torque=None), rig)
    assert len(checked.wrong) == 1
    assert not checked.wrong[0].options
    assert "--swap-pressures" in checked.wrong[0].text
    assert "--swap-valves" in checked.wrong[0].text
    assert checked.corrections == Corrections()


def test_no_green_tick_for_what_was_not_tested(free: Recording, rig: Rig) -> None:
    checked = check_recording(replace(free, angle=None, torque=None), rig)
    good = " ".join(finding.text for finding in checked.findings if finding.status == "good")
    untested = " ".join(finding.text for finding in checked.findings if finding.status == "untested")
    assert "angle" not in good
    assert "angle" in untested
    assert "torque" in untested


def test_a_sensor_that_is_not_connected(free: Recording, rig: Rig) -> None:
    pressure = free.pressure.copy()
    pressure[:, 1] = 101_325.0
    texts = [finding.text for finding in check_recording(replace(free, pressure=pressure), rig).wrong]
    assert any("pressure_2" in text and "not connected" in text for text in texts)


def test_voltages_of_another_time_are_doubted(free: Recording, rig: Rig) -> None:
    checked = check_recording(replace(free, voltage=np.roll(free.voltage, 2500, axis=0)), rig)
    assert any(finding.status == "doubtful" and "do not follow" in finding.text for finding in checked.findings)


def test_a_short_recording_is_refused(free: Recording, rig: Rig) -> None:
    with pytest.raises(BadInput, match="too short to check"):
        check_recording(free.slice(0.0, 2.0), rig)


@pytest.mark.skipif(not RIG_A.is_dir(), reason="the recordings of rig A are not part of this repository")
@pytest.mark.parametrize(
    "bag", ["rig_a/case_other/free", "rig_a/case_valve_offset/locked", "rig_a_lab/valve_play/free"]
)
def test_an_effect_is_not_taken_for_wrong_wiring(rig: Rig, bag: str) -> None:
    assert not check_recording(read_bag(RIG_A / bag, judge=False), rig).wrong


@pytest.mark.skipif(not RIG_A.is_dir(), reason="the recordings of rig A are not part of this repository")
@pytest.mark.parametrize("joint", ["free", "locked"])
def test_late_measurements_are_measured(rig: Rig, joint: str) -> None:
    checked = check_recording(read_bag(RIG_A / "rig_a_lab" / "measured_late" / joint, judge=False), rig)
    late = [finding for finding in checked.findings if "late" in finding.text and finding.status == "doubtful"]
    assert len(late) == 1
    (option,) = late[0].options
    # Rig A's recordings are stamped 22 ms late.
    assert float(option.split()[1]) == pytest.approx(22.0, abs=3.0)


def with_angle(recording: Recording, change: Callable[[np.ndarray], np.ndarray]) -> Recording:
    assert recording.angle is not None
    return replace(recording, angle=change(recording.angle))


@pytest.mark.parametrize("degrees", [-6.0, 10.0, 90.0])
def test_an_encoder_whose_zero_was_lost(free: Recording, rig: Rig, degrees: float) -> None:
    bad = with_angle(free, lambda angle: angle + np.radians(degrees))
    checked = check_recording(bad, rig)
    ((found,), (option,)) = checked.wrong, checked.corrections.options()
    assert "differs from the model's by the same at each sample" in found.text and found.options == (option,)
    assert float(option.removeprefix("--encoder-zero ")) == pytest.approx(degrees, abs=0.5)
    assert ("beyond the rig's stop of 25°" in found.text) is (degrees > 25.0)
    assert not check_recording(bad, rig, typed=checked.corrections).wrong


def test_a_torque_meter_that_was_not_tared(locked: Recording, rig: Rig) -> None:
    assert locked.torque is not None
    checked = check_recording(replace(locked, torque=locked.torque + 1.0), rig)
    (found,) = checked.wrong
    assert "the torque meter reads" in found.text and checked.corrections.torque_zero == pytest.approx(1.0, abs=0.05)


def test_one_sensor_that_jumps_is_no_reset(free: Recording, rig: Rig) -> None:
    jumped = with_angle(free, lambda angle: angle + np.radians(5.0) * (free.time_s >= 3.0))
    marked = replace(jumped, episode_ns=free.stamp_ns[[0, 3000]])
    for bad in (jumped, marked):
        (found,) = check_recording(bad, rig).wrong
        assert "the measured angle jumps at one place" in found.text and "at 3.000 s, first by +5.0°" in found.text
        assert "the zero of this sensor jumped" in found.text and "episode" not in found.text
    pressure = free.pressure + np.where(free.time_s >= 2.0, 6e4, 0.0)[:, None] * [0.0, 1.0]
    (found,) = check_recording(replace(free, pressure=pressure), rig).wrong
    assert "pressure_2 jumps at one place" in found.text and "first by +60." in found.text
    assert not check_recording(replace(free, episode_ns=free.stamp_ns[[0, 3000]]), rig).wrong


def test_one_channel_in_another_unit_is_named(free: Recording, rig: Rig) -> None:
    (found,) = check_recording(replace(free, pressure=free.pressure * [1.0, 1e-3]), rig).wrong
    assert "pressure_1 in Pa" in found.text and "pressure_2 in kPa" in found.text and not found.options
    checked = check_recording(replace(free, pressure=free.pressure - [101_325.0, 0.0]), rig)
    assert not checked.wrong
    assert any("pressure_1 seems to be gauge pressure and pressure_2 absolute" in f.text for f in checked.findings)


def test_readings_that_are_none_are_named_with_what_to_type(free: Recording, rig: Rig) -> None:
    lost = np.random.default_rng(3).random(len(free)) < 0.01
    bad = with_angle(free, lambda angle: np.where(lost, 0.0, angle))
    bad = replace(bad, pressure=np.where(lost[:, None], 101_325.0, bad.pressure))
    highest = float(np.quantile(free.pressure[:, 1], 0.6))
    for recording, words in (
        (bad, (f"{lost.sum()} rows hold exactly one value", "pressure_1 101.325 kPa", "these readings were lost")),
        (
            replace(free, pressure=np.minimum(free.pressure, [1e6, highest])),
            ("pressure_2 reads exactly", "% of the rows", "its range ends there"),
        ),
    ):
        checked = check_recording(recording, rig)
        (found,) = checked.wrong
        assert all(word in found.text for word in words) and found.options == ("--leave-out-faults",)
        # Nothing else is said of the rig, the valves or a slow sensor.
        assert not [other.text for other in checked.findings if other.status == "doubtful" or "slower" in other.text]
        again = check_recording(recording, rig, typed=checked.corrections)
        assert not again.wrong and any(f.text.endswith(": left out") for f in again.findings)


def test_a_channel_of_another_rig_is_not_only_a_wrong_unit(free: Recording, rig: Rig) -> None:
    found = check_recording(with_angle(free, lambda angle: 4.0 * angle), rig).findings
    (text,) = [finding.text for finding in found if "converted from rev" in finding.text]
    assert "a factor of 6.28" in text and "or this is a recording of another rig" in text


@pytest.mark.parametrize(("better", "options"), [("gauge", {"--gauge"}), ("absolute", set())])
def test_a_drift_from_the_voltages_alone_is_no_gauge_pressure(better: str, options: set[str]) -> None:
    """A trial with valves that are closed in the middle was refused: both pressures were 90 kPa lower (sure)."""
    model = predicted_at(np.linspace(2.5e5, 5e5, 200))
    wanted = {"gauge": 101_325.0, "absolute": 0.0}[better]
    findings, found = wiring.pressure_unit_of(
        model.pressure - 90e3, model, Corrections(), Corrections(), 1.5, False,
        lambda factor, added: 1e3 + abs(added - wanted),
    )  # fmt: skip
    assert {option for finding in findings if finding.status == "wrong" for option in finding.options} == options
    assert found.gauge == bool(options)
    assert ("these are no gauge pressures" in findings[0].text) == (better == "absolute")


def predicted_at(pressure: np.ndarray) -> Prediction:
    """A model's pressures, the same in both muscles."""
    both, none = np.column_stack([pressure, pressure]), np.zeros(len(pressure))
    return Prediction(none, both, np.zeros_like(both), none, none, np.arange(len(pressure)))
