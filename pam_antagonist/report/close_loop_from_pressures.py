"""The report of ``close_loop`` on a rig whose muscles have the force of a data sheet."""

from __future__ import annotations

import math
import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from typing_extensions import override

from pam_antagonist.diagnosis import FoundEffect, thresholds
from pam_antagonist.diagnosis.description import in_words
from pam_antagonist.diagnosis.from_pressures import FoundFromPressures, Place
from pam_antagonist.identification.from_pressures import CLEAR
from pam_antagonist.identification.joint_stage import DELAY, ZERO
from pam_antagonist.identification.result import FromPressures
from pam_antagonist.report.close_loop import effects_frame
from pam_antagonist.report.document import Block, Document, Findings, Section, Text, Tile, Tiles, background, note, warn
from pam_antagonist.report.identify import held_out_figures
from pam_antagonist.report.result import Result
from pam_antagonist.report.table import Comparison, Table, number, percent
from pam_antagonist.rig import Rig
from pam_antagonist.rig.units import readable
from pam_antagonist.rig.write import refusal, write_rig

if TYPE_CHECKING:
    from pandas import DataFrame

_SHOWN = 10
"""Effects in the table."""


def sentence(found: FoundFromPressures) -> str:
    """The verdict in words."""
    now = found.proposed
    before = found.recalibrated.pooled("as_configured")
    if found.effects:
        what = "; ".join(_in_words(*item) for item in found.effects)
        out = what[0].upper() + what[1:] + "."
    elif found.unexplained:
        out = f"No effect of the catalogue explains what is left in {' and in '.join(found.unexplained)}."
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


def _errors(found: FoundFromPressures) -> Table:
    results = [found.recalibrated, *([] if found.extended is None else [found.extended])]
    titles = ["recalibrated", "with the effect"][: len(results)]
    out = Comparison("Error of the angle on held-out data, RMS [°]", "as configured", *titles)
    configured = found.recalibrated.pooled("as_configured")
    out.values("UKF", [configured, *(item.pooled("identified") for item in results)])
    for key, title in (("model_alone", "model alone, from the commands"), ("pressures_alone", "driven by pressures")):
        out.values(title, [None, *(item.pooled(key) for item in results)])
    out.values("in the 95 % interval", [None, *(item.coverage for item in results)], percent, best=None)
    return out.table()


def _effects(found: FoundFromPressures) -> Table:
    taken = {effect.name for _, effect in found.effects}
    rows = tuple(
        (
            item.effect,
            place,
            percent(None if item.shares is None else item.shares[0]),
            number(item.delta_bic),
            number(item.held_out_evidence),
            "taken" if item.effect in taken else "",
        )
        for place, item in found.tried[:_SHOWN]
    )
    caption = (
        f"An effect is taken if its held-out evidence is {number(thresholds.STRONG)} or more, both together "
        f"{number(thresholds.TAKEN)}, and if it explains enough of the excess over noise."
    )
    return Table(("Effect", "acts on", "explains, held-out", "ΔBIC", "held-out evidence", ""), rows, caption)


def _values(item: FoundEffect) -> Table:
    rows = tuple(
        (f"{item.name}: {name} [{shown.name}]", number(value * shown.scale), number(std * shown.scale, 2))
        for name, (value, std, unit) in item.parameters.items()
        for shown in [readable(unit, value)]
    )
    return Table(("Parameter", "value", "std. error"), rows)


@dataclass(frozen=True, eq=False, repr=False)
class PressuresDiagnoseResult(Result):
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

    @override
    def to_json(self) -> dict[str, Any]:
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

    @override
    def blocks(self) -> tuple[Block, ...]:
        found = self.found
        items = [note(text) for text in (found.extended or found.recalibrated).notes]
        if found.ambiguous_with:
            items.append(warn(f"These recordings cannot tell it from: {', '.join(found.ambiguous_with)}."))
        items += [warn(text) for one in found.judged for text in one.warnings]
        for place in found.unexplained if found.effects else ():
            items.append(warn(f"No effect explains what is left in {place} above the sensors' noise."))
        remarks = (Findings(tuple(items)),) if items else ()
        return Text(self.sentence, "verdict"), *remarks, _errors(found), _effects(found)

    @override
    def document(self, figures: bool = True) -> Document:
        found, rig, best = self.found, self.start.name, self.found.proposed
        was = f"was {number(found.recalibrated.pooled('as_configured'))}°, as configured"
        now = "kept as it is" if best is None else f"{number(best.pooled('identified'))}°"
        names = ", ".join(item.name for item in self.effects)
        tiles = Tiles((Tile("verdict", self.verdict, names), Tile("angle, held-out", now, was)))
        verdict, *rest = self.blocks()
        held = (found.extended or found.recalibrated).held if figures else ()
        drawn = [Section(item.name, held_out_figures(item), 2, f"held-{k}") for k, item in enumerate(held)]
        ends = background("close_loop of trials", [("Rig", rig), *(("Recording", text) for text in self.hashes)])
        lede = Text(f"Rig {rig}: which effect its model lacks.", "lede")
        return Document(
            "Closing the loop with measured data", rig,
            (lede, verdict, tiles, *rest, *map(_values, self.effects), *drawn, *ends),
        )  # fmt: skip

    def to_dataframe(self) -> DataFrame:
        """A row for each parameter of each detected effect (needs pandas)."""
        return effects_frame(self.effects)

    @override
    def write_rigs(self, folder: Path) -> None:
        about = textwrap.wrap(f"By pam_antagonist close_loop, from rig {self.start.name}. {self.sentence}", 110)
        if self.next_rig is not None:
            write_rig(self.rig_extended, folder / self.next_rig, about)


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
