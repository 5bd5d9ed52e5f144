"""What ``close_loop`` returns: a diagnosis with its inputs, the rig files that follow, and ``report.json``."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from typing_extensions import override

from pam_antagonist.diagnosis import found_calibrations, thresholds
from pam_antagonist.diagnosis.result import Diagnosis, RecordingEntry, Size, Splits
from pam_antagonist.diagnosis.rig_choice import RigChoice, RigFile, choose
from pam_antagonist.diagnosis.warnings import like_a_curve
from pam_antagonist.errors import BadInput
from pam_antagonist.inference.expected import with_known_curves
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.program import typed as typed_command
from pam_antagonist.program import versions
from pam_antagonist.recording.corrections import Corrections
from pam_antagonist.rig import Rig
from pam_antagonist.rig.file import refusal, write_rig
from pam_antagonist.rig.schema import Calibration
from pam_antagonist.rig.units import assumption


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
        pairs = [
            (name, unit, getattr(self.errors.as_configured, name), getattr(self.errors.extended, name))
            for name, unit in (("angle", "°"), ("torque", " N m"))
        ]
        errors = [f"{name} RMSE {a.rmse:.3g}{unit} -> {b.rmse:.3g}{unit}" for name, unit, a, b in pairs if a and b]
        return "; ".join([self.verdict, *errors, self.sentence])

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

    @property
    def next_steps(self) -> tuple[str, ...]:
        """Recommended next steps, in sentences."""
        return _next_steps(self, self.start, self.choice)

    @property
    def corrections(self) -> tuple[str, ...]:
        """Command line options for what was typed and what was found together; none if that is too much for them."""
        try:
            further = found_calibrations.corrections({item.name: item.value for item in self.calibrations})
            return tuple(self.typed.followed_by(further).options()) if self.calibrations else ()
        except BadInput:
            return ()

    @property
    def splits(self) -> Splits | None:
        """How many splits of the recordings support the least supported effect; None if no splits were made."""
        return min((effect.splits for effect in self.effects if effect.splits is not None), default=None)

    @property
    def driven(self) -> bool:
        """Whether the measured angle drives the model, as for a sealed joint."""
        return any(part.joint == "driven" for part in self.by_recording)

    @property
    def recordings(self) -> tuple[RecordingEntry, ...]:
        """The recordings with the errors on them, and their checksums."""
        return tuple(replace(part, sha256=value) for part, value in zip(self.by_recording, self.hashes, strict=True))

    def to_json(self) -> dict[str, Any]:
        """The content of ``report.json``."""
        return {
            "verdict": self.verdict,
            "sentence": self.sentence,
            "effects": self.effects,
            "ambiguous_with": self.ambiguous_with,
            "experiments": self.experiment,
            "ambiguities": self.ambiguities,
            "share_explained": self.share,
            "parts": self.parts,
            "reference": self.reference,
            "base_friction_removed": self.base_friction_removed,
            "errors": self.errors,
            "recordings": self.recordings,
            "ranking": [
                {
                    "name": item.effect,
                    "round": item.round,
                    "score": item.score,
                    "delta_bic": item.delta_bic,
                    "holdout_gain": None if item.shares is None else item.shares[0],
                    "taken": item.taken,
                    "score_by_muscle": item.muscles,
                }
                for item in self.ranking
            ],
            "profiles": self.profiles,
            "remaining": [item.line() for item in self.remaining],
            "left": self.remaining,
            "unseen": self.unseen,
            "warnings": self.warnings,
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
                    "name": item.name,
                    "value": item.value,
                    "std": item.std,
                    "unit": item.unit,
                    "sentence": found_calibrations.in_words(item),
                    "delta_bic": item.delta_bic,
                    "recordings": {name: Size(*each, item.unit) for name, each in item.by_recording.items()},
                    "ambiguous_with": item.rivals,
                }
                for item in self.calibrations
            ],
            "corrections": self.corrections,
            "assumption": assumption(self.start),
            "next_steps": self.next_steps,
            "next_rig": self.next_rig,
        }

    def write_rigs(self, folder: Path) -> None:
        """Write the rig files into a folder that exists."""
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
        rig = with_known_curves(file.rig, self.start).replaced(
            name=f"{self.start.name.removesuffix('_extended')}_extended", source=" ".join(source.split())
        )
        return _calibrated(rig, self.typed, found)

    def _refusal(self, file: RigFile) -> str:
        """Why no command would read a rig file; empty if all would."""
        try:
            return refusal(self._written(file))
        except (BadInput, ValueError) as error:
            return " ".join(str(error).split())


def _calibrated(rig: Rig, typed: Corrections, found: Mapping[str, float]) -> Rig:
    """A rig with the calibration of its recordings: as read, combined with the found one."""
    try:
        corrected = typed.followed_by(found_calibrations.corrections(found))
    except BadInput:
        raise BadInput("its calibration would be larger than any that a rig file may have") from None
    return rig.replaced(calibration=Calibration(**corrected.calibration()))


def _next_steps(found: Diagnosis, rig: Rig, choice: RigChoice) -> tuple[str, ...]:
    out, files = [], [file.name for file in choice.files]
    if choice.no_common:
        own = [file.name for file in choice.files if file.number is not None]
        have = "have each recording's own values" if len(own) > 1 else "has the values of one recording"
        each = f" {', '.join(own)} {have}." if own else ""
        out.append(f"There is no rig_extended.yaml, since {choice.no_common}.{each}")
    rivals = [name for name in found.ambiguous_with if name in CATALOGUE]
    if found.effects and rivals and "rig_extended.yaml" in files and rig.drive == "valve" and not rig.valves.sealed:
        either = " and ".join(name.replace("_", " ") for name in (found.effects[0].name, *rivals))
        out.append(
            f"Next: record once more, to decide between {either}. {typed_command('excite')} --tell-apart with the "
            "folder of this report designs the experiment."
        )
    keep = f"keep the rig file of {rig.name}"
    proposed, use = choice.proposed, ""
    if proposed is not None:
        which = "" if proposed.number is None else f" for {found.by_recording[proposed.number].recording}"
        use = f"use {proposed.name}{which}, which every command and node takes ({proposed.gain} on held-out data)"
    alike = like_a_curve(rig, [effect.name for effect in found.effects])
    if alike:
        out.append(
            "Next: measure the valves' curves before you repair anything: a curve of another slope looks like "
            f"{' or '.join(alike)}. Hold six voltages of each valve until the pressures stand, give that recording to "
            f"{typed_command('identify')} with the others, and run {typed_command('close_loop')} with the rig file "
            f"that it writes. Until then, {use or keep}."
        )
    elif found.verdict == "effect":
        out.append(f"Next: repair the joint and record again{f', or {use}' if use else f'; until then, {keep}'}.")
    elif found.verdict == "unexplained":
        out.append(
            "Next: read in section What is left when the remaining residual appears and on what it depends. Until its "
            f"cause is known, {use or keep}{': it halves all errors' if use else ''}."
        )
    elif use:
        out.append(f"Next: nothing to repair; {use}: it is {rig.name}, recalibrated by these recordings.")
    else:
        out.append(f"Next: nothing; {keep}.")
    return tuple(out)
