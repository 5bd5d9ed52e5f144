"""The catalogue of effects: what is at its neutral value is not there; rig files and docs/effects.md say the same."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import Estimator
from pam_antagonist.model import drive, dynamics, equilibrium, integration
from pam_antagonist.model import parameters as par
from pam_antagonist.model.effects import CATALOGUE, parameter_path
from pam_antagonist.model.effects.registry import catalogue
from pam_antagonist.rig import load_rig
from pam_antagonist.rig.file import write_rig
from pam_antagonist.simulation import excitation

VOLTAGE = excitation.profile("steps", 8.0, 1e-3, seed=6)
NAMES = (
    "hysteresis", "leak", "supply_droop", "valve_lag", "valve_offset", "line_resistance", "pressure_sensor",
    "load_torque", "friction", "creep", "thermal", "external_torque", "valve_play", "warm_up", "slack",
    "friction_by_pressure", "friction_by_signal", "load_by_signal", "strength_by_signal", "regulator_limits",
    "regulator_threshold", "regulator_dead_time", "regulator_lag", "limb_weight",
    "weak_laws", "learned",
)  # fmt: skip
"""As reports call them."""


def run(p: np.ndarray, substeps: int = 1, start: np.ndarray | None = None):
    if start is None:
        start = equilibrium.initial_state(0.05, 430e3, 470e3, VOLTAGE[0], p)
    return drive.simulate(start, VOLTAGE, p, 1e-3, substeps)


def same(one, other) -> None:
    for a, b in zip(one, other, strict=True):
        assert np.array_equal(a, b)


@pytest.mark.parametrize("joint", ["free", "locked"])
@pytest.mark.parametrize("name", CATALOGUE)
def test_sizes_of_zero_are_the_base_model_whatever_the_shapes(rig, name, joint):
    shapes = {item.name: item.high for item in CATALOGUE[name].parameters if not item.is_size}
    sizes = {item.name: 0.0 for item in CATALOGUE[name].parameters if item.is_size}
    angle = 0.05 if joint == "locked" else 0.0
    base = rig.parameters(joint, angle)
    with_effect = rig.replaced(effects={name: {**shapes, **sizes}}).parameters(joint, angle)
    assert int(with_effect[par.STATES]) == 4
    whole = run(base)
    assert np.ptp(whole[0][:, 2:], axis=0).min() > 100e3, "the valves did not move the pressures"
    same(run(with_effect), whole)


def test_sensors_show_the_pressure_itself(rig):
    p = rig.parameters()
    for pressure in np.random.default_rng(1).uniform(90e3, 720e3, 100):
        for muscle in (0, 1):
            assert dynamics.reading(muscle, pressure, p) == pressure
            assert dynamics.pressure_behind(muscle, pressure, p) == pressure


@pytest.mark.parametrize("joint", ["free", "locked"])
def test_the_general_kernel_is_the_scalar_one(rig, joint):
    """With a fifth state that does nothing, all goes through the general kernel, with the same bits."""
    base = rig.parameters(joint, 0.05 if joint == "locked" else 0.0)
    general = par.changed(base, {parameter_path("external_torque", "noise"): 0.1})
    assert int(general[par.STATES]) == 5
    states, torques, sigma = run(general, substeps=2)
    assert np.all(states[:, 4] == 0.0)
    same((states[:, :4], torques, sigma), run(base, substeps=2))


def test_a_state_comes_with_its_size_and_goes_with_it(rig):
    p = rig.parameters()
    for effect in CATALOGUE.values():
        for state in effect.states:
            for switch in (state.switch, *state.further):
                item = next(entry for entry in effect.parameters if entry.name == switch)
                assert item.is_size
                there = par.changed(p, {parameter_path(effect.name, item.name): item.scale})
                brought = [s.name for s in effect.states if switch in (s.switch, *s.further)]
                assert state.name in brought
                assert par.added_states(there) == brought
                assert int(there[par.STATES]) == 4 + len(brought)
                assert np.array_equal(par.changed(there, {parameter_path(effect.name, item.name): 0.0}), p)


def test_the_catalogue_has_the_effects_of_reports_and_definite_states():
    """Its registry refuses effects that are not whole."""
    assert tuple(CATALOGUE) == NAMES
    for effect in CATALOGUE.values():
        assert all(item.low < item.scale < item.high for item in effect.parameters)
        assert all(state.initial_std > 0.0 for state in effect.states)
        assert all(isinstance(state.noise, str) or state.noise >= 0.0 for state in effect.states)


SINGLE_NUMBERS = {name: effect for name, effect in CATALOGUE.items() if not effect.of_tables}
"""Learned laws are tables: test/rig/test_learned.py."""


def rig_file(folder: Path, body: str) -> Path:
    path = folder / "rig.yaml"
    path.write_text(f"based_on: shin2022\nname: trial\n{body}", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("effects: {hysterese: {width: 1.0e-3}}", ["effects", "'hysterese'", "did you mean 'hysteresis'", "creep"]),
        ("effects: {leak: {aera_1: 1.0e-9}}", ["effects.leak", "'aera_1'", "did you mean 'area_1'", "area_2"]),
        ("effects: {leak: {area: 1.0e-9}}", ["effects.leak", "'area'", "expected one of area_1, area_2"]),
        ("effects: {leak: {area_1: -1.0e-9}}", ["effects.leak.area_1", "-1e-09", "0 to 5e-08 m2", "leak of muscle 1"]),
        ("effects: {valve_lag: {time_2: 12.0}}", ["effects.valve_lag.time_2", "12", "0 to 2 s"]),
        (
            "effects: {valve_lag: {time_1: 1.0e-4}}",
            ["effects.valve_lag.time_1", "0.0005 s, or 0 for none", "integration"],
        ),
        (
            "sample_period: 0.01\neffects: {valve_lag: {time_1: 4.0e-4}}",
            ["effects.valve_lag.time_1", "at least 0.0005 s, or 0 for none"],
        ),
        ("effects: {creep: {time: 0.0}}", ["effects.creep.time", "0.2 to 60 s", "time constant"]),
        ("effects: {creep: {share_1: .nan}}", ["effects.creep.share_1"]),
        ("effects: {leak: 3.0}", ["effects.leak"]),
        ("effects: {leak: {area_1: large}}", ["effects.leak.area_1"]),
        ("effects: {leak: {area_1: true}}", ["effects.leak.area_1", "expected a number"]),
        ("uncertainty: {effects.leak.area_3: 1.0e-9}", ["effects.leak.area_3", "did you mean"]),
        ("directions: {one: {effects.leak.aera_1: 1.0e-9}}", ["directions.one", "did you mean 'effects.leak.area_1'"]),
    ],
)
def test_refused(tmp_path, body, words):
    path = rig_file(tmp_path, body)
    with pytest.raises(BadInput) as error:
        load_rig(path)
    message = str(error.value)
    assert message.startswith(f"{path}: ") and "\n" not in message
    assert all(word in message for word in words), message


@pytest.mark.parametrize("period", [1e-3, 1e-2])
def test_the_quickest_time_that_is_allowed_does_not_diverge(tmp_path, period):
    body = "effects: {valve_lag: {time_1: 5.0e-4}, line_resistance: {resistance_2: 1.0e+8, time: 1.0e-3}}"
    # Steps are no longer than 1 ms at any rate, so that the least time does not depend on it.
    rig = load_rig(rig_file(tmp_path, f"sample_period: {period}\n{body}"))
    p = rig.parameters()
    voltage = excitation.profile("steps", 5.0, period, seed=1)
    start = equilibrium.initial_state(0.0, 450e3, 450e3, voltage[0], p)
    states, torques, _ = drive.simulate(start, voltage, p, period, integration.substeps_of(period))
    assert np.all(np.isfinite(states)) and np.all(np.isfinite(torques))
    assert 0.0 <= states[:, 4].min() and states[:, 4].max() <= 1.0


def test_values_reach_the_physics_and_the_others_are_neutral(tmp_path):
    rig = load_rig(rig_file(tmp_path, "effects: {creep: {share_2: 0.1}, leak: {area_1: 2.0e-9}}"))
    p = rig.parameters()
    assert par.added_states(p) == ["creep_2"]
    named = {parameter_path("creep", "share_2"): 0.1, parameter_path("leak", "area_1"): 2e-9}
    for effect in CATALOGUE.values():
        for item in effect.parameters:
            path = parameter_path(effect.name, item.name)
            assert rig.value(path) == p[par.INDEX[path]] == named.get(path, item.neutral)
    assert np.array_equal(load_rig("shin2022").parameters(changes=named), p)


def test_bounds_themselves_are_allowed(tmp_path):
    for bound in ("low", "high"):
        lines = ["effects:"]
        # A rig with valves has no regulators.
        for effect in (effect for name, effect in SINGLE_NUMBERS.items() if not name.startswith("regulator_")):
            lines.append(f"  {effect.name}:")
            lines += [f"    {item.name}: {getattr(item, bound):.6e}" for item in effect.parameters]
        rig = load_rig(rig_file(tmp_path, "\n".join(lines)))
        assert np.all(np.isfinite(rig.parameters()[: par.LOCKED]) | np.isinf(rig.parameters()[: par.LOCKED]))


def test_what_is_written_is_what_was_there(tmp_path):
    effects = {
        effect.name: {item.name: item.scale if item.is_size else item.neutral for item in effect.parameters}
        for effect in SINGLE_NUMBERS.values()
    }
    rig = load_rig("shin2022")
    whole = rig.replaced(
        drive="regulator",
        effects=effects,
        uncertainty={**rig.uncertainty, "effects.hysteresis.amplitude_1": 0.3},
        directions={
            "first": {"effects.creep.share_1": -0.01, "friction.shaft": 0.004},
            "second": {"gas.constant": 1.5},
        },
        tunings={"default": rig.tuning("default").replaced(states={"creep_1": (9.0, 1e-7)})},
    )
    write_rig(whole, tmp_path / "written.yaml", ["Made by a test."])
    again = load_rig(tmp_path / "written.yaml", regulators=True)
    assert again == whole
    assert np.array_equal(again.parameters(), whole.parameters())
    text = (tmp_path / "written.yaml").read_text(encoding="utf-8")
    for effect in SINGLE_NUMBERS.values():
        assert effect.meaning in text
        assert all(f"{item.meaning} [{item.unit}]" in text for item in effect.parameters)
    # The estimator takes it as it is.
    row = Estimator(again).step(1, 450e3, 450e3, 450e3, 450e3)
    assert row is not None and np.isfinite(row["torque"])


ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")


def test_what_a_sealed_joint_shows():
    paragraph = TEXT.split("**A sealed joint**")[1].split("\n\n")[0]
    assert set(re.findall(r"`(\w+)`", paragraph)) == {name for name, item in CATALOGUE.items() if item.sealed.part}


def test_a_loop_of_a_sealed_joint_names_parameters_of_its_effect() -> None:
    friction = CATALOGUE["friction"]
    assert friction.sealed.loop is not None
    wrong = replace(friction.sealed, loop=replace(friction.sealed.loop, sizes=("coulombs",)))
    with pytest.raises(BadInput, match=r"friction.*sealed\.loop.*coulomb"):
        catalogue([replace(friction, sealed=wrong)])
