"""``diagnose``: find the physical effect that the model of a rig lacks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from pam_antagonist.api.given import Bag, RigGiven, as_recordings, corrections, named
from pam_antagonist.diagnosis import diagnose as _diagnose
from pam_antagonist.diagnosis.checkpoint import Checkpoint
from pam_antagonist.diagnosis.episodes import diagnose as _of_episodes
from pam_antagonist.diagnosis.from_pressures import diagnose as _from_pressures
from pam_antagonist.diagnosis.learned_law import with_laws
from pam_antagonist.diagnosis.preparation import Settings, silent
from pam_antagonist.diagnosis.thresholds import SHORTEST
from pam_antagonist.errors import BadInput
from pam_antagonist.identification.from_pressures import is_for
from pam_antagonist.inference.pressure_driven import PressureDriven
from pam_antagonist.recording import Recording, bag_name, recording_hash
from pam_antagonist.report.close_loop import DiagnoseResult, PressuresDiagnoseResult
from pam_antagonist.report.episodes import EpisodesDiagnoseResult
from pam_antagonist.rig import Rig, as_rig
from pam_antagonist.shown import widened

__all__ = [
    "DiagnoseResult",
    "EpisodesDiagnoseResult",
    "PressuresDiagnoseResult",
    "are_episodes",
    "are_trials",
    "diagnose",
]

Result = DiagnoseResult | EpisodesDiagnoseResult | PressuresDiagnoseResult


def are_episodes(recordings: Sequence[Recording], rig: Rig) -> bool:
    """Whether these are many short episodes of a joint with pressure regulators."""
    return not is_for(rig) and rig.drive == "regulator" and any(one.episode_ns is not None for one in recordings)


def diagnose(
    recordings: Bag | Sequence[Bag],
    rig: RigGiven,
    *,
    joint: str = "auto",
    lock_angle: float | None = None,
    holdout: float = 1.0 / 3.0,
    held_out: Bag | Sequence[Bag] = (),
    jobs: int = 2,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
    profiles: bool = True,
    estimator: bool = True,
    store: Checkpoint | None = None,
    also: Sequence[str] = (),
) -> Result:
    """Find the physical effect that a rig's model lacks, as ``close_loop`` does.

    Args:
        recordings: of one rig; a free and a locked joint together show most. For a sealed rig, the joint is driven to
            and fro. For a joint with pressure regulators, it may be one recording of many short episodes. Then whole
            episodes are held out, and joint, lock_angle, seed, profiles, estimator and store are ignored.
        rig: as configured: a rig, its name or its file.
        joint: ``free``, ``locked`` or ``auto`` (found from the recordings).
        lock_angle: of a locked joint [rad], where it is known.
        holdout: share at the end of each recording that no fit sees.
        held_out: whole recordings of the same rig that no fit sees; the others are then fitted completely.
        jobs: threads.
        seed: of the starts of fits.
        progress: called with a text about each step.
        profiles: False leaves out profile likelihoods, which saves time.
        estimator: False leaves out the estimator before and after, which saves time.
        store: stores finished candidates; default: none.
        also: further signals of episodes that may be causes, such as another joint's pressures.

    Returns:
        The verdict with all results; for episodes a result of another type.

    Raises:
        BadInput: recordings that allow no diagnosis.

    Example:
        >>> from pam_antagonist import diagnose
        >>> found = diagnose("examples/recordings/leak_locked", "shin2022", profiles=False, estimator=False)
        >>> strongest = found.effects[0]
        >>> found.verdict, strongest.name, strongest.muscle
        ('effect', 'leak', 1)
    """
    chosen = as_rig(rig, regulators=True)
    fitted, kept = (as_recordings(given, chosen, also) for given in (recordings, held_out))
    every = (*fitted, *kept)
    hashes = tuple(recording_hash(one) for one in every)
    if are_trials(every, chosen):
        given = named([one.driven_by(chosen.drive) for one in every], chosen, joint, lock_angle)
        settings = Settings(joint, lock_angle, holdout, jobs, seed, progress or silent)
        found = _from_pressures(given, chosen, settings, len(kept))
        return PressuresDiagnoseResult(chosen, found, hashes)
    if are_episodes(every, chosen):
        if len(fitted) > 1 or len(kept) > 1:
            expected = "expected one recording, and one to hold out at most"
            raise BadInput(f"rig {chosen.name} has pressure regulators: {expected}")
        first = PressureDriven.of(fitted[0], chosen, also, jobs)
        later = PressureDriven.of(kept[0], first.rig, jobs=jobs) if kept else None
        return EpisodesDiagnoseResult(_of_episodes(first, holdout, later, progress or silent), first, hashes)
    if also:
        raise BadInput("also: expected a recording of many episodes of a joint with pressure regulators")
    for recording in every:
        recording.driven_by(chosen.drive).in_one_piece()
    run = partial(
        _diagnose, joint=joint, lock_angle=lock_angle, holdout=holdout, jobs=jobs, seed=seed,
        progress=progress or silent, profiles=profiles, estimator=estimator, store=store or Checkpoint(),
    )  # fmt: skip
    diagnosis = with_laws(run, fitted, kept, chosen, holdout, joint, lock_angle, progress or silent)
    return widened(
        DiagnoseResult,
        diagnosis,
        start=chosen,
        hashes=hashes,
        seed=seed,
        kept=tuple(bag_name(recording.path) for recording in kept) or holdout,
        typed=corrections(recordings, chosen),
    )


def are_trials(recordings: Sequence[Recording], rig: Rig) -> bool:
    """Whether effects are tried in parts of the model: for a rig of data sheets, and for short trials of any valves."""
    if is_for(rig):
        return True
    if rig.drive != "valve" or rig.valves.sealed:
        return False
    short = any(one.episode_ns is not None or one.duration_s < SHORTEST for one in recordings)
    return short and sum(one.duration_s for one in recordings) >= SHORTEST
