"""The report on the paper's experiments: page, document and Markdown of the same results."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from pam_antagonist.report.document import Block, Document, Findings, Section, Text
from pam_antagonist.report.document import Finding as HtmlFinding
from pam_antagonist.report.table import Table, number
from pam_antagonist.software import versions
from validation.paper.result import HEADER, Beside, Result
from validation.paper.scenario import Scenario

SOURCE = (
    "T. Shin, T. Ibayashi, K. Kogiso, “Detailed Dynamic Model of Antagonistic PAM System and its Experimental "
    "Validation: Sensor-less Angle and Torque Control with UKF”, 2022"
)
CAUTION = (
    "Our numbers are of a virtual rig: the simulator of this package with declared mismatches, which model and "
    "estimator do not know. They show how models and estimators compare under these mismatches. They say nothing about "
    "a real joint. The paper's numbers are of its authors' real rig and stand beside ours for comparison only."
)
MARK = "<!-- Written by `./run paper --docs FILE`; do not edit. -->"
_UNITS = ("%", "ms")
_WIDTHS = (27, 20, 10, 43)


def beside(items: Sequence[Beside]) -> Table:
    """Numbers beside the paper's; a sentence that stands for several numbers in a row is said once."""
    rows, last = [], ""
    for item in items:
        *cells, why = item.cells
        rows.append((*cells, "″" if why == last else why))
        last = why
    return Table(HEADER, tuple(rows), prose=True, widths=_WIDTHS)


def overview(results: Sequence[Result]) -> Table:
    """The ratios and times that the paper gives, in one table."""
    rows = [
        (result.title, *item.cells[:3])
        for result in results
        for item in result.beside
        if item.paper is not None and item.unit in _UNITS
    ]
    return Table(("Experiment", "What", "Virtual rig (ours)", "Paper (real rig)"), tuple(rows))


def mismatches(scenario: Scenario, seeds: Sequence[int]) -> Table:
    """What the virtual rigs are."""
    size = scenario.mismatch
    return Table(
        ("Mismatch", "Size"),
        (
            ("declared rig", scenario.rig),
            ("parameters", f"{100 * size.parameters:g} % standard deviation of each group (simulation/plant.py)"),
            ("valve curves", f"{100 * size.valve_curve:g} % standard deviation of each knot's open rate"),
            (
                "hysteresis of the force",
                f"{size.hysteresis.amplitude:g} N to either side, {100 * size.hysteresis.spread:g} % from muscle to "
                "muscle; the declared rig has none",
            ),
            ("sensors", "noise and steps of the declared rig"),
            (
                "virtual rigs",
                f"{len(seeds)}, seeds {min(seeds)} to {max(seeds)}; figures and live runs show seed {seeds[0]}",
            ),
        ),
    )


def page(results: Sequence[Result], scenario: Scenario, seeds: Sequence[int], took: Mapping[str, float]) -> Document:
    """The report as a page.

    Args:
        results: of the experiments.
        scenario: of the virtual rigs.
        seeds: of the virtual rigs.
        took: time by part [s].
    """
    parts: list[Block] = [Text(f"After {SOURCE}.", "lede"), Text(CAUTION, "verdict")]
    # A figure comes first, before the tables push it below the first screen.
    first = next((result for result in results if result.figures), None)
    if first is not None:
        parts.append(first.figures[0])
    shown = overview(results)
    if shown.rows:
        parts.append(Section("Beside the paper", (replace(shown, prose=True),), 2, "overview"))
    parts.append(Section("The virtual rigs", (replace(mismatches(scenario, seeds), prose=True),), 2, "rigs"))
    for result in results:
        parts.append(Section(result.title, _section(result, result is first), 2, result.name))
    parts.append(Section("How long it took", (_times(took),), folded=True))
    return Document(
        "The paper's experiments on a virtual rig",
        "Everything the paper shows, beside its numbers",
        tuple(parts),
    )


def _section(result: Result, begun: bool) -> tuple[Block, ...]:
    """What one experiment gave; where it is begun, its first figure is at the top of the page."""
    above = " Its first figure is at the top of the page." if begun else ""
    out: list[Block] = [Text(result.question + above)]
    if result.beside:
        out.append(beside(result.beside))
    if result.findings:
        out.append(Findings(tuple(HtmlFinding("note", text) for text in result.findings)))
    return (*out, *result.tables, *result.figures[1 if begun else 0 :])


def _times(took: Mapping[str, float]) -> Table:
    return Table(("Part", "Time [s]"), tuple((name, number(seconds)) for name, seconds in took.items()))


def document(
    results: Sequence[Result], scenario: Scenario, seeds: Sequence[int], took: Mapping[str, float]
) -> dict[str, Any]:
    """What goes into ``report.json``.

    Args:
        results: of the experiments.
        scenario: of the virtual rigs.
        seeds: of the virtual rigs.
        took: time by part [s].
    """
    return {
        "source": SOURCE,
        "caution": CAUTION,
        "virtual_rig": {
            "scenario": scenario.name,
            "declared": scenario.rig,
            "profile": scenario.profile,
            "parameters": scenario.mismatch.parameters,
            "valve_curve": scenario.mismatch.valve_curve,
            "hysteresis": {
                "amplitude_n": scenario.mismatch.hysteresis.amplitude,
                "spread": scenario.mismatch.hysteresis.spread,
                "width_m": scenario.mismatch.hysteresis.width,
            },
            "seeds": list(seeds),
        },
        "experiments": {result.name: result.document() for result in results},
        "seconds": dict(took),
        "software": versions(),
    }


def markdown(
    results: Sequence[Result], scenario: Scenario, seeds: Sequence[int], places: Mapping[str, Sequence[str]]
) -> str:
    """The report as Markdown, for ``docs/paper.md``: numbers beside the paper's, what follows, pictures.

    Args:
        results: of the experiments.
        scenario: what the virtual rigs are.
        seeds: of the virtual rigs.
        places: by experiment, where the picture of each of its figures is, as seen from the Markdown file.
    """
    lines = [
        MARK,
        "",
        "# Everything the paper shows, beside its numbers",
        "",
        f"After {SOURCE}.",
        "",
        f"**{CAUTION}**",
        "",
    ]
    lines += [
        "`./run paper --out DIR` makes all of it again. `DIR/report.html` has further tables and figures to zoom into; "
        "`DIR/report.json` holds every number of every seed; `--docs FILE` writes this file and its pictures. Median "
        "(least … largest) over the virtual rigs throughout; ″ stands for the sentence above.",
        "",
    ]
    lines += [*_table(mismatches(scenario, seeds)), ""]
    for result in results:
        lines += [f"## {result.title}", "", result.question, ""]
        if result.beside:
            lines += [*_table(_together(beside(result.beside))), ""]
        lines += [f"* {text}" for text in result.findings]
        lines += [""] if result.findings else []
        for figure, place in zip(result.figures, places[result.name], strict=True):
            alt = re.sub(r"([\[\]\\])", r"\\\1", figure.title)
            lines += [f"![{alt}]({place})", ""]
    return "\n".join(lines).rstrip() + "\n"


def _together(table: Table) -> Table:
    """The same with 𝕀, 𝕄 and ℚ of one quantity in one row."""
    rows: list[tuple[str, ...]] = []
    for what, ours, paper, why in table.rows:
        if rows and why == "″" and what[:-1] == rows[-1][0][: len(what) - 1] and what[-1] in "𝕄ℚ":
            rows[-1] = (f"{rows[-1][0]}, {what[-1]}", f"{rows[-1][1]}, {ours}", f"{rows[-1][2]}, {paper}", rows[-1][3])
        else:
            rows.append((what, ours, paper, why))
    return Table(table.header, tuple((*cells[:2], re.sub("^–(, –)+$", "–", cells[2]), cells[3]) for cells in rows))


def _table(table: Table) -> list[str]:
    def line(cells: Sequence[str]) -> str:
        return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"

    return [line(table.header), line(["---"] * len(table.header)), *map(line, table.rows)]
