"""Recordings of a sealed joint made ready, and its base parameters without anything that holds the joint back.

`identify` calls what the loop of the torque tells "friction of the shaft". But the friction of the drive, dry friction
of the muscles and hysteresis make such a loop all alike: a base model that has it already would have decided before
anything was tested. So Coulomb friction is taken out of the base model, and whatever makes the loop must prove itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from pam_antagonist.errors import BadInput
from pam_antagonist.identification.sealed import SealedTrial, balance, closed_chambers, sealed_trial
from pam_antagonist.identification.sealed_session import refuse_moving_valves
from pam_antagonist.inference.angle_driven import SLIDING, motion_of
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.inference.trial import ANGLE, TORQUE, Trial, make_trial
from pam_antagonist.model.effects import DISTURBANCE
from pam_antagonist.recording import Recording, bag_name
from pam_antagonist.recording.joint import joint_condition
from pam_antagonist.rig import Rig

DRIVEN = "driven"
_SHORTEST = 10.0
"""[s] What is fitted and what is held out must both hold a stretch of sliding and one of sticking."""
_KEPT_EFFECTS = (DISTURBANCE,)
"""Of a rig that declares effects: this one is how the estimator finds the torque; the others are to be found."""


def made_ready(recording: Recording, rig: Rig, joint: str, holdout: float) -> Trial:
    """A recording of a sealed joint on an even grid, the torque from outside in the place of a torque meter's.

    Args:
        recording: the recording.
        rig: the sealed rig.
        joint: what the command line says of the joint.
        holdout: share at the end that no fit sees.

    Raises:
        BadInput: a recording from which nothing can be told.
    """
    name = bag_name(recording.path)
    refuse_moving_valves([(recording, name)], rig)
    told = joint_condition(recording, joint)
    if told.condition != "free":
        raise BadInput(f"{name}: the joint is {told.condition}; expected a sealed joint that is moved from outside")
    trial = make_trial(recording, rig, "free", 0.0, name)
    seconds = len(trial) * trial.dt
    if seconds < _SHORTEST:
        raise BadInput(
            f"{name}: {seconds:.1f} s is too short to tell an effect from chance; expected at least {_SHORTEST:g} s of "
            "a joint that is driven to and fro"
        )
    sealed_trial(recording, name, 1.0 - holdout)
    measured = trial.measured.copy()
    if trial.external is not None and np.isfinite(trial.external).any():
        measured[:, TORQUE] = trial.external
    else:
        measured[:, TORQUE] = np.nan
    ready = replace(trial, measured=measured, joint=DRIVEN)
    fitted, held = sweeps(ready, 0, round(len(trial) * (1.0 - holdout))), sweeps(ready, cut(ready, holdout), len(trial))
    for what, count in (("that is fitted", fitted), ("that is held out", held)):
        if count < 1:
            raise BadInput(
                f"{name}: the joint nowhere slides in the part {what}; expected a joint that is driven to and fro"
            )
    return ready


def cut(trial: Trial, holdout: float) -> int:
    """Sample from which on nothing is fitted."""
    return round(len(trial) * (1.0 - holdout) / 100.0) * 100


def sweeps(trial: Trial, first: int, last: int) -> int:
    """How often the joint slides one way in a part of a recording: that many independent sweeps it tells."""
    velocity = motion_of(trial.measured[:, ANGLE], trial.dt).velocity[first:last]
    ways = np.sign(velocity[np.abs(velocity) > SLIDING])
    return 0 if not len(ways) else 1 + int(np.sum(np.diff(ways) != 0.0))


def identified(
    recordings: Sequence[tuple[Recording, str]], rig: Rig, holdout: float, tell: Callable[[str], None]
) -> Rig:
    """The rig with the base parameters that `identify` finds in what may be fitted, without Coulomb friction.

    Args:
        recordings: each with its name.
        rig: as configured.
        holdout: share at the end of each that is not seen.
        tell: told what is being done.

    Raises:
        BadInput: recordings that tell nothing, or a law of friction that is not the paper's.
    """
    if rig.model.friction != "kikuuwe":
        raise BadInput(f"model.friction of rig {rig.name}: {rig.model.friction}; expected kikuuwe of a sealed rig")
    trials: list[SealedTrial] = [sealed_trial(recording, name, 1.0 - holdout) for recording, name in recordings]
    kept = {name: values for name, values in rig.effects.items() if name in _KEPT_EFFECTS}
    # Viscous friction that is free would imitate what was taken out.
    without = {"friction.shaft": 0.0, "friction.muscle": 0.0, "joint.viscous_friction": 0.0}
    # What is not there is not uncertain either.
    uncertain = {name: std for name, std in rig.uncertainty.items() if name not in without}
    now = moved(rig.replaced(effects=kept, uncertainty=uncertain), without)
    tell("recalibrating: closed chambers")
    for muscle in (0, 1):
        now = moved(now, closed_chambers(trials, now, muscle).values)
    if any(trial.external is not None for trial in trials):
        tell("recalibrating: balance of torques")
        now = moved(now, balance(trials, now).values)
    viscous = {name: rig.uncertainty[name] for name in ("joint.viscous_friction",) if name in rig.uncertainty}
    now = now.replaced(uncertainty={**now.uncertainty, **viscous})
    return moved(now, {"joint.viscous_friction": rig.joint.viscous_friction})
