"""Laws of the model beside the paper's own: those it is compared with (Tables III and IV), and those of other rigs."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad

from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import simulate_model
from pam_antagonist.model import flow, joint, muscle, orifice
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


BRAIDED = {"c1": 250.0, "c2": 3.2, "c3": 300.0, "c4": 60.0, "c5": 0.01, "c6": 0.17, "c7": 2.0}


def changed(rig: Rig, **values: float) -> np.ndarray:
    return par.changed(rig.parameters(), {name.replace("__", "."): value for name, value in values.items()})


def braided(rig: Rig, **values: float) -> np.ndarray:
    p = changed(
        rig, **{f"muscle_{i}__force__{name}": value for i in (1, 2) for name, value in (BRAIDED | values).items()}
    )
    p[par.FORCE_FORM] = float(par.FORCE_FORMS.index("braided"))
    return par.refresh(p)


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


def test_a_braided_muscle_is_its_published_form_and_never_pushes(rig: Rig) -> None:
    p = braided(rig)
    c, outside = BRAIDED, rig.atmosphere.pressure
    for length in np.linspace(0.12, 0.175, 12):
        for gauge in (0.0, 0.5e5, 2e5, 6e5):
            e = 1.0 - length / c["c6"]
            rubber = 1.0 - math.exp(-c["c4"] * (e - c["c5"])) if e > c["c5"] else c["c4"] * (e - c["c5"])
            f = c["c1"] * (1.0 - c["c2"] * e) * gauge / 1e5 - c["c3"] * rubber
            expected = 0.5 * (f + math.hypot(f, c["c7"]))
            assert muscle.force(0, length, outside + gauge, p) == pytest.approx(expected, rel=1e-10)
            assert expected > 0.0


def test_slope_of_a_braided_muscle_is_that_of_its_force(rig: Rig) -> None:
    p = braided(rig)
    for length in (0.14, 0.165, 0.1683, 0.174):
        above, below = (muscle.force(1, length + step, 5e5, p) for step in (1e-7, -1e-7))
        assert muscle.force_length_slope(1, length, 5e5, p) == pytest.approx((above - below) / 2e-7, rel=1e-4)
