"""The filter with states and learned laws that effects add: definite, bits of a replay, covariance, time."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest
from recordings import trial, with_effects

from pam_antagonist.estimation import Estimator
from pam_antagonist.model.effects import ADDED_STATES, CATALOGUE
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.rig.learned import Law, with_law
from pam_antagonist.simulation.plant import Plant

RIG = load_rig("shin2022")
EIGHT = ("hysteresis", "supply_droop", "creep", "thermal", "external_torque")
"""Effects with eight states in all."""
NAMED = tuple(name for name, effect in CATALOGUE.items() if not effect.of_tables)
"""Effects of single numbers."""


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


CLEAN = trial(2.0, seed=7)
HALF, END = 900, 1800
ARC = (-0.2, -0.1, 0.0, 0.1, 0.2)


def lawful(*, std: float = 0.0, memory: bool = True) -> Rig:
    rig = load_rig("shin2022")
    torque = tuple(0.02 * abs(angle) for angle in ARC)
    rig = with_law(rig, Law("torque", ARC, torque, argument="angle", std=(std,) * 5 if std else ()))
    if memory:
        nodes = (2e5, 4e5, 6e5)
        rig = with_law(rig, Law("flow", nodes, (0.0, -1e-7, -4e-7), "both", "pressure", "lag", 0.3))
        rig = with_law(rig, Law("friction", (3e5, 9e5), (0.0, 5e-3), argument="pressure_sum"))
    return rig


def samples(first: int, end: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    part = slice(first, end)
    return CLEAN.stamp_ns[part], CLEAN.pressure[part], CLEAN.voltage[part]


@pytest.fixture(scope="module")
def whole() -> np.ndarray:
    return Estimator(lawful(std=1e-2)).run(*samples(0, END)).rows


def test_sample_by_sample_it_gives_the_bits_of_the_whole(whole: np.ndarray) -> None:
    estimator = Estimator(lawful(std=1e-2))
    for k, (stamp, pressure, voltage) in enumerate(zip(*samples(0, 400), strict=True)):
        row = estimator.step(int(stamp), *pressure, *voltage)
        assert row is None or row.tobytes() == whole[k].tobytes()


@pytest.mark.parametrize("joint", ["free", "locked"])
def test_it_stays_definite_with_its_states(joint: str) -> None:
    recording = trial(4.0, seed=7, joint=joint)
    run = Estimator(lawful(std=1e-2), joint=joint).run(recording.stamp_ns, recording.pressure, recording.voltage)
    assert run.counts.processed == len(recording.stamp_ns)
    assert run.counts.repaired == run.counts.restarts == 0
    assert list(run.added) == ["law2_memory_1", "law2_memory_2"]
    assert all(np.isfinite(values).all() for values in run.added.values())


def test_the_uncertainty_of_a_law_enters_the_covariance(whole: np.ndarray) -> None:
    certain = Estimator(lawful()).run(*samples(0, END)).rows
    assert np.all(whole["covariance"][HALF:, 0, 0] > 1.05 * certain["covariance"][HALF:, 0, 0])


def test_a_filter_with_the_plant_s_law_follows_it_and_one_without_does_not() -> None:
    """A leak that opens with pressure: without it the innovations have a mean."""
    rig = with_law(load_rig("shin2022"), Law("leak", (2e5, 6e5), (0.0, 6e-9), 2, "pressure"))
    plant = Plant(rig, seed=4)
    voltage = np.repeat(np.random.default_rng(1).uniform(4.8, 6.2, (6, 2)), 250, axis=0)
    seen = [plant.step(row) for row in voltage]
    stamps = np.arange(1, len(seen) + 1, dtype=np.int64) * 1_000_000
    pressure = np.array([sample.pressure for sample in seen])
    bias = [
        abs(float(np.nanmean(Estimator(each).run(stamps, pressure, voltage).rows["innovation"][300:, 1])))
        for each in (rig, load_rig("shin2022"))
    ]
    assert bias[0] < 0.2 * bias[1]


def test_its_time_is_that_of_a_sample_period_s_small_part() -> None:
    rigs = (load_rig("shin2022"), lawful(memory=False), lawful())
    best = [1.0] * len(rigs)
    for _ in range(4):
        for k, estimator in enumerate(map(Estimator, rigs)):
            begun = time.perf_counter()
            estimator.run(*samples(0, END))
            best[k] = min(best[k], (time.perf_counter() - begun) / END)
    assert max(best) < 50e-6
