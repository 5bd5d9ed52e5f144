"""The results of ``close_loop`` with their pages: sentences and tables of typed numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from typing_extensions import override

from pam_antagonist.diagnosis import FoundEffect, thresholds
from pam_antagonist.diagnosis.closed_loop import ClosedLoop
from pam_antagonist.diagnosis.errors import ModelErrors
from pam_antagonist.diagnosis.residual_statistics import Relation, ResidualRow
from pam_antagonist.diagnosis.result import MODELS, Residuals
from pam_antagonist.diagnosis.verdicts import TITLES, Verdict
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.replays.result import CHANNELS, TORQUE, EstimatedChannel
from pam_antagonist.report import close_loop_findings as said
from pam_antagonist.report.document import (
    Block,
    Comparison,
    Definitions,
    Document,
    Findings,
    Section,
    Table,
    Text,
    Tile,
    Tiles,
    in_first_lines,
    note,
    page,
)
from pam_antagonist.report.figure import Figure
from pam_antagonist.report.identify import held_out_figures
from pam_antagonist.report.result import DataFrame, Result, frame_of
from pam_antagonist.rig.units import assumption, readable
from pam_antagonist.shown import MISSING, number, percent

_KICKER = "Closing the loop with measured data"
_FEW_WORDS = 300
"""Longest list of what the recordings cannot show [characters] that is among the findings where nothing was found."""
_KINDS = {"equation": "Equations", "sensor": "Sensors", "innovation": "Estimator's innovations"}
_CERTAIN = 0.05
_EVIDENCE = (
    "Evidence: twice the gain in log-likelihood of a fit, less a price for each parameter (ΔBIC); above "
    f"{thresholds.STRONG:g} is strong."
)
_STATISTICS = (
    "On held-out data. Sensors: measurement minus model, which starts with the recording and gets the voltages only. "
    "Equations: errors of flow, torque and motion, where the model starts again from the measurement every fifth of a "
    "second, so that the error of one equation does not enter the next. Innovations: measured pressures minus the "
    "estimator's prediction. Each residual is compared with signals up to 2 s before it. Later signals do not count: "
    "in a closed loop, commands follow from residuals."
)
_STATISTICS_DRIVEN = (
    "On held-out data: measurement minus model, which is driven by the measured angle. Each residual is compared with "
    "signals up to 2 s before it."
)


@dataclass(frozen=True, eq=False, repr=False)
class DiagnoseResult(ClosedLoop, Result):
    """The diagnosis, see :class:`pam_antagonist.diagnosis.Diagnosis`, with its inputs.

    Attributes:
        start: the rig as configured.
        hashes: SHA-256 of each recording, whole held-out recordings last.
        seed: of the search.
        kept: share of each recording that was held out, or names of held-out recordings.
        typed: corrections with which the recordings were read.
    """

    @override
    def document(self, figures: bool = True) -> Document:
        lede = (
            "This report compares the model of the joint with measurements. It traces what the model lacks to a "
            "physical effect, if one explains it on data that no fit used."
        )
        title = title_of(self.verdict, [effect.in_short for effect in self.effects])
        if self.calibrations and self.verdict == "none" and not self.held:
            title = "Calibration: " + ", ".join(item.name.replace("_", " ") for item in self.calibrations)
        first, *others = (said.residuals(self) if figures else ()) or (None,)
        unseen = tuple(map(note, self.unseen))
        few = unseen if self.verdict == "none" and sum(map(len, self.unseen)) <= _FEW_WORDS else ()
        parts: list[Block] = [
            Tiles(_tiles(self)),
            Findings((*said.calibration_findings(self), *said.findings(self), *few, *map(note, self.next_steps))),
            *(() if first is None else (first,)),
            *in_first_lines(assumption(self.start)),
            errors_table(self),
        ]
        if others:
            parts.append(Section("More residuals before and after", tuple(others), 2, "residual"))
        if self.calibrations:
            parts.append(Section("Calibration", (calibration_table(self),), 2, "calibration", brief=True))
        parts += _about_effects(self.effects, said.profiles(self.profiles), figures)
        if self.ranking:
            parts.append(Section("All candidates", (ranking_table(self),), 2, "candidates", brief=True))
        if self.remaining:
            parts.append(Section("What is left", said.left(self.remaining, figures), 2, "left"))
        held = self.held if figures else ()
        parts += [Section(item.name, held_out_figures(item), 2, f"held-{k}") for k, item in enumerate(held)]
        about = Text(_STATISTICS_DRIVEN if self.driven else _STATISTICS)
        models = ("recalibrated", "extended") if self.effects else ("recalibrated",)
        tables = [_statistics(one.recording, one.residuals, models) for one in self.recordings if one.residuals]
        if tables:
            parts.append(Section("Statistics of the residuals", (about, *tables), 2, "statistics", folded=True))
        if unseen and not few:
            parts.append(Section("What these recordings cannot show", (Findings(unseen),), folded=True))
        parts.append(Section("What was assumed", (Definitions(said.assumed(self)),), folded=True))
        words_of = said.kind_of(self)
        return page(_KICKER, title, parts, words_of, _provenance(self), lede, self.sentence)

    def to_dataframe(self) -> DataFrame:
        """A row for each parameter of each detected effect (needs pandas)."""
        return effects_frame(self.effects)


def _about_effects(effects: Sequence[FoundEffect], profiles: Sequence[Figure], figures: bool) -> list[Section]:
    """What was found, with its law and its size; nothing where nothing was."""
    if not effects:
        return []
    named = [CATALOGUE[name] for name in dict.fromkeys(effect.name for effect in effects) if name in CATALOGUE]
    rows = tuple((item.name, f"{item.law} ({item.source}). {item.signature}") for item in named)
    shapes = (*said.laws(effects), *profiles) if figures else ()
    blocks = (sizes_table(effects), *((Definitions(rows),) if rows else ()), *shapes)
    return [Section("Size of the effect", blocks, 2, "parameters", brief=True)]


def effects_frame(effects: Sequence[FoundEffect]) -> DataFrame:
    """A row for each parameter of each effect."""
    rows = [
        (effect.name, effect.muscle, name, value, std, unit, effect.delta_bic)
        for effect in effects
        for name, (value, std, unit) in effect.parameters.items()
    ]
    return frame_of(rows, ("effect", "muscle", "parameter", "value", "std", "unit", "delta_bic"))


def title_of(verdict: Verdict, effects: Sequence[str]) -> str:
    """The title of a page: the verdict, or what was found."""
    found = ", ".join(dict.fromkeys(name.replace("_", " ") for name in effects))
    return f"Found: {found}" if found else TITLES[verdict]


# ------------------------------------------------------------------ tables and tiles


def errors_table(result: ClosedLoop) -> Table:
    """Errors of the three models on held-out data: the model alone, then the estimator."""
    out, errors = Comparison("", "as configured", "recalibrated", "extended"), result.errors
    if result.driven:
        out.heading("Model driven by the measured angle")
        _channel_rows(out, errors, (TORQUE,), largest=True)
        for key, name in (("rmse_sliding_nm", "while it slides"), ("rmse_sticking_nm", "while it sticks")):
            if errors.extended.sliding is not None:
                values = [getattr(model.sliding, key, None) for model in errors.all]
                out.values(f"    torque {name}, RMSE [N m]", values)
        out.pressures("  mean pressure RMSE", [model.mean_rmse_pa for model in errors.all])
    else:
        out.heading("Model alone, from what was commanded")
        _channel_rows(out, errors, CHANNELS, largest=True)
    for muscle in (0, 1):
        out.pressures(f"  pressure {muscle + 1} RMSE", [model.rmse_pa[muscle] for model in errors.all])
    along = [model.along_pressures_deg for model in errors.all]
    if any(value is not None for value in along):
        out.heading("Joint alone, driven by the measured pressures")
        out.values("  angle RMSE [°]", along)
    if result.driven and errors.extended.angle is not None:
        out.heading("Model alone, driven by the external torque")
        _channel_rows(out, errors, CHANNELS[:1])
    for part in result.recordings:
        if part.ukf is not None:
            out.heading(f"Estimator from pressures alone, {part.recording}")
            _channel_rows(out, part.ukf, CHANNELS)
            for channel in CHANNELS:
                known = [item for model in part.ukf.all if (item := getattr(model, channel.name)) is not None]
                shares = [item.coverage95 for item in known]
                if len(known) == len(part.ukf.all) and None not in shares:
                    out.values(f"  {channel.name} in the 95 % interval", shares, percent, best=None)
    return out.table("Errors on held-out data")


def _channel_rows(
    out: Comparison, errors: ModelErrors, channels: Sequence[EstimatedChannel], largest: bool = False
) -> None:
    """Rows of channels; with `largest` also the largest errors and channels that were not measured."""
    for channel in channels:
        known = [item for model in errors.all if (item := getattr(model, channel.name)) is not None]
        if len(known) == len(errors.all):
            out.values(f"  {channel.name} RMSE [{channel.unit}]", [item.rmse for item in known])
            if largest:
                out.values(f"  {channel.name} largest [{channel.unit}]", [item.largest for item in known])
        elif largest:
            out.text(f"  {channel.name}", "not measured", MISSING, MISSING)


def ranking_table(result: ClosedLoop) -> Table:
    """All candidates of all rounds; where the joint was tried in parts, each with its part."""
    several = len(result.parts) > 1
    rows = tuple(
        (
            item.effect + (" (taken)" if item.taken else ""),
            *((item.part,) if several else ()),
            str(item.round),
            f"{item.score:.1f}",
            " · ".join(f"{value:.1f}" for value in item.muscles or ()) or MISSING,
            MISSING if item.delta_bic is None else f"{item.delta_bic:.1f}",
            percent(None if item.delta_bic is None else item.shares[0] if item.shares else None),
        )
        for item in result.ranking
        if item.round == 1 or item.delta_bic is not None
    )
    part = ("part",) if several else ()
    header = ("Candidate", *part, "round", "score", "muscle 1 · 2 alone", "evidence", "held-out share")
    caption = "The score is the evidence to first order, on both muscles and on each alone."
    return Table(header, rows, caption, legend=f"{_EVIDENCE} Held-out share: of the excess over noise.")


def sizes_table(effects: Sequence[FoundEffect]) -> Table:
    """Parameters of the detected effects."""
    rows = tuple(
        (
            f"{effect.name}{f', muscle {effect.muscle}' if effect.muscle else ''}: {name} [{unit.name}]",
            number(size.value * unit.scale),
            number(size.std * unit.scale, 2),
            said.meaning_of(effect.name, name),
        )
        for effect in effects
        for name, size in effect.parameters.items()
        for unit in [readable(size.unit, size.value)]
    )
    return Table(("Parameter", "value", "std. error", "what it is"), rows, "What was found")


def calibration_table(result: ClosedLoop) -> Table:
    """Zeros, scales and late stamps of the recordings."""
    rows = tuple(
        (
            f"{item.name} [{item.unit}]", number(item.value), number(item.std, 2), number(item.delta_bic, 2),
            " · ".join(f"{name}: {number(value)}" for name, (value, _) in item.by_recording.items()),
        )
        for item in result.calibrations
    )  # fmt: skip
    caption = "How much too high a sensor reads, or how much too early it is stamped. The joint itself is right."
    return Table(("Calibration", "value", "std. error", "evidence", "by recording"), rows, caption, legend=_EVIDENCE)


def _tiles(result: ClosedLoop) -> tuple[Tile, ...]:
    out, errors, ukf = [], result.errors, result.recordings[0].ukf
    filters = [result.of_one_rig[name].ukf for name in MODELS] if result.held else []
    if result.effects:
        evidence = {effect.in_short: effect.delta_bic for effect in result.effects}
        if result.share is not None:
            out.append(Tile("Explained", percent(result.share), "of the excess over noise on held-out data"))
        values = " and ".join(f"{value:.0f}" for value in evidence.values())
        strong = f"twice the gain in log-likelihood less a price; above {thresholds.STRONG:g} is strong"
        out.append(Tile(f"Evidence for {', '.join(evidence)}".replace("_", " "), values, strong))
    if (splits := result.splits) is not None:
        sure = f"{splits.agree} of {splits.of}"
        out.append(Tile("How sure", sure, "splits into fitted and held-out parts agree"))
    if result.driven:
        reference = (result.reference or {}).get("angle_and_pressures")
        line = "" if reference is None else f"; a straight-line map: {number(reference, 2)}"
        out += _change("Torque error, measured angle", TORQUE, errors, line)
        for channel in CHANNELS if ukf is not None else ():
            assert ukf is not None
            out += _change(f"{channel.title} error, pressures alone", channel, ukf)
    elif filters:
        for channel in CHANNELS:
            whole = ModelErrors(*(one for one in filters if one is not None))
            out += _change(f"{channel.title} error of the filter", channel, whole, by_effects=bool(result.effects))
    else:
        for channel in CHANNELS:
            out += _change(f"{channel.title} error (RMS)", channel, errors, by_effects=bool(result.effects))
    both = (errors.as_configured, errors.extended)
    means = [model.mean_rmse_pa for model in both if result.driven and model.mean_rmse_pa is not None]
    label = "Error of the mean pressure" if len(means) == len(both) else "Larger pressure error"
    was, now = means if len(means) == len(both) else [max(model.rmse_pa) for model in both]
    unit = readable("Pa", min(now, was))
    before = f"as configured {number(was * unit.scale, 2)} {unit.name}"
    return (*out, Tile(label, f"{number(now * unit.scale, 2)} {unit.name}", before))


def _change(
    label: str, channel: EstimatedChannel, errors: ModelErrors, more: str = "", by_effects: bool = False
) -> list[Tile]:
    """RMSE of a channel with each model; none where it was not measured."""
    before, base, after = (getattr(model, channel.name) for model in errors.all)
    if before is None or base is None or after is None:
        return []
    was = f"as configured {channel.write(before.rmse)}"
    was += f", recalibrated {channel.write(base.rmse)}" if by_effects else ""
    return [Tile(label, channel.write(after.rmse), f"{was}{more}")]


def _statistics(recording: str, shown: Residuals, models: Sequence[str]) -> Table:
    rows: list[tuple[str, ...]] = []
    last, kind = models[-1], ""
    # The models of two diagnoses may have them in another order.
    found = {(model, row.kind, row.channel): row for model in models for row in shown[model]}
    for row in shown[last]:
        if row.kind != kind:
            kind = row.kind
            rows.append((_KINDS[kind], *[""] * (len(models) + 4)))
        p = row.whiteness_p
        rows.append(
            (
                f"  {row.title}, RMS {number(row.rms, 2)} {row.unit}",
                *(_times_noise(found.get((model, row.kind, row.channel))) for model in models),
                percent(row.above_noise),
                number(row.memory_s, 2),
                MISSING if p is None or not math.isfinite(p) else "< 0.001" if p < 1e-3 else f"{p:.3f}",
                _strongest(row.relations),
            )
        )
    header = ("Residual", *(f"× noise, {model}" for model in models), "above noise", "memory [s]", "white: p", "after")
    caption = (
        f"Residuals of {recording} on held-out data. RMS and the columns from “above noise” on are of the {last} "
        "model. Above noise: share of the mean square that the sensors' noise does not explain. Memory: time between "
        "independent values. White: probability of such an autocorrelation in white noise. After: the signals with a "
        "significant correlation (p < 0.05), the most significant one first, its lag and its correlation relative to "
        "the largest one that chance gives in nineteen of twenty times."
    )
    return Table(header, tuple(rows), caption)


def _times_noise(row: ResidualRow | None) -> str:
    return MISSING if row is None else number(row.rms / row.noise, 2)


def _strongest(relations: Mapping[str, Relation]) -> str:
    """The significant signals."""
    found = sorted((item.p, name) for name, item in relations.items() if item.p < _CERTAIN)
    if not found:
        return MISSING
    first = relations[found[0][1]]
    text = f"{found[0][1]}, {first.lag_s:.2g} s, {first.over_chance:+.1f}×"
    return "; ".join([text, *(name for _, name in found[1:])])


def _provenance(result: ClosedLoop) -> list[tuple[str, str]]:
    kept = result.kept
    held = f"{percent(kept)} at the end of each recording" if isinstance(kept, float) else f"{', '.join(kept)}: whole"
    rows = [
        ("Rig", result.start.name),
        ("Source of its values", " ".join(result.start.source.split())),
        ("Seed", str(result.seed)),
        ("Held out", held),
    ]
    for part in result.recordings:
        role = "; held out" if part.role == "held out" else ""
        rows.append((f"Recording {part.recording}", f"{part.joint}{role}; SHA-256 {part.sha256}"))
    return [*rows, ("Time [s]", ", ".join(f"{name} {value:.1f}" for name, value in result.seconds.items()))]
