"""``identify``: a rig's parameters, noise and tuning from its recordings."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from pam_antagonist.api.diagnose import are_episodes
from pam_antagonist.api.given import Bag, RigGiven, as_recordings, named
from pam_antagonist.blas import one_blas_thread
from pam_antagonist.errors import BadInput
from pam_antagonist.identification.episodes import identify as _of_episodes
from pam_antagonist.identification.from_pressures import identify as _identify
from pam_antagonist.identification.result import held_of
from pam_antagonist.identification.sealed import identify_sealed
from pam_antagonist.inference.expected import with_known_curves
from pam_antagonist.inference.pressure_driven import PressureDriven
from pam_antagonist.recording import Recording, bag_name, recording_hash
from pam_antagonist.recording.joint import JointCondition
from pam_antagonist.recording.notes import sealed_muscles
from pam_antagonist.report.identify import IdentifyResult
from pam_antagonist.report.identify_episodes import EpisodesIdentifyResult
from pam_antagonist.rig import Rig, as_rig

__all__ = ["EpisodesIdentifyResult", "IdentifyResult", "identify"]

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
            pressure regulators, it may be one recording of many short episodes. Then whole episodes are held out, and
            joint, lock_angle, starts and seed are ignored.
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
        BadInput: recordings that allow no identification, or that are not of one rig.

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
    if are_episodes(given, chosen):
        return _episodes(given, chosen, [*free, *freeze], holdout, jobs, progress)
    sealed = chosen.valves.sealed
    driven = [one.driven_by(chosen.drive).in_one_piece() if sealed else one.driven_by(chosen.drive) for one in given]
    read = named(driven, chosen, joint, lock_angle)
    if sealed:
        return _sealed(read, chosen, holdout, seed, progress, [*free, *freeze])
    for recording, _, name in read:
        if sealed_muscles(recording.path):
            raise BadInput(
                f"{name}: its muscles were sealed, as the bag says, but rig {chosen.name} lets air through its valves; "
                "expected a rig file with valves.sealed: true, such as config/rigs/sealed_joint.yaml"
            )
    found = _identify(read, chosen, holdout, starts, seed, jobs, progress, free=free, frozen=freeze)
    identified, *own = (with_known_curves(each, chosen) for each in (found.rig, *found.own))
    return IdentifyResult(identified, tuple(own), found, found.held, tuple(read), seed)


def _sealed(
    read: Sequence[_Named], rig: Rig, holdout: float, seed: int, progress: _Progress, chosen: Sequence[str]
) -> IdentifyResult:
    """Identify a joint with sealed muscles, with other steps and fewer parameters."""
    if chosen:
        raise BadInput(f"{chosen[0]}: which parameters of a sealed joint are fitted cannot be chosen; leave it out")
    for _, state, name in read:
        if state.condition != "free":
            raise BadInput(
                f"{name}: the joint is {state.condition}; expected a sealed joint that an external torque moves"
            )
    found = identify_sealed([(recording, name) for recording, _, name in read], rig, holdout, progress)
    rigs = {"as_configured": found.start, "identified": found.rig}
    held = tuple(held_of(one, one, end, rigs, None) for one, end in zip(read, found.held_from, strict=True))
    return IdentifyResult(found.rig, (), found, held, tuple(read), seed)


def _episodes(
    recordings: Sequence[Recording], rig: Rig, chosen: Sequence[str], holdout: float, jobs: int, progress: _Progress
) -> EpisodesIdentifyResult:
    """Identify mechanics and regulators from many short episodes."""
    if len(recordings) > 1:
        raise BadInput("several recordings, one of them with many episodes: expected the recording of episodes alone")
    if chosen:
        raise BadInput(f"{chosen[0]}: which parameters are fitted to episodes cannot be chosen; leave it out")
    joint = PressureDriven.of(recordings[0], rig, jobs=jobs)
    found = _of_episodes(joint, holdout, progress or (lambda text: None))
    source = f"identified from {bag_name(recordings[0].path)}; started from: {rig.source.strip()}"
    identified = found.rig.replaced(name=f"{rig.name}_identified", source=" ".join(source.split()))
    return EpisodesIdentifyResult(identified, found, joint, (recording_hash(recordings[0]),))
