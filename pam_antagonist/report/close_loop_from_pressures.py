"""The report of ``close_loop`` on a rig whose muscles have the force of a data sheet."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from pam_antagonist.diagnosis.from_pressures import LEAST_GAIN, FoundFromPressures, Tried
from pam_antagonist.identification.from_pressures import FromPressures
from pam_antagonist.identification.joint_stage import DELAY, ZERO
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.report import identify_figures as drawn
from pam_antagonist.report.document import Block, Document, Finding, Findings, Section, Text, Tile, Tiles, background
from pam_antagonist.report.identify import judged_of
from pam_antagonist.report.table import Comparison, Table, number, percent

_SHOWN = 10
"""Effects in the table."""


def sentence(found: FoundFromPressures) -> str:
    """The verdict in words."""
    now = found.proposed
    before = found.recalibrated.pooled("as_configured")
    if found.taken:
        what = "; ".join(_in_words(item) for item in found.taken)
        out = what[0].upper() + what[1:] + "."
    elif found.unexplained:
        out = f"No effect of the catalogue explains what is left in {' and in '.join(found.unexplained)}."
    else:
        out = "The model explains the recordings; no effect is missing."
    if now is None:
        return f"{out} Keep the rig file that you have: {_why_not(found)}"
    after = now.pooled("identified")
    change = "falls" if after < before else "changes"
    return f"{out} The filter's angle error on held-out data {change} from {number(before)}° to {number(after)}°."


def _in_words(item: Tried) -> str:
    words = CATALOGUE[item.name].in_words(item.muscle, {k: v for k, (v, _, _) in item.parameters.items()})
    return f"{words}, which removes {percent(item.gain)} of the squared error of {item.place} on held-out data"


def _why_not(found: FoundFromPressures) -> str:
    best = found.extended or found.recalibrated
    return best.rejected or "no other is better on held-out data."


def summary(found: FoundFromPressures) -> tuple[Block, ...]:
    """Blocks for the terminal."""
    items = [Finding("note", text) for text in (found.extended or found.recalibrated).notes]
    if found.ambiguous_with:
        items.append(Finding("warn", f"These recordings cannot tell it from: {', '.join(found.ambiguous_with)}."))
    for place in found.unexplained if found.taken else ():
        items.append(Finding("warn", f"No effect explains what is left in {place} above the sensors' noise."))
    blocks: list[Block] = [Text(sentence(found), "verdict")]
    if items:
        blocks.append(Findings(tuple(items)))
    return (*blocks, _errors(found), _effects(found))


def _results(found: FoundFromPressures) -> list[FromPressures]:
    return [found.recalibrated, *([] if found.extended is None else [found.extended])]


def _errors(found: FoundFromPressures) -> Table:
    results = _results(found)
    titles = ["recalibrated", "with the effect"][: len(results)]
    out = Comparison("Error of the angle on held-out data, RMS [°]", "as configured", *titles)
    configured = found.recalibrated.pooled("as_configured")
    out.values("UKF", [configured, *(item.pooled("identified") for item in results)])
    for key, title in (("model_alone", "model alone, from the commands"), ("pressures_alone", "driven by pressures")):
        out.values(title, [None, *(item.pooled(key) for item in results)])
    out.values("in the 95 % interval", [None, *(item.coverage for item in results)], percent, best=None)
    return out.table()


def _effects(found: FoundFromPressures) -> Table:
    rows = tuple(
        (
            item.name if item.muscle is None else f"{item.name}, muscle {item.muscle}",
            item.place,
            percent(item.gain),
            number(item.delta_bic),
            "taken" if item in found.taken else "",
        )
        for item in found.tried[:_SHOWN]
    )
    caption = f"An effect is taken if it removes {percent(LEAST_GAIN)} of the held-out squared error or more."
    return Table(("Effect", "acts on", "removes", "ΔBIC", ""), rows, caption)


def _values(item: Tried) -> Table:
    rows = tuple((name, number(value), number(std, 2), unit) for name, (value, std, unit) in item.parameters.items())
    return Table((item.name, "value", "std", "unit"), rows)


def document(found: FoundFromPressures, hashes: Sequence[str], with_figures: bool) -> Document:
    """The page.

    Args:
        hashes: SHA-256 of the recordings.
    """
    rig = found.recalibrated.start.name
    best = found.proposed
    now = "kept as it is" if best is None else f"{number(best.pooled('identified'))}°"
    tiles = Tiles(
        (
            Tile("verdict", found.verdict, ", ".join(item.name for item in found.taken)),
            Tile("angle, held-out", now, f"was {number(found.recalibrated.pooled('as_configured'))}°, as configured"),
        )
    )
    verdict, *rest = summary(found)
    values = [_values(item) for item in found.taken]
    shown = found.extended or found.recalibrated
    figures = [
        Section(item.name, tuple(drawn.held_out_figures(item, shown.rig)), anchor=f"held-{k}")
        for k, item in enumerate(judged_of(shown) if with_figures else ())
    ]
    definitions = (
        ("Held-out", "Data that no fit used."),
        ("Recalibrated", "The model of the rig file with all its values fitted, without a further effect."),
        ("Driven by pressures", "The measured pressures drive the joint, and no filter runs."),
    )
    provenance = [("Rig", rig), *(("Recording", text) for text in hashes)]
    lede = Text(f"Rig {rig}: which effect its model lacks.", "lede")
    blocks = (lede, verdict, tiles, *rest, *values, *figures, *background(definitions, provenance))
    return Document("Closed loop", rig, blocks)


def numbers(found: FoundFromPressures, hashes: Sequence[str], next_rig: str | None) -> dict[str, Any]:
    """Content of ``report.json``.

    Args:
        hashes: SHA-256 of the recordings.
        next_rig: name of the rig file to use; None: keep the one that there is.
    """
    base, best = found.recalibrated, found.extended or found.recalibrated
    values, stds = base.final[0].values, base.final[0].stds
    return {
        "verdict": found.verdict,
        "sentence": sentence(found),
        "effects": [
            {
                "name": item.name,
                "muscle": item.muscle,
                "place": item.place,
                "parameters": {k: {"value": v, "std": s, "unit": u} for k, (v, s, u) in item.parameters.items()},
                "delta_bic": item.delta_bic,
                "holdout_gain": item.gain,
                "onset_s": None,
            }
            for item in found.taken
        ],
        "ambiguous_with": list(found.ambiguous_with),
        "calibration": [
            {"name": name, "value": value, "std": std, "unit": unit, "recording": None}
            for name, value, std, unit in (
                ("encoder_zero", values[ZERO], stds[ZERO], "rad"),
                ("delay_angle", -values[DELAY], stds[DELAY], "s"),
            )
            if abs(value) > 5.0 * std
        ],
        "errors": {
            "as_configured": _model_errors(base, "as_configured"),
            "recalibrated": _model_errors(base, "identified"),
            "extended": _model_errors(best, "identified"),
        },
        "filter_errors_deg": {
            "as_configured": base.pooled("as_configured"),
            "recalibrated": base.pooled("identified"),
            "extended": best.pooled("identified"),
        },
        "candidates": [
            {"name": item.name, "muscle": item.muscle, "place": item.place, "holdout_gain": item.gain,
             "delta_bic": item.delta_bic}
            for item in found.tried
        ],
        "unexplained": list(found.unexplained),
        "next_rig": next_rig,
        "rig": base.start.name,
        "recordings_sha256": list(hashes),
    }  # fmt: skip


def _model_errors(found: FromPressures, rig: str) -> dict[str, Any]:
    """Errors of the model alone on all held-out data: RMS over rows, and the largest."""
    reports = [(getattr(item, rig).model_alone, item.rows) for item in found.held]
    angles = [(one.angle, rows) for one, rows in reports if one.angle is not None]
    torques = [(one.torque, rows) for one, rows in reports if one.torque is not None]
    pressures = [
        math.sqrt(sum(rows * one.pressure.rmse_pa[k] ** 2 for one, rows in reports) / sum(rows for _, rows in reports))
        for k in (0, 1)
    ] if reports else None  # fmt: skip
    return {
        "angle": _pooled(angles, "deg"),
        "torque": _pooled(torques, "nm"),
        "pressure": None if pressures is None else {"rmse_pa": pressures},
    }


def _pooled(errors: Sequence[tuple[Any, int]], unit: str) -> dict[str, float] | None:
    if not errors:
        return None
    total = sum(rows for _, rows in errors)
    return {
        f"rmse_{unit}": math.sqrt(sum(rows * item.rmse**2 for item, rows in errors) / total),
        f"max_{unit}": max(item.largest for item, _ in errors),
        "q": max(item.ratio for item, _ in errors),
    }
