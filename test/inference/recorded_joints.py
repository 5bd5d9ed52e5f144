"""Recordings of joints with something wrong, in other forms than the catalogue's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.trial import make_trial
from pam_antagonist.inference.valve_driven import ValveDriven
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig
from validation.battery.plants import JOINTS, Case

Make = Callable[..., Recording]


@dataclass(frozen=True)
class Repeated(Case):
    """The same joint once more: other voltages and other noise."""

    take: int = 0

    def _random(self, joint: str, what: str) -> np.random.Generator:
        if what == "base" or not self.take:
            return super()._random(joint, what)
        return np.random.default_rng([self.seed, JOINTS.index(joint), ("voltage", "noise").index(what), self.take])


@pytest.fixture(scope="session")
def recorded() -> Make:
    """Makes a recording: effect, muscle, form, size in noises, joint, seconds; another take of the same joint."""

    def make(
        effect: str = "none",
        muscle: int | None = None,
        form: str = "",
        size: float = 0.0,
        joint: str = "locked",
        seconds: float = 30.0,
        seed: int = 11,
        take: int = 0,
    ) -> Recording:
        name = f"{effect} {take}"
        if effect == "none":
            return Repeated(name, "none", (), (), seed, (), take=take).recording(joint, seconds)
        made = Repeated(name, "single", ((effect, muscle),), (form,), seed, (size,), take=take)
        return made.recording(joint, seconds)

    return make


@pytest.fixture(scope="session")
def experiment_of(rig: Rig) -> Callable[[Recording, str], Experiment]:
    """Makes an experiment of a recording, two thirds of it fitted."""

    def make(recording: Recording, joint: str) -> Experiment:
        trial = make_trial(recording, rig, joint, 0.0, joint)
        return ValveDriven(rig, trial, len(trial) * 2 // 3 // 100 * 100)

    return make
