"""Laws of the model beside the paper's own: those it is compared with (Tables III and IV), and those of other rigs."""

from __future__ import annotations

import itertools
import math
import typing

import numpy as np
import pytest
from scipy.integrate import quad

from pam_antagonist.estimation import simulate_model
from pam_antagonist.model import flow, joint, muscle, orifice
from pam_antagonist.model import parameters as par
from pam_antagonist.model.force_forms import FORMS
from pam_antagonist.rig import Rig
from pam_antagonist.rig.schema import ModelForm

USUAL = {
    "linear": {"v1": 3e-3, "v2": -4e-4, "w1": 800.0, "w2": -150.0},
    "hildebrandt": dict(zip((f"c{k}" for k in range(1, 8)), (5.0, -8.0, 3.0, 12.0, 20.0, -15.0, 4.0), strict=True)),
    "sarosi": dict(zip((f"c{k}" for k in range(1, 7)), (40.0, -12.0, -4.0, 30.0, -8.0, 3.0), strict=True)),
    "polynomial": dict(zip((f"c{k}" for k in range(1, 7)), (5.0, -8.0, 3.0, 12.0, 20.0, -15.0), strict=True)),
    "braided": {"c1": 60.0, "c2": 4.0, "c3": 20.0, "c4": 60.0, "c5": 0.01, "c6": 0.17, "c7": 1.0},
}
"""Coefficients of each force law."""
LENGTHS = (0.12, 0.145, 0.1655, 0.1683, 0.175)
"""[m] Contracted, and the braided muscle beyond its nominal length."""


def changed(rig: Rig, **values: float) -> np.ndarray:
    return par.changed(rig.parameters(), {name.replace("__", "."): value for name, value in values.items()})


def with_force(rig: Rig, form: str, **changes: float) -> np.ndarray:
    """Both muscles have this law."""
    values = USUAL[form] | changes
    p = changed(rig, **{f"muscle_{i}__force__{name}": value for i in (1, 2) for name, value in values.items()})
    p[par.FORCE_FORM] = float(par.FORCE_FORMS.index(form))
    return par.refresh(p)


def published(form: str, length: float, pressure: float, rig: Rig) -> float:
    c1, c2, c3, c4, c5, c6, c7 = (*USUAL[form].values(), 0.0)[:7]
    k, q = 1.0 - length / rig.geometry.length, pressure / 1e5
    if form == "hildebrandt":
        return (c1 + c2 * k + c3 * k**2) * q + (c4 + c5 * k + c6 * k**2 + c7 * k**3)
    if form == "sarosi":
        return (c1 * q + c2) * math.exp(c3 * k) + c4 * k * q + c5 * q + c6
    if form == "polynomial":
        return c1 + c2 * k + c3 * q + c4 * k**2 + c5 * k * q + c6 * q**2
    e, gauge = 1.0 - length / c6, (pressure - rig.atmosphere.pressure) / 1e5
    rubber = 1.0 - math.exp(-c4 * (e - c5)) if e > c5 else c4 * (e - c5)
    f = c1 * (1.0 - c2 * e) * gauge - c3 * rubber
    return 0.5 * (f + math.hypot(f, c7))  # it never pushes


def test_a_rig_file_knows_every_form_and_no_other() -> None:
    assert typing.get_args(ModelForm.model_fields["force"].annotation) == tuple(FORMS)


@pytest.mark.parametrize("form", ["hildebrandt", "sarosi", "polynomial", "braided"])
def test_force_is_the_published_form(rig: Rig, form: str) -> None:
    p = with_force(rig, form)
    for number, length, pressure in itertools.product((0, 1), LENGTHS, (rig.atmosphere.pressure, 200e3, 700e3)):
        expected = published(form, length, pressure, rig)
        assert muscle.force(number, length, pressure, p) == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("form", FORMS)
def test_slope_with_length_is_that_of_the_force(rig: Rig, form: str) -> None:
    p = with_force(rig, form)
    for length in LENGTHS:
        above, below = (muscle.force(1, length + step, 5e5, p) for step in (1e-7, -1e-7))
        assert muscle.force_length_slope(1, length, 5e5, p) == pytest.approx((above - below) / 2e-7, rel=1e-4)


@pytest.mark.parametrize("name", FORMS)
def test_a_row_says_what_its_coefficients_do(rig: Rig, name: str) -> None:
    form, usual = FORMS[name], USUAL[name]
    assert set(usual) == set(form.units)

    def force(**changes: float) -> float:
        return float(muscle.force(0, 0.15, 400e3, with_force(rig, name, **changes)))

    alone = force()
    for key, value in usual.items():
        up, down = (force(**{key: value * (1.0 + way)}) - alone for way in (1e-3, -1e-3))
        assert up != 0.0, key
        linear = abs(up + down) < 1e-9 * max(abs(up), abs(alone))
        assert linear == (key not in form.bent) or (name == "braided" and abs(up + down) < 1e-2 * abs(up))
    if name != "braided":
        assert force(**{key: 1.1 * usual[key] for key in form.gains if key in usual}) == pytest.approx(1.1 * alone)
    assert {form.offset, *form.positive, *form.gains, *form.bent} <= set(form.units)
    assert not form.nominal or form.nominal in form.units


def with_friction(rig: Rig, law: str) -> Rig:
    return rig.replaced(model=rig.model.replaced(friction=law))


def test_simple_friction_is_a_constant_force_on_the_lever(rig):
    p = with_friction(rig, "simple").parameters()
    bound = 13.7 * 0.0365
    held, slides = joint.friction_torque(0.0, 0.99 * bound, 0.1, p)
    assert held == pytest.approx(0.99 * bound) and slides == 0.0
    for velocity in (2.0, 5.0, -5.0):
        torque, slides = joint.friction_torque(velocity, 0.0, 0.1, p)
        assert torque == pytest.approx(math.copysign(bound, velocity)) and slides == 1.0


def test_tondu_friction_falls_from_its_static_to_its_kinetic_value(rig):
    p = with_friction(rig, "tondu").parameters()
    held, slides = joint.friction_torque(0.0, 0.1, 0.0, p)
    assert held == pytest.approx(0.1) and slides == 0.0
    slow, _ = joint.friction_torque(0.8, 0.0, 0.0, p)
    assert slow == pytest.approx((0.146 - 0.03285) * math.exp(-1.0) + 0.03285)
    fast, _ = joint.friction_torque(-50.0, 0.0, 0.0, p)
    assert fast == pytest.approx(-0.03285)


def test_the_model_runs_with_every_law_and_each_stops_the_joint_elsewhere(rig):
    voltage = np.where(np.arange(2000)[:, None] < 200, [5.0, 5.0], [5.6, 4.6])
    ends = {}
    for law in par.FRICTION_LAWS:
        run = simulate_model(with_friction(rig, law), voltage, np.array([450e3, 450e3]))
        assert np.all(np.isfinite(run.angle))
        ends[law] = run.angle[-1]
    assert len({round(value, 5) for value in ends.values()}) == 4
    # The more friction, the further from the frictionless rest angle it may stay: F_r is by far the largest.
    assert abs(ends["simple"] - ends["none"]) > abs(ends["kikuuwe"] - ends["none"])


@pytest.mark.parametrize("kind", [0.0, 1.0])
def test_travel_is_the_integral_of_the_arm_and_bend_its_slope(rig: Rig, kind: float) -> None:
    p = changed(rig, geometry__cam_1=0.4, geometry__cam_2=-0.7)
    p[par.PULLEY] = kind
    for angle in (-0.8, -0.1, 0.5):
        travel, arm, bend = muscle.leverage(angle, p)
        whole, _ = quad(lambda x: muscle.leverage(x, p)[1], 0.0, angle)
        assert travel == pytest.approx(whole, abs=1e-12)
        ahead, behind = (muscle.leverage(angle + step, p)[1] for step in (1e-6, -1e-6))
        assert bend == pytest.approx((ahead - behind) / 2e-6, rel=1e-6)
        assert arm == pytest.approx((1.0 if kind else math.cos(angle)) + 0.4 * angle - 0.7 * angle**2)


def test_without_a_cam_the_bits_are_the_paper_s(rig: Rig) -> None:
    p = rig.parameters()
    for angle in np.linspace(-0.5, 0.5, 11):
        travel, arm, bend = muscle.leverage(angle, p)
        assert travel == -bend and travel == pytest.approx(math.sin(angle), abs=1e-15)
        assert arm == pytest.approx(math.cos(angle), abs=1e-15)


@pytest.mark.parametrize("overlap", [0.3, 0.5, 0.6])
def test_overlap_shuts_both_orifices_and_underlap_opens_both(rig: Rig, overlap: float) -> None:
    p = changed(rig, valve_1__overlap=overlap)
    supply, pressure = rig.supply.pressure, 4e5
    into, out = (orifice.orifice_flow(*pair, p) for pair in ((supply, pressure), (pressure, rig.atmosphere.pressure)))
    for alpha in np.linspace(0.0, 1.0, 21):
        filling = max(alpha - overlap, 0.0) / (1.0 - overlap)
        emptying = max(1.0 - alpha - overlap, 0.0) / (1.0 - overlap)
        net = filling * into - emptying * out
        area = rig.valve_1.inflow_area if net > 0.0 else rig.valve_1.outflow_area
        passed, drawn = flow.valve_flow(0, alpha, pressure, supply, p)
        assert passed == pytest.approx(area * net, rel=1e-12, abs=1e-18)
        assert drawn == pytest.approx(rig.valve_1.inflow_area * filling * into, rel=1e-12, abs=1e-18)
    assert flow.valve_flow(0, 1.0, pressure, supply, p)[0] == pytest.approx(rig.valve_1.inflow_area * into)


@pytest.mark.parametrize("overlap", [0.0, 0.2, 0.45, 0.5, 0.62])
@pytest.mark.parametrize("pressure", [1.5e5, 4e5, 6.9e5])
def test_open_rate_for_is_the_inverse_of_the_flow(rig: Rig, overlap: float, pressure: float) -> None:
    p = changed(rig, valve_2__overlap=overlap)
    supply = rig.supply.pressure
    ends = [flow.valve_flow(1, alpha, pressure, supply, p)[0] for alpha in (0.0, 1.0)]
    for wanted in np.linspace(*ends, 41):
        alpha = flow.open_rate_for(1, wanted, pressure, supply, p)
        assert 0.0 <= alpha <= 1.0
        assert flow.valve_flow(1, alpha, pressure, supply, p)[0] == pytest.approx(
            wanted, abs=1e-9 * max(map(abs, ends))
        )
    assert flow.open_rate_for(1, 2.0 * ends[1], pressure, supply, p) == 1.0
    assert flow.open_rate_for(1, 2.0 * ends[0], pressure, supply, p) == 0.0
