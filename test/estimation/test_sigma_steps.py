"""Sigma points side by side go where they go one by one, bit for bit, whatever effects the rig has."""

from __future__ import annotations

import numba
import numpy as np
import pytest
from recordings import with_effects

from pam_antagonist.estimation import Estimator, ukf
from pam_antagonist.estimation.estimator import parameter_sets
from pam_antagonist.model import dynamics, equilibrium, integration, lanes
from pam_antagonist.model import parameters as par
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.rig import load_rig

RIG = load_rig("shin2022")
STATES = ("hysteresis", "supply_droop", "creep", "thermal", "external_torque")
VOLTAGE = np.array([5.6, 4.7])


@pytest.fixture(scope="module")
def _on_any_machine() -> object:
    """Lanes also where they are no quicker."""
    patch = pytest.MonkeyPatch()
    patch.setattr(lanes, "FEWEST", 2)
    yield
    patch.undo()


@pytest.fixture(scope="module")
def both_ways(_on_any_machine):
    """For plain rigs and others: one by one, side by side. All of it is in compiled code that other tests need too."""
    steps = {True: integration.plain_step, False: integration.rk4_step_within}
    ways = (lanes._one_by_one, lanes._in_groups)
    return {plain: [numba.njit(error_model="numpy")(way(step)) for way in ways] for plain, step in steps.items()}


@pytest.mark.parametrize("names", [(), ("leak",), ("valve_offset", "friction"), ("creep",), STATES], ids="+".join)
def test_side_by_side_as_one_by_one(both_ways, names: tuple[str, ...]) -> None:
    rig = with_effects(*names)
    # The first of the effects is uncertain: its sets of parameters differ.
    sizes = [item for name in names[:1] for item in CATALOGUE[name].parameters if item.is_size]
    uncertain = {f"effects.{names[0]}.{item.name}": 0.1 * item.scale for item in sizes}
    rig = rig.replaced(uncertainty={**rig.uncertainty, **uncertain})
    sets = parameter_sets(rig, rig.tuning("default"))
    plain = bool(np.all(sets[:, par.PLAIN] != 0.0))
    assert plain == (not names)
    work = ukf.make_work(int(sets[0, par.STATES]), sets)
    rng = np.random.default_rng(1)
    x = equilibrium.initial_state(0.1, 420e3, 380e3, VOLTAGE, sets[0])
    work.points[:] = x * (1.0 + 1e-2 * rng.standard_normal(work.points.shape))
    # Some at a stop, one that is lost: others do not see it.
    work.points[2, :2], work.points[5] = (2.0, 3.0), np.nan
    effects = None if plain else dynamics.WITH_EFFECTS
    found = []
    for way in both_ways[plain]:
        points = work.points.copy()
        for _ in range(50):
            way(points, VOLTAGE, sets, 1e-3, effects, work)
        found.append(points)
    assert np.isfinite(found[0]).all(axis=1).sum() == len(found[0]) - 1
    assert not np.array_equal(found[0][0], found[0][1])
    assert np.array_equal(found[0], found[1], equal_nan=True)


def test_a_plain_rig_estimates_what_it_does_with_the_equations_of_all_rigs() -> None:
    plain, other = Estimator(RIG), Estimator(RIG)
    other._effects = dynamics.WITH_EFFECTS
    pressure = 4e5 + 3e3 * np.random.default_rng(2).standard_normal((400, 2))
    voltage = np.tile(VOLTAGE, (400, 1))
    stamps = np.arange(400, dtype=np.int64) * 1_000_000
    expected = other.run(stamps, pressure, voltage).rows
    assert plain.run(stamps, pressure, voltage).rows.tobytes() == expected.tobytes()
