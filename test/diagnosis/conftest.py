"""Recordings of joints with something wrong, in other forms than the catalogue's."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from pam_antagonist.benchmark.battery_plants import Case
from pam_antagonist.diagnosis.experiment import Experiment
from pam_antagonist.identification.trial import make_trial
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig

Make = Callable[..., Recording]


@pytest.fixture(scope="session")
def recorded() -> Make:
    """Makes a recording: effect, muscle, form, size in noises, joint, seconds."""

    def make(
        effect: str = "none",
        muscle: int | None = None,
        form: str = "",
        size: float = 0.0,
        joint: str = "locked",
        seconds: float = 30.0,
        seed: int = 11,
    ) -> Recording:
        if effect == "none":
            return Case("none", "none", (), (), seed, ()).recording(joint, seconds)
        return Case("case", "single", ((effect, muscle),), (form,), seed, (size,)).recording(joint, seconds)

    return make


@pytest.fixture(scope="session")
def experiment_of(rig: Rig) -> Callable[[Recording, str], Experiment]:
    """Makes an experiment of a recording, two thirds of it fitted."""

    def make(recording: Recording, joint: str) -> Experiment:
        trial = make_trial(recording, rig, joint, 0.0, joint)
        return Experiment(rig, trial, len(trial) * 2 // 3 // 100 * 100)

    return make
