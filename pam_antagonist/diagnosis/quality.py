"""What recordings can tell, and what they cannot."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from pam_antagonist.diagnosis.select import Model
from pam_antagonist.errors import BadInput
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.trial import ANGLE, TORQUE, Trial, check
from pam_antagonist.model.effects import CATALOGUE, Effect

_FAR = 5.0
_WORSE = 1.5
"""An estimator's error that has grown by so much is not chance."""
SHORTEST = 20.0
"""[s] What drifts for seconds must come several times into the fitted part, and into the rest."""


def check_trials(trials: Sequence[Trial], holdout: float) -> None:
    """Refuse recordings from which nothing can be told.

    Raises:
        BadInput: a recording that is too short or too quiet, or a share to be held out that leaves too little.
    """
    if not 0.1 <= holdout <= 0.5:
        raise BadInput(f"holdout {holdout:g}: expected a share of each recording from 0.1 to 0.5")
    for trial in trials:
        check(trial)
        duration = len(trial) * trial.dt
        if duration < SHORTEST:
            raise BadInput(
                f"{trial.name}: {duration:.1f} s is too short to tell an effect from chance; expected at least "
                f"{SHORTEST:g} s with both valves moving all the time"
            )


def implausible(experiments: Sequence[Experiment], model: Model) -> list[str]:
    """Base parameters that had to leave their prior: a wrong number in the rig file, or an effect in disguise."""
    said = []
    for experiment, fitted in zip(experiments, model.fits, strict=True):
        for direction, amount in zip(experiment.directions, fitted.point.theta, strict=False):
            if abs(amount) > _FAR * direction.prior:
                said.append(
                    f"recalibration moves {direction.name} by {100 * amount:+.0f} % in {experiment.trial.name}, "
                    f"{abs(amount) / direction.prior:.0f} standard deviations of what was expected"
                )
    return said


def unseen(trials: Sequence[Trial], invisible: Sequence[str] = ()) -> tuple[str, ...]:
    """What no analysis of these recordings can show, one sentence each.

    Args:
        trials: the recordings.
        invisible: effects that would not show in them.
    """
    conditions = {trial.joint for trial in trials}
    said = []
    if "free" not in conditions:
        moving = _listed(effect for effect in CATALOGUE.values() if effect.needs_motion)
        said.append(f"The joint was locked throughout: {moving} do not show.")
    if "locked" not in conditions:
        said.append(
            "The joint moved throughout: an error of the force is told from friction and load only by their different "
            "course; a recording with the joint locked would tell at once."
        )
    if not any(trial.has(TORQUE) for trial in trials):
        said.append("No torque was measured: an error of the force shows only where it moves the joint.")
    if "free" in conditions and not any(trial.has(ANGLE) for trial in trials if trial.joint == "free"):
        hidden = _listed(effect for effect in CATALOGUE.values() if effect.needs_angle)
        said.append(
            f"No angle was measured: of the motion only what it does to the pressures shows; {hidden} are hardly seen."
        )
    if not any(trial.has(TORQUE) or trial.has(ANGLE) for trial in trials):
        said.append(
            "Pressures alone decide here, and of a candidate that they call for the estimator's innovations: only "
            "effects of the air, the valves and their sensors can be found."
        )
    if invisible:
        said.append(
            f"Not seen in these recordings at a usual size, even if nothing else were wrong: {', '.join(invisible)}. "
            "That they were not found says nothing about them."
        )
    return tuple(said)


def _listed(effects: Iterable[Effect]) -> str:
    *others, last = (effect.title for effect in effects)
    return f"{', '.join(others)} and {last}"


def in_part(effects: Sequence[str]) -> str:
    """What is said of effects that explain much of what was there and not all."""
    which = " and ".join(dict.fromkeys(effects))
    return (
        f"beside {which} much is left beyond the sensors' noise: the effect has another form than the catalogue's law, "
        "or something smaller is there as well; see what is left"
    )


def estimator_worse(parts: Sequence[Mapping[str, Any]]) -> list[str]:
    """Recordings in which the estimator does worse with what was found than as configured.

    Args:
        parts: of the report, one a recording; those without the estimator's errors say nothing.
    """
    said = []
    for part in parts:
        errors = part.get("ukf")
        if not errors:
            continue
        for what, key, unit in (("angle", "rmse_deg", "°"), ("torque", "rmse_nm", " N m")):
            before, after = (errors[name][what] for name in ("as_configured", "extended"))
            if before and after and after[key] > _WORSE * before[key]:
                said.append(
                    f"from the pressures alone the estimator does worse in {part['recording']} with what was fitted "
                    f"here ({what} {after[key]:.2g}{unit}) than as configured ({before[key]:.2g}{unit}): base "
                    "parameters bend to what no effect explains; keep the rig file that you have"
                )
    return said


def decided(effects: Sequence[str], evidence: float, taken: bool) -> str:
    """What the innovations said where pressures alone were measured.

    Args:
        effects: that the pressures call for.
        evidence: twice the logarithm of how much likelier the held-out innovations are with them.
        taken: whether that was enough.
    """
    which = " and ".join(effects)
    if taken:
        return f"pressures alone were measured: the estimator's innovations, too, speak for {which} ({evidence:+.0f})"
    return (
        f"the pressures call for {which}, the estimator's innovations on the held-out part do not ({evidence:+.0f}): "
        "not taken; expected an angle or a torque to be measured as well"
    )
