"""The models that the paper compares its own with (Tables III and IV), as options of the one model."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import simulate_model
from pam_antagonist.model import joint, muscle
from pam_antagonist.model import parameters as par
from pam_antagonist.rig import Rig, load_rig

COEFFICIENTS = (12.0, -25.0, -8.0, 30.0, -14.0, 3.0, -20.0)


def with_form(rig: Rig, force: str = "linear", friction: str = "kikuuwe", **friction_values: float) -> Rig:
    coefficients = {f"c{k + 1}": value for k, value in enumerate(COEFFICIENTS)}
    own = {
        name: getattr(rig, name).replaced(force=getattr(rig, name).force.replaced(**coefficients))
        for name in ("muscle_1", "muscle_2")
    }
    changed = rig.replaced(**own, friction=rig.friction.replaced(**friction_values))
    return changed.replaced(model=rig.model.replaced(force=force, friction=friction))


def published(form: str, k: float, q: float) -> float:
    c1, c2, c3, c4, c5, c6, c7 = COEFFICIENTS
    if form == "hildebrandt":
        return (c1 + c2 * k + c3 * k**2) * q + (c4 + c5 * k + c6 * k**2 + c7 * k**3)
    if form == "sarosi":
        return (c1 * q + c2) * math.exp(c3 * k) + c4 * k * q + c5 * q + c6
    return c1 + c2 * k + c3 * q + c4 * k**2 + c5 * k * q + c6 * q**2


@pytest.mark.parametrize("form", ["hildebrandt", "sarosi", "polynomial"])
@pytest.mark.parametrize("number", [0, 1])
def test_force_is_the_published_form(rig, form, number):
    p = with_form(rig, form).parameters()
    for length in (0.145, 0.165, 0.18):
        for pressure in (200e3, 450e3, 700e3):
            expected = published(form, 1.0 - length / 0.165, pressure / 1e5)
            assert muscle.force(number, length, pressure, p) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("form", ["linear", "hildebrandt", "sarosi", "polynomial"])
def test_slope_with_length_is_that_of_the_force(rig, form):
    p = with_form(rig, form).parameters()
    for length in (0.15, 0.165, 0.178):
        above, below = (muscle.force(1, length + step, 5e5, p) for step in (1e-6, -1e-6))
        assert muscle.force_length_slope(1, length, 5e5, p) == pytest.approx((above - below) / 2e-6, rel=1e-6)


def test_simple_friction_is_a_constant_force_on_the_lever(rig):
    p = with_form(rig, friction="simple").parameters()
    bound = 13.7 * 0.0365
    held, slides = joint.friction_torque(0.0, 0.99 * bound, 0.1, p)
    assert held == pytest.approx(0.99 * bound) and slides == 0.0
    for velocity in (2.0, 5.0, -5.0):
        torque, slides = joint.friction_torque(velocity, 0.0, 0.1, p)
        assert torque == pytest.approx(math.copysign(bound, velocity)) and slides == 1.0


def test_tondu_friction_falls_from_its_static_to_its_kinetic_value(rig):
    p = with_form(rig, friction="tondu").parameters()
    held, slides = joint.friction_torque(0.0, 0.1, 0.0, p)
    assert held == pytest.approx(0.1) and slides == 0.0
    slow, _ = joint.friction_torque(0.8, 0.0, 0.0, p)
    assert slow == pytest.approx((0.146 - 0.03285) * math.exp(-1.0) + 0.03285)
    fast, _ = joint.friction_torque(-50.0, 0.0, 0.0, p)
    assert fast == pytest.approx(-0.03285)


def test_without_friction_nothing_resists_and_nothing_sticks(rig):
    p = with_form(rig, friction="none").parameters()
    assert joint.friction_torque(1.0, 0.3, 0.5, p) == (0.0, 1.0)


def test_the_model_runs_with_every_law_and_each_stops_the_joint_elsewhere(rig):
    voltage = np.where(np.arange(2000)[:, None] < 200, [5.0, 5.0], [5.6, 4.6])
    ends = {}
    for law in par.FRICTION_LAWS:
        run = simulate_model(with_form(rig, friction=law), voltage, np.array([450e3, 450e3]))
        assert np.all(np.isfinite(run.angle))
        ends[law] = run.angle[-1]
    assert len({round(value, 5) for value in ends.values()}) == 4
    # The more friction, the further from the frictionless rest angle it may stay: F_r is by far the largest.
    assert abs(ends["simple"] - ends["none"]) > abs(ends["kikuuwe"] - ends["none"])


@pytest.mark.parametrize(
    ("line", "allowed"),
    [("force: polinomial", par.FORCE_FORMS), ("friction: kikuwe", par.FRICTION_LAWS)],
    ids=["force", "friction"],
)
def test_a_misspelt_option_is_refused_with_the_allowed_ones(tmp_path: Path, line: str, allowed: tuple[str, ...]):
    (tmp_path / "rig.yaml").write_text(f"based_on: shin2022\nmodel: {{{line}}}\n", encoding="utf-8")
    with pytest.raises(BadInput) as refusal:
        load_rig(tmp_path / "rig.yaml")
    assert all(f"'{value}'" in str(refusal.value) for value in allowed), refusal.value


def test_a_form_without_coefficients_is_refused(tmp_path: Path):
    (tmp_path / "rig.yaml").write_text("based_on: shin2022\nmodel: {force: sarosi}\n", encoding="utf-8")
    with pytest.raises(BadInput, match="muscle_1.force gives dF/dP"):
        load_rig(tmp_path / "rig.yaml")
