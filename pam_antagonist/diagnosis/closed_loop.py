"""What ``close_loop`` returns: a diagnosis with its inputs, the rig files that follow, and ``report.json``."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from typing_extensions import override

from pam_antagonist.diagnosis import calibrations, thresholds
from pam_antagonist.diagnosis.result import Diagnosis, RecordingEntry, Size
from pam_antagonist.diagnosis.rig_choice import RigChoice, RigFile, by_time, choose
from pam_antagonist.diagnosis.splits import Firmness
from pam_antagonist.diagnosis.verdicts import EFFECT, UNEXPLAINED
from pam_antagonist.diagnosis.warnings import like_a_curve
from pam_antagonist.errors import BadInput
from pam_antagonist.inference.expected import with_known_curves
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.program import typed as typed_command
from pam_antagonist.program import versions
from pam_antagonist.recording.corrections import Corrections
from pam_antagonist.report_keys import CLOSE_LOOP, with_all_keys
from pam_antagonist.rig import Rig
from pam_antagonist.rig.file import refusal, write_rig
from pam_antagonist.rig.schema import Calibration
from pam_antagonist.rig.units import assumption
from pam_antagonist.shown import error_in_words
from pam_antagonist.strict_json import picked


@dataclass(frozen=True, eq=False, repr=False)
class ClosedLoop(Diagnosis):
    """The diagnosis with its inputs; the fields are those of ``DiagnoseResult``, which adds the page."""

    start: Rig
    hashes: tuple[str, ...]
    seed: int
    kept: float | tuple[str, ...]
    typed: Corrections = field(default_factory=Corrections)

    @override
    def _brief(self) -> str:
        each = [
            (name, [error_in_words(item.rmse, unit, 3) for model in self.errors.all if (item := getattr(model, name))])
            for name, unit in (("angle", "°"), ("torque", " N m"))
        ]
        errors = [f"{name} RMSE {' -> '.join(values)}" for name, values in each if values]
        return "; ".join([self.verdict, *errors, self.sentence])

    @cached_property
    def choice(self) -> RigChoice:
        """The rig files that :meth:`save` writes, and the one to use."""
        return self.decided or choose(self, self.start.name, self._refusal)

    @property
    def next_rig(self) -> str | None:
        """Name of the rig file to use; None: keep the one that there is."""
        return None if self.choice.proposed is None else self.choice.proposed.name

    @property
    def rig_files(self) -> tuple[str, ...]:
        """Names of the rig files that :meth:`save` writes, those for all recordings first."""
        return tuple(file.name for file in self.choice.files)

    @property
    def next_steps(self) -> tuple[str, ...]:
        """Recommended next steps, in sentences."""
        rig, choice = self.start, self.choice
        out, files = [], [file.name for file in choice.files]
        if choice.no_common:
            own = [file.name for file in choice.files if file.number is not None]
            have = "have each recording's own values" if len(own) > 1 else "has the values of one recording"
            each = f" {', '.join(own)} {have}." if own else ""
            out.append(f"There is no rig_extended.yaml, since {choice.no_common}.{each}")
        rivals = [name for name in self.ambiguous_with if name in CATALOGUE]
        can_excite = rig.drive == "valve" and not rig.valves.sealed and not self.held
        if self.effects and rivals and "rig_extended.yaml" in files and can_excite:
            either = " and ".join(name.replace("_", " ") for name in (self.effects[0].name, *rivals))
            out.append(
                f"Next: record once more, to decide between {either}. {typed_command('excite')} --tell-apart with the "
                "folder of this report designs the experiment."
            )
        if by_time(self.effects) and "rig_extended.yaml" in files:
            out.append(
                "rig_extended.yaml is for these recordings: its law depends on the time since the start. Record once "
                "more on another day. If the same law comes again, each time from the start, that rig file is for both."
            )
        keep = f"keep the rig file of {rig.name}"
        if narrow := self.of_one_rig["as_configured"].outside(thresholds.HOLDS):
            keep += f", whose 95 % interval holds only {narrow} that were held out"
        proposed, use = choice.proposed, ""
        if proposed is not None:
            which = "" if proposed.number is None else f" for {self.by_recording[proposed.number].recording}"
            use = f"use {proposed.name}{which}, which every command and node takes ({proposed.gain} on held-out data)"
        alike = like_a_curve(rig, [effect.name for effect in self.effects])
        if alike:
            out.append(
                "Next: measure the valves' curves before you repair anything: a curve of another slope looks like "
                f"{' or '.join(alike)}. Hold six voltages of each valve until the pressures stand, give that recording "
                f"to {typed_command('identify')} with the others, and run {typed_command('close_loop')} with the rig "
                f"file that it writes. Until then, {use or keep}."
            )
        elif self.verdict == EFFECT:
            out.append(f"Next: repair the joint and record again{f', or {use}' if use else f'; until then, {keep}'}.")
        elif self.verdict == UNEXPLAINED:
            out.append(
                "Next: read in section What is left when the remaining residual appears and on what it depends. Until "
                f"its cause is known, {use or keep}."
            )
        elif use:
            out.append(f"Next: nothing to repair; {use}: it is {rig.name}, recalibrated by these recordings.")
        else:
            out.append(f"Next: nothing; {keep}.")
        return tuple(out)

    @property
    def corrections(self) -> tuple[str, ...]:
        """Command line options for what was typed and what was found together; none if that is too much for them."""
        try:
            further = calibrations.corrections({item.name: item.value for item in self.shared})
            return tuple(self.typed.followed_by(further).options()) if self.shared else ()
        except BadInput:
            return ()

    @property
    def splits(self) -> Firmness | None:
        """What the splits of the recordings say of the least supported effect; None if no splits were made."""
        known = (effect.splits for effect in self.effects if effect.splits is not None)
        return min(known, key=lambda firm: firm.agree, default=None)

    @property
    def recordings(self) -> tuple[RecordingEntry, ...]:
        """The recordings with the errors on them, and their checksums."""
        return tuple(replace(part, sha256=value) for part, value in zip(self.by_recording, self.hashes, strict=True))

    def to_json(self) -> dict[str, Any]:
        """The content of ``report.json``."""
        return with_all_keys(
            CLOSE_LOOP,
            {
                **picked(self, "verdict", "sentence", "effects", "ambiguous_with"),
                "experiments": self.experiment,
                "ambiguities": self.ambiguities,
                "share_explained": self.share,
                **picked(self, "parts", "reference", "base_friction_removed", "errors"),
                "filter_errors": {name: one.ukf for name, one in self.of_one_rig.items()},
                "recordings": self.recordings,
                "ranking": [
                    {
                        "name": item.effect,
                        **picked(item, "part", "round", "score", "delta_bic", "held_out_evidence"),
                        "holdout_gain": None if item.shares is None else item.shares[0],
                        "taken": item.taken,
                        "score_by_muscle": item.muscles,
                    }
                    for item in self.ranking
                ],
                "profiles": self.profiles,
                "remaining": [item.line() for item in self.remaining],
                "left": self.remaining,
                **picked(self, "unseen", "warnings", "notes"),
                "settings": {
                    "rig": self.start.name,
                    "rig_source": " ".join(self.start.source.split()),
                    "seed": self.seed,
                    "holdout": self.kept,
                    "strong_evidence": thresholds.STRONG,
                    "first_share": thresholds.FIRST_SHARE,
                    "further_share": thresholds.FURTHER_SHARE,
                    "explained_share": thresholds.EXPLAINED,
                },
                "timing": self.seconds,
                "software": versions(),
                "splits": self.splits,
                "calibration": [
                    {
                        **picked(item, "name", "value", "std", "unit"),
                        "sentence": item.in_words(),
                        "delta_bic": item.delta_bic,
                        "shared": item.is_shared,
                        "recordings": {name: Size(*each, item.unit) for name, each in item.by_recording.items()},
                        "ambiguous_with": item.rivals,
                    }
                    for item in self.calibrations
                ],
                "corrections": self.corrections,
                "assumption": assumption(self.start),
                **picked(self, "next_steps", "next_rig"),
            },
        )

    def write_rigs(self, folder: Path) -> None:
        """Write the rig files into a folder that exists."""
        about = [
            f"By pam_antagonist close_loop, from rig {self.start.name}. {self.sentence}",
            "Recordings (SHA-256):",
            *(f"  {part.recording}: {part.sha256}" for part in self.recordings if part.role != "held out"),
            *(f"Attention: {warning}." for warning in self.warnings),
        ]
        remarks = [line for text in about for line in textwrap.wrap(text, 110, subsequent_indent="  ")]
        for file in self.choice.files:
            alone = [] if file.number is None else [f"The values of {self.own[file.number][0]} alone."]
            write_rig(self._written(file), folder / file.name, [*remarks, *alone])

    def _written(self, file: RigFile) -> Rig:
        """The content of a rig file: with its source, and with the calibration of its recordings."""
        if self.decided is not None:
            return file.rig
        names = ", ".join(own for own, _ in self.own)
        source = f"extended by close_loop from {names}; started from: {self.start.source}"
        found = {item.name: item.value for item in self.shared}
        if file.number is not None:
            own = self.own[file.number][0]
            source += f"; with the values of {own} alone"
            found = {item.name: item.by_recording.get(own, (item.value, 0.0))[0] for item in self.calibrations}
        ends = {one.number: one.experiment.fitted * one.experiment.trial.dt for one in self.compared}
        used = [number for number in ends if file.number in (None, number)]
        rig = with_known_curves(file.rig, self.start).replaced(
            name=f"{self.start.name.removesuffix('_extended')}_extended",
            source=" ".join(source.split()),
            fitted={**self.start.fitted, **{self.hashes[number]: ends[number] for number in used}},
        )
        try:
            corrected = self.typed.followed_by(calibrations.corrections(found))
        except BadInput:
            raise BadInput("its calibration would be larger than any that a rig file may have") from None
        return rig.replaced(calibration=Calibration(**corrected.calibration()))

    def _refusal(self, file: RigFile) -> str:
        """Why no command would read a rig file; empty if all would."""
        try:
            return refusal(self._written(file))
        except (BadInput, ValueError) as error:
            return " ".join(str(error).split())
