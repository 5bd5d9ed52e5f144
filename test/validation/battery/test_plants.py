"""The battery's joints: without effects the model, with them off by what they say, never in the catalogue's form."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.model import integration
from pam_antagonist.model import parameters as par
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.recording.joint import joint_condition
from pam_antagonist.rig import load_rig
from validation.battery import physics
from validation.battery.draw import CALIBRATIONS, EFFECTS, LARGE, LEVELS, cases
from validation.battery.forms import FOREIGN, SINGLE, UNCATALOGUED, Form
from validation.battery.plants import JOINTS, KINDS, Case, staircase

RIG = load_rig("shin2022")


def case_of(form: Form, size: float, seed: int = 21) -> Case:
    muscle = 1 + seed % 2 if form.by_muscle else None
    return Case(form.name, "single", ((form.effect, muscle),), (form.name,), seed, (size,))


NOTHING = Case("nothing", "none", (), (), 5, ())


def test_every_effect_has_two_forms_or_more() -> None:
    effects = [form.effect for form in SINGLE]
    of_valves = {name for name, effect in CATALOGUE.items() if "valve" in effect.tested_with}
    # Slack has no size that could be graded: a muscle only pulls, or it does not.
    assert set(effects) == set(EFFECTS) == of_valves - {"slack"}
    assert all(effects.count(name) >= 2 for name in EFFECTS)
    assert len({form.name for form in (*SINGLE, *FOREIGN)}) == len(SINGLE) + len(FOREIGN)
    assert not {form.effect for form in FOREIGN} & set(CATALOGUE)
    assert len(FOREIGN) >= 5


@pytest.mark.parametrize("joint", JOINTS)
def test_without_effects_it_is_the_model_at_a_finer_step(joint: str) -> None:
    seconds, substeps = 10.0, 4
    case = NOTHING
    voltage = case.voltage(joint, seconds)
    p = par.changed(case.parameters(joint), {"friction.time_step": 1e-3 / substeps})
    x = np.array([0.0, 0.0, 450e3, 450e3])
    for _ in range(physics.SETTLING * substeps):
        integration.rk4_step(x, voltage[0], p, 1e-3 / substeps, x)
        x[2:] = 450e3
    # ``simulate`` shows the start first, the battery the end of the first period.
    states, torques, _ = integration.simulate(x, np.vstack([voltage[:1], voltage]), p, 1e-3, substeps)
    shown = case.channels(joint, seconds)
    np.testing.assert_allclose(shown.pressure, states[1:, 2:], rtol=1e-9)
    np.testing.assert_allclose(shown.angle, states[1:, 0], atol=1e-9)
    np.testing.assert_allclose(shown.torque, torques[1:], atol=1e-7)
    assert np.ptp(shown.pressure, axis=0).min() > 50e3


@pytest.mark.parametrize("form", [*SINGLE, *FOREIGN, *UNCATALOGUED], ids=lambda form: form.name)
def test_a_size_is_what_a_channel_moves_in_noises(form: Form) -> None:
    size = min(10.0, form.largest)
    # Pushes are spread over a minute; the others show in less.
    moved = case_of(form, size).moved(60.0 if form.effect == "external_torque" else 30.0)
    assert all(np.isfinite(list(moved.values())))
    assert 0.3 * size < max(moved.values()) < 4.0 * size, moved
    assert moved["locked angle"] == 0.0


@pytest.mark.parametrize("form", [form for form in SINGLE if form.by_muscle], ids=lambda form: form.name)
def test_a_muscle_s_effect_leaves_the_other_s_pressure(form: Form) -> None:
    for seed, own, other in ((20, 1, 2), (21, 2, 1)):
        moved = case_of(form, min(10.0, form.largest), seed).moved(12.0)
        # Warming up changes the force only, and a locked joint does no work.
        assert moved["free angle" if form.effect == "warm_up" else f"locked pressure_{own}"] > 0.5
        assert moved[f"locked pressure_{other}"] == 0.0


def test_recordings_are_like_those_of_a_laboratory() -> None:
    case = cases(3, 1)[0][1]
    free, locked = case.recordings(20.0)
    for recording, joint in ((free, "free"), (locked, "locked")):
        assert len(recording) == 20_000
        assert recording.sample_period_s == pytest.approx(1e-3)
        assert joint_condition(recording).condition == joint
        assert recording.pressure[:20] == pytest.approx(450e3, abs=5e3)
        assert np.abs(recording.angle[:20]).max() < np.radians(2.0)
        steps = recording.pressure / RIG.sensors.pressure_step
        np.testing.assert_allclose(steps, np.rint(steps), atol=1e-6)
        true = case.channels(joint, 20.0)
        noise = np.std(recording.pressure - true.pressure)
        assert noise == pytest.approx(np.hypot(RIG.sensors.pressure_std, RIG.sensors.pressure_step / 12**0.5), rel=0.05)
        assert np.std(recording.torque - true.torque) == pytest.approx(RIG.sensors.torque_std, rel=0.05)
        assert recording.external_torque is None
    assert np.all(case.channels("locked", 5.0).angle == 0.0)


def test_voltages_are_steps_and_ramps_within_the_valves_range() -> None:
    time = np.arange(1, 60_001) * 1e-3
    for seed in range(20):
        voltage = staircase(time, np.random.default_rng(seed))
        assert voltage.shape == (60_000, 2)
        assert voltage.min() > 4.1 and voltage.max() < 8.01
        levels = voltage * 4096 / 10
        np.testing.assert_allclose(levels, np.rint(levels), atol=1e-6)
        jumps = np.abs(np.diff(voltage, axis=0)).max(axis=1) > 0.05
        assert 1 <= jumps.sum() <= 20


def test_a_battery_holds_all_kinds_and_all_forms() -> None:
    battery = [case for _, case in cases(1, 80)]
    counts = {kind: sum(case.kind == kind for case in battery) for kind in KINDS}
    assert counts == {"single": 40, "pair": 16, "none": 12, "foreign": 12, "calibration": 0}
    assert {case.effects[0][0] for case in battery if case.kind == "single"} == set(EFFECTS)
    assert len({case.seed for case in battery}) == 80
    largest = {form.name: form.largest for form in (*SINGLE, *FOREIGN)}
    for case in battery:
        assert len(case.effects) == len(case.form) == len(case.sizes) == {"none": 0, "pair": 2}.get(case.kind, 1)
        assert case.exact and set(case.form) <= set(largest)
        if case.kind == "pair":
            assert case.effects[0][0] != case.effects[1][0]
    # In a battery that is long enough, every form has been drawn.
    long = [case for _, case in cases(1, 800)]
    assert {case.form[0] for case in long if case.kind == "single"} == {form.name for form in SINGLE}
    assert {case.form[0] for case in long if case.kind == "foreign"} == {form.name for form in FOREIGN}


def test_sizes_of_every_effect_are_on_the_grid() -> None:
    # Each effect with each of the levels, once.
    count = 2 * len(EFFECTS) * len(LEVELS)
    single = [case for _, case in cases(1, count) if case.kind == "single"]
    drawn = sorted((case.effects[0][0], case.sizes[0]) for case in single)
    assert drawn == sorted((name, level) for name in EFFECTS for level in LEVELS)
    for _, case in cases(1, count):
        if case.kind != "single":
            assert all(LARGE <= size <= LEVELS[-1] for size in case.sizes)


def test_further_cases_whose_only_fault_is_a_calibration() -> None:
    battery = cases(1, 5, 0, 24)
    assert battery[:5] == cases(1, 5)
    assert cases(1, 0, 2, 24)[2:] == battery[5:]
    assert {case.form[0] for _, case in battery[5:]} == set(CALIBRATIONS)
    zero = next(case for _, case in battery if case.form == ("encoder_zero",))
    late = next(case for _, case in battery if case.form == ("delay_pressure",))
    right = dataclasses.replace(zero, calibration=None).recording("free", 3.0)
    assert zero.recording("free", 3.0).angle == pytest.approx(right.angle + zero.calibration[1])
    right, read = (case.recording("free", 3.0) for case in (dataclasses.replace(late, calibration=None), late))
    shift = round(late.calibration[1] / 1e-3)  # stamps too early: the same values come sooner
    inside = slice(100, -100)
    assert read.pressure[inside] == pytest.approx(np.roll(right.pressure, -shift, axis=0)[inside])
    assert np.array_equal(read.voltage, right.voltage)


@pytest.mark.parametrize("size", [0.5, 16.0])
@pytest.mark.parametrize("name", ["seeping", "dead time", "bristles", "smooth pushes", "worn edge"])
def test_sizes_are_exact(name: str, size: float) -> None:
    form = next(form for form in SINGLE if form.name == name)
    case = dataclasses.replace(case_of(form, size), exact=True)
    free = {channel: value for channel, value in case.moved(60.0).items() if channel.startswith("free")}
    assert max(free.values()) == pytest.approx(case.reached[0], rel=1e-6)
    assert case.reached[0] == pytest.approx(size, rel=0.2)


def test_the_same_seed_is_the_same_battery_and_another_is_not() -> None:
    assert cases(4, 30) == cases(4, 60)[:30]
    assert cases(4, 30) != cases(5, 30)
    one, other = (cases(4, 2)[1][1].recording("locked", 3.0) for _ in range(2))
    assert np.array_equal(one.pressure, other.pressure) and np.array_equal(one.torque, other.torque)


def test_a_battery_of_one_effect_takes_its_forms_in_turn() -> None:
    forms = [form.name for form in SINGLE if form.effect == "friction"]
    battery = [case for _, case in cases(1, 3 * len(forms), effect="friction")]
    assert {case.effects for case in battery} == {(("friction", None),)}
    assert {case.kind for case in battery} == {"single"}
    assert sorted(case.form[0] for case in battery) == sorted(3 * forms)
    assert {case.sizes[0] for case in battery} == {level for level in LEVELS if level >= LARGE}
    with pytest.raises(BadInput, match="the effect 'frictoin' has no forms here; expected one of hysteresis"):
        cases(1, 1, effect="frictoin")
