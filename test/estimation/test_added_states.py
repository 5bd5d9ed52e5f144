"""The filter with states that effects add: definite, the same as another's, and fast enough."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest
from recordings import trial

from pam_antagonist.estimation import Estimator
from pam_antagonist.model.effects import ADDED_STATES, CATALOGUE
from pam_antagonist.rig import Rig, load_rig

RIG = load_rig("shin2022")
EIGHT = ("hysteresis", "supply_droop", "creep", "thermal", "external_torque")
"""Effects with eight states in all."""
NAMED = tuple(name for name, effect in CATALOGUE.items() if not effect.of_tables)
"""Effects of single numbers; learned laws: test_learned.py."""


def with_effects(*names: str) -> Rig:
    """The rig with these effects at sizes that are seen."""
    effects = {
        name: {item.name: item.scale if item.is_size else item.neutral for item in CATALOGUE[name].parameters}
        for name in names
    }
    return RIG.replaced(effects=effects)


@pytest.mark.parametrize("joint", ["free", "locked"])
@pytest.mark.parametrize("names", [*((name,) for name in NAMED), EIGHT], ids="+".join)
def test_stays_definite_over_a_recording(names: tuple[str, ...], joint: str) -> None:
    recording = trial(2.0, seed=7, joint=joint)
    estimator = Estimator(with_effects(*names), joint=joint)
    run = estimator.run(recording.stamp_ns, recording.pressure, recording.voltage)
    assert run.counts.processed == len(recording.stamp_ns)
    assert run.counts.restarts == 0
    # A locked joint's angle and velocity have no variance, which is no loss of definiteness.
    free = slice(None) if joint == "free" else slice(2, None)
    assert run.counts.repaired == 0
    covariance = run.rows["covariance"][:, free, free]
    scale = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    assert np.all(scale > 0.0)
    correlation = covariance / (scale[:, :, None] * scale[:, None, :])
    assert np.linalg.eigvalsh(correlation).min() > 0.0
    states = [state for effect, state in ADDED_STATES if effect in names]
    assert list(run.added) == [state.name for state in states]
    for state in states:
        assert np.isfinite(run.added[state.name]).all()
    if joint == "free":
        assert np.sqrt(np.mean((run.rows["angle"] - recording.truth[:, 0]) ** 2)) < math.radians(2.0)


def test_the_innovation_is_in_true_pressure() -> None:
    """A sensor's offset that the rig declares is nothing to the filter: same estimates, same innovations."""
    recording = trial(3.0, seed=9)
    plain = Estimator(RIG).run(recording.stamp_ns, recording.pressure, recording.voltage).rows
    rig = RIG.replaced(effects={"pressure_sensor": {"offset_1": 5e3, "offset_2": -2e3}})
    shown = recording.pressure + np.array([5e3, -2e3])
    rows = Estimator(rig).run(recording.stamp_ns, shown, recording.voltage).rows
    for name in ("angle", "torque", "pressure", "innovation"):
        np.testing.assert_allclose(rows[name], plain[name], rtol=1e-6, atol=1e-6)


def test_eight_added_states_are_within_a_fifth_of_the_sample_period() -> None:
    """The default tuning with its considered parameters, in the best of five rounds."""
    recording, times = trial(2.0, seed=10), []
    estimator = Estimator(with_effects(*EIGHT))
    for _ in range(5):
        estimator.reset()
        begin = time.perf_counter()
        run = estimator.run(recording.stamp_ns, recording.pressure, recording.voltage)
        times.append(time.perf_counter() - begin)
    assert len(run.added) == 8
    assert min(times) / len(recording.stamp_ns) < 0.2 * RIG.sample_period
