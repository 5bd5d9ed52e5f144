"""``diagnose``: find the physical effect that the model of a rig lacks."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING

from typing_extensions import override

from pam_antagonist.api import episodes, from_pressures
from pam_antagonist.api.episodes import EpisodesDiagnoseResult
from pam_antagonist.api.from_pressures import PressuresDiagnoseResult
from pam_antagonist.api.given import Bag, RigGiven, as_recordings, corrections
from pam_antagonist.diagnosis import Diagnosis, found_calibrations, learned_law
from pam_antagonist.diagnosis import diagnose as _diagnose
from pam_antagonist.diagnosis.checkpoint import Checkpoint
from pam_antagonist.diagnosis.rig_choice import RigChoice, RigFile, choose
from pam_antagonist.errors import BadInput
from pam_antagonist.inference.expected import with_known_curves
from pam_antagonist.optional import needs
from pam_antagonist.output import output_folder
from pam_antagonist.recording import bag_name, recording_hash
from pam_antagonist.recording.corrections import Corrections
from pam_antagonist.recording.joint import joint_condition
from pam_antagonist.report import close_loop as numbers
from pam_antagonist.report import terminal
from pam_antagonist.report.close_loop_document import summary, write_report
from pam_antagonist.rig import Rig, as_rig
from pam_antagonist.rig.schema import Calibration
from pam_antagonist.rig.write import refusal, write_rig

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, eq=False, repr=False)
class DiagnoseResult(Diagnosis):
    """The diagnosis, see :class:`pam_antagonist.diagnosis.Diagnosis`, with its inputs.

    Attributes:
        start: the rig as configured.
        hashes: SHA-256 of each recording, whole held-out recordings last.
        seed: of the search.
        kept: share of each recording that was held out, or names of held-out recordings.
        typed: corrections with which the recordings were read.
    """

    start: Rig
    hashes: tuple[str, ...]
    seed: int
    kept: float | tuple[str, ...]
    typed: Corrections = field(default_factory=Corrections)

    @override
    def _brief(self) -> str:
        pairs = [
            (name, unit, getattr(self.errors.as_configured, name), getattr(self.errors.extended, name))
            for name, unit in (("angle", "°"), ("torque", " N m"))
        ]
        errors = [f"{name} RMSE {a.rmse:.3g}{unit} -> {b.rmse:.3g}{unit}" for name, unit, a, b in pairs if a and b]
        return "; ".join([self.verdict, *errors, self.sentence])

    @property
    def report(self) -> numbers.CloseLoopReport:
        """The numbers of ``report.json``."""
        return numbers.report(self, self.start, self.hashes, self.seed, self.kept, self.typed, self.choice)

    @cached_property
    def choice(self) -> RigChoice:
        """The rig files that :meth:`save` writes, and the one to use."""
        return choose(self, self.start.name, self._refusal)

    @property
    def next_rig(self) -> str | None:
        """Name of the rig file to use; None: keep the one that there is."""
        return None if self.choice.proposed is None else self.choice.proposed.name

    @property
    def rig_files(self) -> tuple[str, ...]:
        """Names of the rig files that :meth:`save` writes, those for all recordings first."""
        return tuple(file.name for file in self.choice.files)

    def summary(self) -> str:
        """The tables that the command prints."""
        return terminal.render(summary(self.report))

    def save(self, path: str | Path, figures: bool = True, overwrite: bool = False) -> Path:
        """Write ``report.html``, ``report.json`` and the extended rig (``rig_extended.yaml``).

        With several recordings, it also writes the rig of each (``rig_extended_1.yaml`` ...). A rig that is worse than
        configured on held-out data is not written, see :attr:`choice`.

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
            write_report(folder, self.report, self, with_figures=figures)
        return Path(path)

    def to_dataframe(self) -> DataFrame:
        """A row for each parameter of each detected effect (needs pandas)."""
        with needs("import", "a data frame"):
            import pandas as pd
        rows = [
            (effect.name, effect.muscle, name, value, std, unit, effect.delta_bic)
            for effect in self.effects
            for name, (value, std, unit) in effect.parameters.items()
        ]
        return pd.DataFrame(rows, columns=["effect", "muscle", "parameter", "value", "std", "unit", "delta_bic"])

    def _write_rigs(self, folder: Path) -> None:
        about = [
            f"By pam_antagonist close_loop, from rig {self.start.name}. {self.sentence}",
            "Recordings (SHA-256):",
            *(f"  {own}: {value}" for (own, _), value in zip(self.own, self.hashes, strict=False)),
            *(f"Attention: {warning}." for warning in self.warnings),
        ]
        remarks = [line for text in about for line in textwrap.wrap(text, 110, subsequent_indent="  ")]
        for file in self.choice.files:
            alone = [] if file.number is None else [f"The values of {self.own[file.number][0]} alone."]
            write_rig(self._written(file), folder / file.name, [*remarks, *alone])

    def _written(self, file: RigFile) -> Rig:
        """The content of a rig file: with its source, and with the calibration of its recordings."""
        names = ", ".join(own for own, _ in self.own)
        source = f"extended by close_loop from {names}; started from: {self.start.source}"
        found = {item.name: item.value for item in self.calibrations}
        if file.number is not None:
            own = self.own[file.number][0]
            source += f"; with the values of {own} alone"
            found = {item.name: item.by_recording.get(own, (item.value, 0.0))[0] for item in self.calibrations}
        return _calibrated(_named(with_known_curves(file.rig, self.start), self.start.name, source), self.typed, found)

    def _refusal(self, file: RigFile) -> str:
        """Why no command would read a rig file; empty if all would."""
        try:
            return refusal(self._written(file))
        except (BadInput, ValueError) as error:
            return " ".join(str(error).split())


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
) -> DiagnoseResult | EpisodesDiagnoseResult | PressuresDiagnoseResult:
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
    if from_pressures.is_for(chosen):
        given = [
            (one.driven_by(chosen.drive), joint_condition(one, joint, lock_angle), bag_name(one.path))
            for one in (*fitted, *kept)
        ]
        return from_pressures.diagnosed(given, chosen, holdout, seed, jobs, progress, len(kept))
    if episodes.are_given((*fitted, *kept), chosen):
        return episodes.diagnosed(fitted, kept, chosen, also, holdout, jobs, progress)
    if also:
        raise BadInput("also: expected a recording of many episodes of a joint with pressure regulators")
    for recording in (*fitted, *kept):
        recording.driven_by(chosen.drive).in_one_piece()
    run = partial(
        _diagnose, joint=joint, lock_angle=lock_angle, holdout=holdout, jobs=jobs, seed=seed, progress=progress,
        profiles=profiles, estimator=estimator, store=store,
    )  # fmt: skip
    found = run(fitted, chosen, held_out=kept)
    if found.verdict == "unexplained" and not learned_law.refusal((*fitted, *kept), chosen):
        states = [(one, joint_condition(one, joint, lock_angle)) for one in (*fitted, *kept)]
        learned = learned_law.learn(states, chosen, holdout, progress or (lambda text: None), len(kept))
        if learned.laws:
            again = run(learned.corrected(fitted), learned.rig, held_out=learned.corrected(kept))
            found = learned_law.joined(found, again, learned)
        elif learned.sentence:
            found = replace(found, sentence=f"{found.sentence} {learned.sentence}")
    return DiagnoseResult(
        **{item.name: getattr(found, item.name) for item in fields(Diagnosis)},
        start=chosen,
        hashes=tuple(recording_hash(recording) for recording in (*fitted, *kept)),
        seed=seed,
        kept=tuple(bag_name(recording.path) for recording in kept) or holdout,
        typed=corrections(recordings, chosen),
    )


def _calibrated(rig: Rig, typed: Corrections, found: Mapping[str, float]) -> Rig:
    """A rig with the calibration of its recordings: as read, combined with the found one."""
    try:
        corrected = typed.followed_by(found_calibrations.corrections(found))
    except BadInput:
        raise BadInput("its calibration would be larger than any that a rig file may have") from None
    return rig.replaced(calibration=Calibration(**corrected.calibration()))


def _named(rig: Rig, name: str, source: str) -> Rig:
    return rig.replaced(name=f"{name.removesuffix('_extended')}_extended", source=" ".join(source.split()))
