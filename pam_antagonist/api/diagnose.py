"""``identify`` and ``diagnose``: what recordings tell of a rig, its parameters and what its model lacks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from pam_antagonist.api.given import Bag, RigGiven, as_recordings, corrections, named
from pam_antagonist.api.ways import DATA_SHEET, EPISODES, SEALED, TRIALS, way
from pam_antagonist.blas import one_blas_thread
from pam_antagonist.diagnosis import diagnose as _diagnose
from pam_antagonist.diagnosis.episodes import diagnose as _of_episodes
from pam_antagonist.diagnosis.from_pressures import diagnose as _from_pressures
from pam_antagonist.diagnosis.hypotheses import ResumeFolder
from pam_antagonist.diagnosis.preparation import Settings, silent
from pam_antagonist.errors import BadInput
from pam_antagonist.identification.episode_filter import with_filter
from pam_antagonist.identification.episodes import identify as _identify_episodes
from pam_antagonist.identification.from_pressures import identify as _identify
from pam_antagonist.identification.result import FromPressures, held_of
from pam_antagonist.identification.sealed import identify_sealed
from pam_antagonist.inference.episodes import whole_episodes
from pam_antagonist.inference.expected import with_known_curves
from pam_antagonist.inference.pressure_driven import PressureDriven
from pam_antagonist.recording import Recording, bag_name, recording_hash
from pam_antagonist.recording.joint import JointCondition
from pam_antagonist.recording.notes import sealed_muscles
from pam_antagonist.report.close_loop import DiagnoseResult
from pam_antagonist.report.episodes import EpisodesDiagnoseResult, extended
from pam_antagonist.report.identify import IdentifyResult
from pam_antagonist.report.identify_episodes import EpisodesIdentifyResult
from pam_antagonist.rig import Rig, as_rig
from pam_antagonist.shown import widened

__all__ = [
    "DiagnoseResult",
    "EpisodesDiagnoseResult",
    "EpisodesIdentifyResult",
    "IdentifyResult",
    "diagnose",
    "identify",
]

Result = DiagnoseResult | EpisodesDiagnoseResult
_Named = tuple[Recording, JointCondition, str]
_Progress = Callable[[str], None] | None


@one_blas_thread
def identify(
    recordings: Bag | Sequence[Bag],
    rig: RigGiven,
    *,
    joint: str = "auto",
    lock_angle: float | None = None,
    free: Sequence[str] = (),
    freeze: Sequence[str] = (),
    holdout: float = 1.0 / 3.0,
    starts: int = 1,
    seed: int = 0,
    jobs: int = 2,
    progress: Callable[[str], None] | None = None,
) -> IdentifyResult | EpisodesIdentifyResult:
    """Identify a rig: parameters with error bars, sensor noise, filter tuning.

    Args:
        recordings: of a free and of a locked joint, if possible with measured angle and torque. For a joint with
            pressure regulators, it may be one recording of many short episodes. Then whole episodes are held out.
        rig: start values, priors and bounds: a rig, its name or its file.
        joint: ``free``, ``locked`` or ``auto`` (found from the recordings).
        lock_angle: of a locked joint [rad], where it is known.
        free: additional free parameters, or prefixes of their names.
        freeze: parameters to hold, or prefixes of their names.
        holdout: share at the end of each recording that is not fitted, to assess the result.
        starts: number of starts of the refinement.
        seed: of further starts.
        jobs: threads.
        progress: called with a text about each step.

    Returns:
        The identified rig with all results; for episodes a result of another type.

    Raises:
        BadInput: recordings that allow no identification, or an option that is not for such recordings.

    Example:
        >>> from pam_antagonist import identify, simulate
        >>> recording = simulate("shin2022", duration=8.0, mismatch=0.02, seed=1)
        >>> result = identify(recording, "shin2022", freeze=["muscle_1.force", "muscle_2.force"])
        >>> round(result.rig.value("supply.pressure") / 1e5, 1)  # [bar]
        7.1
    """
    chosen = as_rig(rig, regulators=True)
    given = as_recordings(recordings, chosen)
    if not given:
        raise BadInput("no recording: expected one at least")
    kind = way(given, chosen)
    kind.refuse("identify", {
        "joint": joint, "lock_angle": lock_angle, "free": free, "freeze": freeze, "starts": starts, "seed": seed,
    })  # fmt: skip
    if kind is EPISODES:
        return _episodes(given, chosen, holdout, jobs, progress)
    if kind is SEALED:
        read = named([one.in_one_piece() for one in given], chosen, joint, lock_angle)
        return _sealed(read, chosen, holdout, seed, progress)
    read = named(given, chosen, joint, lock_angle)
    refuse_sealed(read, chosen)
    found = _identify(read, chosen, holdout, starts, seed, jobs, progress, free=free, frozen=freeze)
    return result_of(found, read, seed)


def refuse_sealed(read: Sequence[_Named], rig: Rig) -> None:
    """Refuse recordings of sealed muscles for a rig that lets air through its valves."""
    for recording, _, name in read:
        if sealed_muscles(recording.path):
            raise BadInput(
                f"{name}: its muscles were sealed, as the bag says, but rig {rig.name} lets air through its valves; "
                "expected a rig file with valves.sealed: true, such as config/rigs/sealed_joint.yaml"
            )


def result_of(found: FromPressures, read: Sequence[_Named], seed: int = 0) -> IdentifyResult:
    """The result of an identification from measured pressures."""
    identified, *own = (with_known_curves(each, found.start) for each in (found.rig, *found.own))
    return IdentifyResult(identified, tuple(own), found, found.held, tuple(read), seed).named()


def _sealed(read: Sequence[_Named], rig: Rig, holdout: float, seed: int, progress: _Progress) -> IdentifyResult:
    """Identify a joint with sealed muscles, with other steps and fewer parameters."""
    for _, state, name in read:
        if state.condition != "free":
            raise BadInput(
                f"{name}: the joint is {state.condition}; expected a sealed joint that an external torque moves"
            )
    found = identify_sealed([(recording, name) for recording, _, name in read], rig, holdout, progress)
    rigs = {"as_configured": found.start, "identified": found.rig}
    held = tuple(held_of(one, one, end, rigs, None) for one, end in zip(read, found.held_from, strict=True))
    return IdentifyResult(found.rig, (), found, held, tuple(read), seed).named()


def _episodes(
    recordings: Sequence[Recording], rig: Rig, holdout: float, jobs: int, progress: _Progress
) -> EpisodesIdentifyResult:
    """Identify mechanics and regulators from many short episodes."""
    if len(recordings) > 1:
        raise BadInput("several recordings, one of them with many episodes: expected the recording of episodes alone")
    joint = PressureDriven.of(recordings[0], rig, jobs=jobs)
    found = _identify_episodes(joint, holdout, progress or silent)
    source = f"identified from {bag_name(recordings[0].path)}; started from: {rig.source.strip()}"
    identified = found.rig.replaced(name=f"{rig.name}_identified", source=" ".join(source.split()))
    whole = whole_episodes(recordings[0], joint.rig.signals)
    filtered = with_filter(identified, recordings[0], whole, holdout, None, jobs, progress or silent)
    own = identified if filtered is None else filtered.rig
    return EpisodesIdentifyResult(own, found, joint, (recording_hash(recordings[0]),), filtered)


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
    store: ResumeFolder | None = None,
    also: Sequence[str] = (),
) -> Result:
    """Find the physical effect that a rig's model lacks, as ``close_loop`` does.

    Args:
        recordings: of one rig; a free and a locked joint together show most. For a sealed rig, the joint is driven to
            and fro. For a joint with pressure regulators, it may be one recording of many short episodes. Then whole
            episodes are held out.
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
        BadInput: recordings that allow no diagnosis, or an option that is not for such recordings.

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
    kind = way(every, chosen)
    kind.refuse("diagnose", {
        "joint": joint, "lock_angle": lock_angle, "seed": seed, "store": store, "also": also,
    })  # fmt: skip
    if kind is EPISODES:
        if len(fitted) > 1 or len(kept) > 1:
            expected = "expected one recording, and one to hold out at most"
            raise BadInput(f"rig {chosen.name} has pressure regulators: {expected}")
        first = PressureDriven.of(fitted[0], chosen, also, jobs)
        later = PressureDriven.of(kept[0], first.rig, jobs=jobs) if kept else None
        found = _of_episodes(first, holdout, later, progress or silent)
        episodes, last = whole_episodes(fitted[0], first.rig.signals), kept[0] if kept else None
        rig_found = extended(found, first)
        filtered = with_filter(rig_found, fitted[0], episodes, holdout, last, jobs, progress or silent)
        return EpisodesDiagnoseResult(found, first, hashes, filtered)
    settings: dict[str, Any] = {
        "joint": joint, "lock_angle": lock_angle, "holdout": holdout, "jobs": jobs, "seed": seed,
        "progress": progress or silent, "profiles": profiles, "estimator": estimator, "store": store or ResumeFolder(),
    }  # fmt: skip
    if kind in (TRIALS, DATA_SHEET):
        given = named(every, chosen, joint, lock_angle)
        diagnosis = _from_pressures(given, chosen, Settings(**settings), len(kept))
    else:
        for recording in every:
            recording.in_one_piece()
        diagnosis = _diagnose(fitted, chosen, held_out=kept, laws=True, **settings)
    whole = tuple(part.recording for part in diagnosis.by_recording if part.role == "held out")
    return widened(
        DiagnoseResult, diagnosis, start=chosen, hashes=hashes, seed=seed, kept=whole or holdout,
        typed=corrections(recordings, chosen),
    )  # fmt: skip
