"""The rig files hold Table II: every number of the YAML against the paper's, typed in by hand."""

from __future__ import annotations

import numpy as np
import pytest
import transcription as paper

from pam_antagonist.errors import BadInput
from pam_antagonist.model import parameters as par
from pam_antagonist.rig import load_rig

WHERE = {
    "r": "geometry.radius",
    "L_0": "geometry.length",
    "r_p": "joint.shaft_radius",
    "M": "joint.mass",
    "g": "joint.gravity",
    "J": "joint.inertia",
    "k_s": "joint.stiffness",
    "c_s": "joint.viscous_friction",
    "P_tank": "supply.pressure",
    "P_out": "atmosphere.pressure",
    "k": "gas.heat_ratio",
    "R": "gas.constant",
    "T": "gas.temperature",
    "k_1": "gas.polytropic_flow",
    "k_2": "gas.polytropic_volume",
    "T_p'": "friction.muscle",
    "mu_s": "friction.shaft",
    **{f"p_{letter}{n}{i}": f"muscle_{i}.force.{letter}{n}" for letter in "vw" for n in (1, 2) for i in (1, 2)},
}
"""Symbol in the table -> place in the rig file, where there is one place."""
SHARED = {
    **{f"D_{n}": [f"muscle_{i}.volume.d{n}" for i in (1, 2)] for n in (1, 2, 3)},
    "A_11": ["valve_1.inflow_area", "valve_2.inflow_area"],
    "A_12": ["valve_1.outflow_area", "valve_2.outflow_area"],
}
"""Symbols that stand for both muscles or both valves."""


@pytest.mark.parametrize(("name", "table"), [("shin2022", paper.CORRECTED), ("shin2022_as_printed", paper.AS_PRINTED)])
def test_rig_holds_the_table(name, table):
    rig = load_rig(name)
    assert set(WHERE) | set(SHARED) == set(paper.TABLE_II)
    for symbol, place in WHERE.items():
        assert rig.value(place) == table[symbol], f"{symbol} at {place}"
    for symbol, places in SHARED.items():
        for place in places:
            assert rig.value(place) == table[symbol], f"{symbol} at {place}"
    assert rig.sample_period == table["T_stp"]
    assert rig.joint.stop == pytest.approx(table["stop"], rel=1e-12)
    assert rig.friction.pressure_floor == table["gauge_floor"]
    for valve in (rig.valve_1, rig.valve_2):
        assert list(zip(valve.curve.voltage, valve.curve.open_rate, strict=True)) == table["curve"]


def test_the_two_rigs_differ_in_one_sign_only():
    corrected, printed = (load_rig(name).parameters() for name in ("shin2022", "shin2022_as_printed"))
    changed = np.flatnonzero(corrected != printed)
    assert changed.tolist() == [par.INDEX["muscle_2.force.w2"]]
    assert printed[changed[0]] == -corrected[changed[0]] == -15.75


def test_published_tuning_is_the_paper_s():
    tuning = load_rig("shin2022").tuning("published")
    assert tuning.initial == (1e-5, 1e-4, 1e6, 1e6)
    assert tuning.process == (1e-5, 1e-4, 1e6, 1e6)
    assert tuning.measurement == (1e8, 1e8)
    assert tuning.kappa == 0.0
    assert tuning.consider is False


def test_vector_holds_each_value_where_its_name_says(rig):
    p = rig.parameters()
    for name, index in par.INDEX.items():
        assert p[index] == (rig.sample_period if name == "friction.time_step" else rig.value(name)), name


def test_derived_constants_follow_a_change(rig):
    """The constants of equation (5) are made anew when the gas changes: helium, say."""
    changed = rig.parameters(changes={"gas.heat_ratio": 1.667, "gas.constant": 2077.0})
    assert changed[par.CRITICAL_RATIO] == pytest.approx((2 / 2.667) ** (1.667 / 0.667), rel=1e-14)
    helium = {**paper.CORRECTED, "k": 1.667, "R": 2077.0}
    assert changed[par.CHOKED_FLOW] * 7e5 == pytest.approx(paper.nozzle(helium, 7e5, 1e5), rel=1e-12)


def test_a_number_that_does_not_exist_is_refused_with_the_nearest_one(rig):
    for name, nearest in (("joint.inertai", "joint.inertia"), ("effects.leak.area1", "effects.leak.area_1")):
        with pytest.raises(BadInput, match=f"unknown '{name}'.*did you mean '{nearest}'"):
            rig.value(name)
