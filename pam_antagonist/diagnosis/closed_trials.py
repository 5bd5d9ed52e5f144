"""What ``close_loop`` returns for short trials and rigs of data sheets: verdict, rig file, ``report.json``."""

from __future__ import annotations

import math
import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from typing_extensions import override

from pam_antagonist.diagnosis.description import in_words
from pam_antagonist.diagnosis.from_pressures import FoundFromPressures, Place
from pam_antagonist.diagnosis.result import FoundEffect
from pam_antagonist.identification.from_pressures import CLEAR
from pam_antagonist.identification.joint_stage import DELAY, ZERO
from pam_antagonist.identification.result import FromPressures
from pam_antagonist.rig import Rig
from pam_antagonist.rig.file import refusal, write_rig
from pam_antagonist.shown import Shown, number, percent


@dataclass(frozen=True, eq=False, repr=False)
class ClosedTrials(Shown):
    """An effect that the model of a rig lacks, from measured pressures."""

    start: Rig
    found: FoundFromPressures
    hashes: tuple[str, ...]  # SHA-256 of the recordings

    @override
    def _brief(self) -> str:
        return f"{self.verdict}; {self.sentence}"

    @property
    def verdict(self) -> str:
        """``effect``, ``none`` or ``unexplained``."""
        return self.found.verdict

    @property
    def sentence(self) -> str:
        """The result in words."""
        return sentence(self.found)

    @property
    def effects(self) -> tuple[FoundEffect, ...]:
        """The detected effects."""
        return tuple(effect for _, effect in self.found.effects)

    @property
    def ambiguous_with(self) -> tuple[str, ...]:
        """Effects that the recordings cannot tell from the detected ones."""
        return self.found.ambiguous_with

    @property
    def next_rig(self) -> str | None:
        """Name of the rig file to use; None: keep the one that there is."""
        best = self.found.proposed
        if best is None or refusal(best.rig):
            return None
        return "rig_extended.yaml" if best is self.found.extended else "rig_recalibrated.yaml"

    @property
    def rig_extended(self) -> Rig:
        """The rig to use: with the effects, recalibrated, or as configured, whichever is best on held-out data."""
        best = self.found.proposed
        if best is None:
            return self.start
        names = ", ".join(name for name, _ in best.fitted)
        source = " ".join(f"extended by close_loop from {names}; started from: {self.start.source.strip()}".split())
        name = f"{self.start.name.removesuffix('_identified')}_extended"
        return best.rig.replaced(name=name, source=source, identified=names)

    def to_json(self) -> dict[str, Any]:
        """The content of ``report.json``."""
        base, best = self.found.recalibrated, self.found.extended or self.found.recalibrated
        values, stds = base.final[0].values, base.final[0].stds
        muscles = {effect.name: effect.muscle for effect in self.effects}
        three = {
            "as_configured": (base, "as_configured"), "recalibrated": (base, "identified"),
            "extended": (best, "identified"),
        }  # fmt: skip
        return {
            "verdict": self.verdict,
            "sentence": self.sentence,
            "effects": [
                {
                    "name": item.name,
                    "muscle": item.muscle,
                    "place": place,
                    "parameters": {name: size.to_json() for name, size in item.parameters.items()},
                    "delta_bic": item.delta_bic,
                    "holdout_gain": item.holdout_gain,
                    "onset_s": None,
                    "splits": item.splits,
                }
                for place, item in self.found.effects
            ],
            "ambiguous_with": self.ambiguous_with,
            "calibration": [
                {"name": name, "value": value, "std": std, "unit": unit, "recording": None}
                for name, value, std, unit in (
                    ("encoder_zero", values.get(ZERO, 0.0), stds.get(ZERO, 0.0), "rad"),
                    ("delay_angle", -values.get(DELAY, 0.0), stds.get(DELAY, 0.0), "s"),
                )
                if abs(value) > CLEAR * std
            ],
            "errors": {name: _model_errors(one, rig) for name, (one, rig) in three.items()},
            "filter_errors_deg": {name: one.pooled(rig) for name, (one, rig) in three.items()},
            "candidates": [
                {"name": item.effect, "muscle": muscles.get(item.effect), "place": place, "round": item.round,
                 "holdout_gain": None if item.shares is None else item.shares[0], "delta_bic": item.delta_bic,
                 "held_out_evidence": item.held_out_evidence}
                for place, item in self.found.tried
            ],
            "unexplained": self.found.unexplained,
            "next_rig": self.next_rig,
            "rig": base.start.name,
            "recordings_sha256": self.hashes,
        }  # fmt: skip

    def write_rigs(self, folder: Path) -> None:
        """Write the rig file into a folder that exists, if there is one to use."""
        about = textwrap.wrap(f"By pam_antagonist close_loop, from rig {self.start.name}. {self.sentence}", 110)
        if self.next_rig is not None:
            write_rig(self.rig_extended, folder / self.next_rig, about)


def sentence(found: FoundFromPressures) -> str:
    """The verdict in words."""
    now = found.proposed
    before = found.recalibrated.pooled("as_configured")
    if found.effects:
        what = "; ".join(_in_words(*item) for item in found.effects)
        out = what[0].upper() + what[1:] + "."
    elif found.unexplained:
        out = f"No effect of the catalogue explains what is left in {' and in '.join(found.unexplained)}. "
        out += "No other law was looked for: the base of such a rig is not known well enough."
    else:
        out = "The model explains the recordings; no effect is missing."
    if now is None:
        why = (found.extended or found.recalibrated).rejected
        return f"{out} Keep the rig file that you have: {why or 'no other is better on held-out data.'}"
    after = now.pooled("identified")
    change = "falls" if after < before else "changes"
    return f"{out} The filter's angle error on held-out data {change} from {number(before)}° to {number(after)}°."


def _in_words(place: Place, effect: FoundEffect) -> str:
    share = percent(effect.holdout_gain or 0.0)
    return f"{in_words(effect, False)}, which explains {share} of the excess over noise of {place} on held-out data"


def _model_errors(found: FromPressures, rig: str) -> dict[str, Any]:
    """Errors of the model alone on all held-out data: RMS over rows, and the largest."""
    reports = [(getattr(item, rig).model_alone, item.rows) for item in found.held]
    total = sum(rows for _, rows in reports)

    def pooled(name: str, unit: str) -> dict[str, float] | None:
        known = [(one, rows) for report, rows in reports if (one := getattr(report, name)) is not None]
        if not known:
            return None
        count = sum(rows for _, rows in known)
        return {
            f"rmse_{unit}": math.sqrt(sum(rows * item.rmse**2 for item, rows in known) / count),
            f"max_{unit}": max(item.largest for item, _ in known),
            "q": max(item.ratio for item, _ in known),
        }

    pressures = [math.sqrt(sum(rows * one.pressure.rmse_pa[k] ** 2 for one, rows in reports) / total) for k in (0, 1)
                 ] if reports else None  # fmt: skip
    return {
        "angle": pooled("angle", "deg"),
        "torque": pooled("torque", "nm"),
        "pressure": None if pressures is None else {"rmse_pa": pressures},
    }
