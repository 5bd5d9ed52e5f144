"""The page of ``close_loop`` for short trials and for rigs of data sheets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from typing_extensions import override

from pam_antagonist.diagnosis import thresholds
from pam_antagonist.diagnosis.closed_loop import ClosedTrials
from pam_antagonist.diagnosis.from_pressures import FoundFromPressures
from pam_antagonist.report.close_loop import effects_frame, sizes_table, title_of
from pam_antagonist.report.document import (
    Block,
    Comparison,
    Document,
    Findings,
    Section,
    Table,
    Text,
    Tile,
    Tiles,
    background,
    note,
    number,
    percent,
    warn,
)
from pam_antagonist.report.identify import held_out_figures
from pam_antagonist.report.result import Result

if TYPE_CHECKING:
    from pandas import DataFrame

_SHOWN = 10
"""Effects in the table."""


@dataclass(frozen=True, eq=False, repr=False)
class PressuresDiagnoseResult(ClosedTrials, Result):
    """An effect that the model of a rig lacks, from measured pressures."""

    @override
    def document(self, figures: bool = True) -> Document:
        found, rig, best = self, self.start.name, self.proposed
        items = [note(text) for text in (found.extended or found.recalibrated).notes]
        if found.ambiguous_with:
            items.append(warn(f"These recordings cannot tell it from: {', '.join(found.ambiguous_with)}."))
        items += [warn(text) for one in found.judged for text in one.warnings]
        for place in found.unexplained if found.effects else ():
            items.append(warn(f"No effect explains what is left in {place} above the sensors' noise."))
        tables = [table for table in (_errors(found), sizes_table(self.effects), _effects(found)) if table.rows]
        was = f"was {number(found.recalibrated.pooled('as_configured'))}°, as configured"
        now = "kept as it is" if best is None else f"{number(best.pooled('identified'))}°"
        tiles = Tiles((Tile("Error of the angle, held out", now, was),))
        held = (found.extended or found.recalibrated).held if figures else ()
        drawn = [Section(item.name, held_out_figures(item), 2, f"held-{k}") for k, item in enumerate(held)]
        ends = background("close_loop of trials", [("Rig", rig), *(("Recording", text) for text in self.hashes)])
        first = Text(f"Rig {rig}: which effect its model lacks.", "lede"), Text(self.sentence, "verdict"), tiles
        title = title_of(self.verdict, [effect.in_short for effect in self.effects])
        blocks: tuple[Block, ...] = (*first, Findings(tuple(items)), *tables, *drawn, *ends)
        return Document("Closing the loop with measured data", title, blocks)

    def to_dataframe(self) -> DataFrame:
        """A row for each parameter of each detected effect (needs pandas)."""
        return effects_frame(self.effects)


def _errors(diagnosis: FoundFromPressures) -> Table:
    results = [diagnosis.recalibrated, *([] if diagnosis.extended is None else [diagnosis.extended])]
    titles = ["recalibrated", "with the effect"][: len(results)]
    out = Comparison("Error of the angle on held-out data, RMS [°]", "as configured", *titles)
    configured = diagnosis.recalibrated.pooled("as_configured")
    out.values("UKF", [configured, *(item.pooled("identified") for item in results)])
    for key, title in (("model_alone", "model alone, from the commands"), ("pressures_alone", "driven by pressures")):
        out.values(title, [None, *(item.pooled(key) for item in results)])
    out.values("in the 95 % interval", [None, *(item.coverage for item in results)], percent, best=None)
    return out.table()


def _effects(diagnosis: FoundFromPressures) -> Table:
    taken = {effect.name for _, effect in diagnosis.placed}
    rows = tuple(
        (
            item.effect,
            place,
            percent(None if item.shares is None else item.shares[0]),
            number(item.delta_bic),
            number(item.held_out_evidence),
            "taken" if item.effect in taken else "",
        )
        for place, item in diagnosis.tried[:_SHOWN]
    )
    caption = (
        f"An effect is taken if its held-out evidence is {number(thresholds.STRONG)} or more, both together "
        f"{number(thresholds.TAKEN)}, and if it explains enough of the excess over noise."
    )
    return Table(("Effect", "acts on", "explains, held-out", "ΔBIC", "held-out evidence", ""), rows, caption)
