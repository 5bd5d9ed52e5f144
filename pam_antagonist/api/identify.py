"""``identify``: a rig's parameters, noise and tuning from its recordings."""

from __future__ import annotations

import datetime
import math
import textwrap
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from typing_extensions import override

from pam_antagonist.api import episodes
from pam_antagonist.api.episodes import EpisodesIdentifyResult
from pam_antagonist.api.given import Bag, RigGiven, as_recordings
from pam_antagonist.blas import one_blas_thread
from pam_antagonist.errors import BadInput
from pam_antagonist.identification.from_pressures import FromPressures, is_for
from pam_antagonist.identification.from_pressures import identify as _identify
from pam_antagonist.identification.sealed import SealedIdentified, identify_sealed
from pam_antagonist.inference.expected import with_known_curves
from pam_antagonist.optional import needs
from pam_antagonist.output import output_folder
from pam_antagonist.recording import Recording, bag_name, recording_hash
from pam_antagonist.recording.joint import JointCondition, joint_condition
from pam_antagonist.recording.notes import sealed_muscles
from pam_antagonist.report import identify as numbers
from pam_antagonist.report import identify_document, terminal
from pam_antagonist.report import identify_sealed as sealed
from pam_antagonist.report.held_out import Judged, judge
from pam_antagonist.report.identify_entries import IdentifyReport
from pam_antagonist.report.identify_findings import do_not_use, lacks_an_effect
from pam_antagonist.rig import Rig, as_rig
from pam_antagonist.rig.load import RefusedRig, refusal, write_rig, write_unread
from pam_antagonist.shown import Shown

if TYPE_CHECKING:
    from pandas import DataFrame

_Named = tuple[Recording, JointCondition, str]


@dataclass(frozen=True, eq=False, repr=False)
class IdentifyResult(Shown):
    """An identified rig.

    Attributes:
        rig: with the identified parameters, noise and tuning.
        own: with several recordings, a rig with each one's own values; otherwise empty.
        warnings: for the user.
        report: the numbers of ``report.json``.
        found: all results.
        judged: the recordings, replayed with the compared rigs, for figures.
        recordings: each with its joint condition and name.
        seed: of further starts.
    """

    rig: Rig
    own: tuple[Rig, ...]
    warnings: tuple[str, ...]
    report: IdentifyReport | sealed.SealedReport
    found: FromPressures | SealedIdentified
    judged: tuple[Judged, ...]
    recordings: tuple[_Named, ...]
    seed: int = 0

    @override
    def _brief(self) -> str:
        names = ", ".join(name for _, _, name in self.recordings)
        return f"rig {self.rig.name} from {names}; {len(self.warnings)} warnings; .summary() has the errors"

    @property
    def rejected(self) -> str:
        """Why the identified rig should not be used, in a sentence; empty if it may."""
        return self.report.rejected

    @property
    def lacks_an_effect(self) -> bool:
        """Whether the filter got no better on held-out data; :func:`diagnose` then searches for the missing effect."""
        if not isinstance(self.report, IdentifyReport):
            return False
        errors = self.report.errors_deg
        no_better = errors.get("identified", 0.0) > errors.get("as_configured", math.inf)
        return no_better or lacks_an_effect(self.report)

    def summary(self) -> str:
        """The tables that the command prints."""
        if isinstance(self.report, sealed.SealedReport):
            return terminal.render(sealed.summary(self.report))
        return terminal.render(identify_document.summary(self.report))

    def save(self, path: str | Path, figures: bool = True, overwrite: bool = False) -> Path:
        """Write ``rig.yaml``, ``report.html`` and ``report.json``, and ``rig_1.yaml`` ... for several recordings.

        A rejected rig is written as ``rig_rejected.yaml`` alone, of several recordings none.

        Args:
            path: of a new folder.
            figures: False leaves the figures out of the page.
            overwrite: True replaces an earlier result there.

        Returns:
            The folder.

        Raises:
            BadInput: the folder exists, or cannot be written.
        """
        with output_folder(Path(path), overwrite=overwrite) as folder:
            self._write_rigs(folder)
            if isinstance(self.report, sealed.SealedReport):
                sealed.write_report(folder, self.report, self.judged, with_figures=figures)
            else:
                identify_document.write_report(folder, self.report, self.judged, self.rig, with_figures=figures)
        return Path(path)

    def to_dataframe(self) -> DataFrame:
        """A row for each identified parameter: start value, identified value, standard error (needs pandas)."""
        with needs("import", "a data frame"):
            import pandas as pd
        if isinstance(self.report, sealed.SealedReport):
            rows = [
                (name, entry.before, entry.after, entry.std)
                for stage in self.report.stages
                for name, entry in stage.values.items()
            ]
        else:
            rows = [(entry.name, entry.start, entry.value, entry.std) for entry in self.report.parameters]
        return pd.DataFrame(rows, columns=["parameter", "start", "value", "std"]).set_index("parameter")

    def _fitted(self) -> list[str]:
        """The part of each recording that was fitted, in words."""
        if isinstance(self.found, SealedIdentified):
            return [f"first {until:.1f} s" for until in self.found.held_from]
        known = dict(self.found.fitted)
        return [
            "held out" if name not in known else "all" if known[name] > one.duration_s else f"first {known[name]:.1f} s"
            for one, _, name in self.recordings
        ]

    def _write_rigs(self, folder: Path) -> None:
        start = self.found.start
        when = datetime.datetime.now(datetime.timezone.utc).strftime("%Y-%m-%d %H:%M UTC")
        about = [
            f"Identified on {when} by pam_antagonist identify, from rig {start.name}, seed {self.seed}.",
            "Recordings (the part that was fitted, joint, SHA-256):",
            *(
                f"  {name}: {until}, {state.condition}, {recording_hash(recording)}"
                for (recording, state, name), until in zip(self.recordings, self._fitted(), strict=True)
            ),
        ]
        if isinstance(self.found, FromPressures):
            about.append(
                "Standard errors are in report.json. The directions below are the combinations of errors that change "
                "the estimate most."
            )
        names = ", ".join(name for _, _, name in self.recordings)
        source = f"identified from {names}; started from: {start.source.strip()}"
        if self.rejected:
            lines = textwrap.wrap(f"Do not use this rig: {self.rejected}", 110)
            write_unread(_named(self.rig, start.name, source, names), folder / "rig_rejected.yaml", [*lines, *about])
            return
        write_rig(_named(self.rig, start.name, source, names), folder / "rig.yaml", about)
        for index, own in enumerate(self.own):
            name = self.recordings[index][2]
            remark = f"The values of {name} alone, which deviate a little from the common ones in rig.yaml."
            named = _named(own, start.name, f"{source}; with the values of {name} alone", names)
            with suppress(RefusedRig):  # nobody is asked to use it
                write_rig(named, folder / f"rig_{index + 1}.yaml", [*about, remark])


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
    whole = is_for(chosen)
    if not whole and episodes.are_given(given, chosen):
        return episodes.identified(given, chosen, [*free, *freeze], holdout, jobs, progress)
    read = [
        (
            recording.driven_by(chosen.drive) if whole else recording.driven_by(chosen.drive).in_one_piece(),
            joint_condition(recording, joint, lock_angle),
            bag_name(recording.path),
        )  # fmt: skip
        for recording in given
    ]
    if chosen.valves.sealed:
        return _sealed(read, chosen, holdout, seed, progress, [*free, *freeze])
    for recording, _, name in read:
        if sealed_muscles(recording.path):
            raise BadInput(
                f"{name}: its muscles were sealed, as the bag says, but rig {chosen.name} lets air through its valves; "
                "expected a rig file with valves.sealed: true, such as config/rigs/sealed_joint.yaml"
            )
    found = _identify(read, chosen, holdout, starts, seed, jobs, progress, free=free, frozen=freeze)
    identified = with_known_curves(found.rig, chosen)
    report = numbers.report(read, found, refusal(identified))
    warnings = (*([do_not_use(report.rejected)] if report.rejected else []), *found.notes)
    own = tuple(with_known_curves(each, chosen) for each in found.own)
    return IdentifyResult(identified, own, warnings, report, found, tuple(numbers.judged_of(found)), tuple(read), seed)


def _sealed(
    read: Sequence[_Named],
    rig: Rig,
    holdout: float,
    seed: int,
    progress: Callable[[str], None] | None,
    chosen: Sequence[str],
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
    judged = judge(read, [rigs] * len(read), found.held_from)
    return IdentifyResult(found.rig, (), (), sealed.report(found, judged), found, tuple(judged), tuple(read), seed)


def _named(rig: Rig, name: str, source: str, recordings: str) -> Rig:
    plain = name.removesuffix("_identified")
    return rig.replaced(name=f"{plain}_identified", source=" ".join(source.split()), identified=recordings)
