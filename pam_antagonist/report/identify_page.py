"""The report of an identification: ``report.json`` and ``report.html``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pam_antagonist.identification.session import Identified
from pam_antagonist.identification.stages import MEASURED
from pam_antagonist.report import html
from pam_antagonist.report import identify_figures as drawn
from pam_antagonist.report import identify_tables as tables
from pam_antagonist.report import identify_words as words
from pam_antagonist.report.channels import CHANNELS
from pam_antagonist.report.document import Block, Definitions, Document, Findings, Section, Text, Tile, Tiles
from pam_antagonist.report.identify import Judged
from pam_antagonist.report.table import Table, number, percent


def write_report(
    folder: Path, document: dict[str, Any], found: Identified, judged: Sequence[Judged], with_figures: bool = True
) -> None:
    """Write ``report.json`` and ``report.html`` into a folder that exists.

    Args:
        folder: where to.
        document: of :func:`pam_antagonist.report.identify.document`.
        found: the identification.
        judged: recordings by the rigs that are compared.
        with_figures: False leaves the figures out of the page.
    """
    html.write(folder, page(document, found, judged, with_figures), document)


def page(document: dict[str, Any], found: Identified, judged: Sequence[Judged], with_figures: bool = True) -> Document:
    """The report as a page.

    Args:
        document: of :func:`pam_antagonist.report.identify.document`.
        found: the identification.
        judged: recordings by the rigs that are compared.
        with_figures: False leaves the figures out.
    """
    several = len(judged) > 1
    lede = (
        f"From {f'{len(judged)} recordings' if several else 'one recording'}: parameters with error bars, sensor "
        "noise, filter tuning. The end of each recording was kept apart to judge the result by."
    )
    parts: list[Block] = [
        Text(lede, "lede"),
        Text(words.verdict(document), "verdict"),
        Tiles(_tiles(document)),
        Findings(words.findings(document)),
        _held_out(document, found, judged, with_figures),
        _parameters(document, found, with_figures),
        *([_between(document)] if several and document["between"] else []),
        _stages(document, found, with_figures),
        _noise(document),
        Section("What the words mean", (Definitions(words.DEFINITIONS),), folded=True),
        Section("How this report was made", _provenance(document), folded=True),
    ]
    return Document("Identification of a pneumatic muscle joint", f"Rig {found.start.name}", tuple(parts))


def _tiles(document: dict[str, Any]) -> tuple[Tile, ...]:
    out = []
    for channel in CHANNELS:
        for entry in document["held_out"]:
            figures = [entry[rig]["ukf"][channel.name] for rig in ("as_configured", "identified")]
            if channel.name == "angle" and entry["joint"]["condition"] == "locked":
                continue
            if any(item is None or item["q"] is None or not item["q"] == item["q"] for item in figures):
                continue
            before, now = (item[f"rmse_{channel.key}"] for item in figures)
            inside = percent(figures[1]["coverage95"])
            note = f"{entry['name']}; {channel.write(before)} as configured; {inside} in the 95 % interval"
            out.append(Tile(f"UKF {channel.name} error (RMS)", channel.write(now), note))
    return tuple(out)


def _held_out(document: dict[str, Any], found: Identified, judged: Sequence[Judged], with_figures: bool) -> Section:
    content: list[Block] = [
        Text("Errors on the part of each recording that was neither fitted nor used for tuning; the best is bold.")
    ]
    for index, (entry, item) in enumerate(zip(document["held_out"], judged, strict=True)):
        inner: list[Block] = [tables.held_out(entry)]
        if with_figures:
            inner += drawn.held_out_figures(item, found, index)
        content.append(Section(item.name, tuple(inner)))
    return Section("On data that were held out", tuple(content), 2, "held-out")


def _parameters(document: dict[str, Any], found: Identified, with_figures: bool) -> Section:
    content: list[Block] = []
    if with_figures:
        content.append(drawn.parameters_figure(document))
    content.append(tables.parameters(document, "All free parameters, in SI units"))
    left = [item for item in document["parameters"] if not item["determined"]]
    if left:
        rows = tuple((item["name"], item["record"]) for item in left)
        content.append(Table(("Not determined", "What to record to determine it"), rows, prose=True))
    pairs = tables.correlated(document, "Pairs that the recordings hardly tell apart")
    if pairs is not None:
        content.append(pairs)
    if with_figures:
        profile = drawn.profiles_figure(found)
        content += [*([profile] if profile else []), drawn.correlation_figure(found)]
    content.append(_profile_table(document))
    return Section("Parameters, and what the data cannot tell", tuple(content), 2, "parameters")


def _profile_table(document: dict[str, Any]) -> Table:
    rows = []
    for item in document["profiles"]:
        ends = [
            number(value, 4) if value is not None else "beyond 3 standard errors"
            for value in (item["low95"], item["high95"])
        ]
        rows.append((item["name"], *ends))
    return Table(("Parameter", "95 % from", "to"), tuple(rows), "Intervals by profile likelihood")


def _between(document: dict[str, Any]) -> Section:
    between = document["between"]
    spread = ", ".join(f"{group} {100 * value:.2f} %" for group, value in between["spread"].items())
    text = (
        "Each recording may deviate a little from the common values; by how much they do was estimated with the "
        f"parameters: {spread} (standard deviation). The logarithm of the evidence is higher by "
        f"{between['evidence_gain']:.0f} with these deviations than with the same values for all."
    )
    table = tables.differences(document, "Deviation of each recording from the common value")
    assert table is not None
    return Section("How the recordings disagree", (Text(text), table), 2, "between")


def _stages(document: dict[str, Any], found: Identified, with_figures: bool) -> Section:
    content: list[Block] = [
        Text(
            "In the order of Proposition 1: steady states depend on neither orifice areas nor polytropic indices, so "
            "they come first. Each step only has to bring the last one near."
        ),
        Section("measured directly", (Text(f"Taken from the rig file: {', '.join(_known(found))}."),)),
    ]
    fitted = [trial.part(0.0, until) for trial, until in zip(found.trials, found.held_from, strict=True)]
    for stage, entry in zip(found.stages, document["stages"], strict=True):
        inner: list[Block] = [
            Text(f"From {stage.source}." + (f" {stage.note[:1].upper()}{stage.note[1:]}." if stage.note else ""))
        ]
        if stage.values or stage.balance is not None:
            inner.append(tables.stage_residuals(entry))
        moved = tables.stage_values(entry)
        if moved is not None and stage.name != "joint refinement":
            inner.append(moved)
        figure = drawn.stage_figure(stage, fitted) if with_figures else None
        content.append(Section(stage.name, (*inner, *([figure] if figure else []))))
    if len(document["starts"]) > 1:
        rows = tuple((s["name"], number(s["cost"], 6), "best" if s["best"] else "") for s in document["starts"])
        content.append(Table(("Start", "cost", ""), rows, "The joint refinement from several starts"))
    return Section("Step by step", tuple(content), 2, "steps")


def _known(found: Identified) -> list[str]:
    free = {item.name for item in found.free}
    return [f"{name} {found.start.value(name):.4g}" for name in MEASURED if name not in free]


def _noise(document: dict[str, Any]) -> Section:
    tuning = document["tuning"]
    source = (
        f"times {tuning['scale']:.2f}, the errors of what was measured in the fitted part are most likely"
        if tuning["scale_from_reference"]
        else "no angle or torque was measured, so their size could not be checked"
    )
    rows = []
    for item in tuning["directions"]:
        largest = ", ".join(f"{entry['name']} {100 * (entry['relative'] or 0.0):+.2f} %" for entry in item["largest"])
        rows.append((item["name"], f"{item['angle_deg']:.3f}°", f"{item['torque_nm']:.4f} N m", largest))
    header = ("Direction", "moves the angle by", "the torque by", "largest changes")
    text = f"What the parameters are not known to is carried in the filter's covariance as directions: {source}."
    return Section(
        "Noise and tuning",
        (
            tables.noise(document, "Sensor noise, process noise Q and measurement noise R"),
            Text(text),
            Table(header, tuple(rows), prose=True),
        ),
        2,
        "noise",
    )


def _provenance(document: dict[str, Any]) -> tuple[Block, ...]:
    settings = document["settings"]
    rows = [
        ("Rig at the start", settings["rig"]),
        ("Freed beside the usual", ", ".join(settings["free"]) or "none"),
        ("Kept as configured", ", ".join(settings["frozen"]) or "none"),
        ("Held out", percent(settings["holdout"])),
        ("Starts and seed", f"{settings['starts']}, {settings['seed']}"),
    ]
    for item in document["recordings"]:
        rows.append((f"Recording {item['name']}", f"SHA-256 {item['sha256']}"))
        rows.append(("Its joint", f"{item['condition']}; told from: {item['told_from']}"))
        rows.append(("Its length", f"{item['duration_s']:.1f} s, of which {item['fitted_until_s']:.1f} s were fitted"))
        rows += [("Remark", issue) for issue in item["issues"][:3]]
    return (Table(("What", "Which"), tuple(rows), prose=True),)
