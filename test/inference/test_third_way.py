"""A further way of driving a joint is one class: all that fits and judges works with it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pytest

from pam_antagonist.diagnosis.models import Model
from pam_antagonist.diagnosis.remaining import describe
from pam_antagonist.diagnosis.residual_statistics import statistics
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.free_parameters import Candidate, moved
from pam_antagonist.inference.gauss_newton import refit, relinearised
from pam_antagonist.inference.point import Channel, Point
from pam_antagonist.inference.profile import effect_profile
from pam_antagonist.inference.starts import best_of_starts
from pam_antagonist.inference.trial import PRESSURE_1, TORQUE, Trial
from pam_antagonist.inference.unknown import Unknown, change_of
from pam_antagonist.model import dynamics
from pam_antagonist.rig import Rig

NOISE = 2e-3
"""[N m]"""


@dataclass(frozen=True, eq=False)
class RegulatorDriven(Experiment):
    """A locked joint behind pressure regulators: the measured pressures are the input, the torque is compared."""

    @cached_property
    def directions(self) -> tuple[Unknown, ...]:
        return tuple(change_of(f"muscle_{i}, gain", self._gain(i), 0.05) for i in (1, 2))

    def _gain(self, number: int) -> Mapping[str, float]:
        names = [f"muscle_{number}.force.{name}" for name in ("v1", "v2", "w1", "w2")]
        return {name: self.rig.value(name) for name in names}

    @property
    def channels(self) -> tuple[int, ...]:
        return (TORQUE,)

    @property
    def titles(self) -> tuple[Channel, ...]:
        return (Channel("Torque", "N m", 1.0),)

    @cached_property
    def measured(self) -> np.ndarray:
        return self.trial.blocks(self.trial.measured[:, [TORQUE]])

    @cached_property
    def noise(self) -> np.ndarray:
        return np.array([self.trial.noise(TORQUE)])

    def states(self, point: Point) -> tuple[np.ndarray, np.ndarray]:
        p, pressure = self.parameters(point), self.trial.measured[:, PRESSURE_1:]
        states = np.column_stack([np.zeros((len(pressure), 2)), pressure])
        load = point.effects.get("effects.load_torque.constant", 0.0)
        return states, np.array([dynamics.torque(x, p) for x in states]) + load

    def simulated_each(self, points: Sequence[Point], whole: bool = False) -> list[np.ndarray]:
        end = len(self.trial) if whole else self.fitted
        every = (self.states(point) for point in points)
        return [np.column_stack([states[:end, 0], torque[:end], states[:end, 2:]]) for states, torque in every]

    @property
    def runs_by_itself(self) -> bool:
        return False

    def signals(self, point: Point) -> dict[str, np.ndarray]:
        pressure = self.trial.blocks(self.trial.measured[:, PRESSURE_1:])
        return {"pressure 1": pressure[:, 0], "pressure 2": pressure[:, 1]}

    def candidates(self, taken: Mapping[str, float]) -> tuple[Candidate, ...]:
        return (Candidate("load_torque"),)


def experiment(rig: Rig, truth: Mapping[str, float], load: float) -> RegulatorDriven:
    """Regulators that follow two sines, two thirds of it to be fitted."""
    time = np.arange(9000) * 1e-3
    pressure = 4e5 + 1e5 * np.column_stack([np.sin(3.0 * time), np.cos(1.7 * time)])
    trial = Trial("regulated", "locked", 0.0, 1e-3, np.zeros((len(time), 2)), np.full((len(time), 4), np.nan))
    trial.measured[:, PRESSURE_1:] = pressure
    _, torque = RegulatorDriven(moved(rig, truth), trial, len(time)).states(Point(np.zeros(2)))
    trial.measured[:, TORQUE] = torque + load + np.random.default_rng(1).normal(0.0, NOISE, len(time))
    return RegulatorDriven(rig, trial, 6000)


def test_base_parameters_come_back_and_hold_on_the_part_that_was_held_out(rig) -> None:
    truth = {f"muscle_1.force.{name}": 1.03 * rig.value(f"muscle_1.force.{name}") for name in ("v1", "v2", "w1", "w2")}
    task = experiment(rig, truth, 0.0)
    found = relinearised(task, best_of_starts(task, refit(task, task.origin)))
    assert found.point.theta == pytest.approx([0.03, 0.0], abs=2e-3)
    assert np.all(abs(found.point.theta - [0.03, 0.0]) < 4.0 * np.sqrt(np.diag(found.covariance)))
    before, after = (task.held(task.residual(point, whole=True)) for point in (task.origin, found.point))
    assert task.times_noise(before)[0] > 5.0
    assert task.times_noise(after)[0] < 1.3
    gone, there = task.excess_removed(before, after)
    assert gone == pytest.approx(there) and there > 10.0


def test_an_effect_is_found_with_its_profile(rig) -> None:
    task = experiment(rig, {}, 0.05)
    (candidate,) = task.candidates({})
    (torque,) = (item for item in candidate.free if item.path == "effects.load_torque.constant")
    begun = Point(task.origin.theta, {torque.path: torque.item.scale})
    found = relinearised(task, refit(task, begun, (torque,)))
    assert found.point.effects[torque.path] == pytest.approx(0.05, abs=2e-3)
    profile = effect_profile(task, found, torque)
    assert not profile.flat
    assert abs(profile.best - 0.05) < 4.0 * profile.std
    # The 95 % interval ends where the loss is half of the chi-square's 3.84, on either side of the best value.
    best = int(np.argmin(profile.loss))
    left, right = profile.loss[best::-1], profile.loss[best:]
    assert left.max() > 1.92 and right.max() > 1.92
    low, high = np.interp(1.92, left, profile.value[best::-1]), np.interp(1.92, right, profile.value[best:])
    assert 0.5 * (high - low) == pytest.approx(1.96 * profile.std, rel=0.1)


def test_what_it_leaves_is_described_like_that_of_any_other(rig) -> None:
    names = ("v1", "v2", "w1", "w2")
    task = experiment(
        rig, {f"muscle_1.force.{name}": 1.03 * rig.value(f"muscle_1.force.{name}") for name in names}, 0.0
    )
    (row,) = statistics(task, task.origin)
    assert row.channel == "torque" and row.above_noise > 0.9
    (left,) = describe(Model((task,), (refit(task, task.origin, rounds=0),)))
    assert left.channel == "torque" and left.times_noise > 5.0 and left.depends_on["pressure"] > 0.9
