"""The report of an identification from measured pressures: result, terminal, page and ``report.json``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pam_antagonist.estimation import metrics
from pam_antagonist.identification.from_pressures import FromPressures, Held
from pam_antagonist.identification.unknowns import Fit
from pam_antagonist.report.document import Block, Document, Finding, Findings, Section, Text, Tile, Tiles, background
from pam_antagonist.report.figure import TIME, Axis, Band, Figure, Line, Panel, Region
from pam_antagonist.report.identify_findings import do_not_use
from pam_antagonist.report.replay_figures import time
from pam_antagonist.report.style import BAND, ESTIMATE, MEASURED
from pam_antagonist.report.table import Comparison, Table, number, percent

_DETERMINED = 0.5
"""A value is determined where the data leave less than half of its prior's standard deviation."""
_HONEST = 0.85
"""Share of the measured angles in their 95 % intervals, below which the intervals are called too narrow."""
_LARGE = 0.05
"""Error as a share of the angle's range, from which on it is called large."""
_COLUMNS = (
    ("identified", "UKF, identified rig"),
    ("as_configured", "UKF, rig file as configured"),
    ("model_alone", "model alone, from the commands"),
    ("pressures_alone", "joint driven by the measured pressures"),
    ("linear", "linear map of the two pressures"),
)


def summary(found: FromPressures) -> tuple[Block, ...]:
    """Blocks for the terminal.

    Args:
        found: the result.
    """
    now, before = found.pooled("identified"), found.pooled("as_configured")
    said = (
        f"On held-out data the filter errs by {number(now)}° (RMS); with the rig as configured it erred by "
        f"{number(before)}°. {percent(found.coverage)} of the measured angles lie in their 95 % intervals."
    )
    if found.rejected:
        said = do_not_use(found.rejected)
    items = [Finding("warn" if "stands at" in text else "note", text) for text in found.notes]
    alone = found.pooled("model_alone")
    if not found.rejected and alone < now:
        items.append(Finding("warn", f"The model alone errs less, by {number(alone)}°: the pressures add errors here."))
    share = now / max((_moved_deg(item) for item in found.held), default=np.nan)
    if not found.rejected and share > _LARGE:
        items.append(
            Finding(
                "warn",
                f"The error is {percent(share)} of the angle's range: the joint is no plain pair of muscles, or the "
                "model lacks something. Run close_loop.",
            )
        )
    if not found.rejected and found.coverage < _HONEST:
        items.append(
            Finding(
                "warn",
                "The intervals are too narrow for the held-out data. They go where the fitted data did not, or the "
                "model lacks something there: record more of the joint's range, or run close_loop.",
            )
        )
    blocks: list[Block] = [Text(said, "verdict")]
    if items:
        blocks.append(Findings(tuple(items)))
    return (*blocks, _errors(found), _values("Joint and muscles", found.final[0]), *_air(found))


def _moved_deg(item: Held) -> float:
    """Range of the held-out angle [deg]."""
    recorded = item.whole.measured_angle
    assert recorded is not None
    return float(np.degrees(np.nanmax(recorded) - np.nanmin(recorded)))


def _errors(found: FromPressures) -> Table:
    out = Comparison("Error of the angle on held-out data, RMS [°]", *(item.name for item in found.held), "all")
    for key, title in _COLUMNS:
        out.values(title, [*(item.error(key) for item in found.held), found.pooled(key)], best=None)
    out.values("in the 95 % interval", [*(item.coverage for item in found.held), found.coverage], percent, best=None)
    return out.table()


def _values(title: str, fit: Fit) -> Table:
    stds, common = fit.stds, {item.name for item in fit.unknowns if len(item.paths) > 1}
    rows = tuple(
        (name + " (both)" * (name in common), number(start), number(value, 4), number(std, 2), _determined(share))
        for name, start, value, std, share in _rows(fit, stds)
    )
    return Table(("Value [SI]", "start", "found", "std", "determined"), rows, title)


def _rows(fit: Fit, stds: dict[str, float]) -> list[tuple[str, float, float, float, float]]:
    left = np.sqrt(np.diag(fit.covariance))
    return [
        (item.name, item.start, item.value(amount), stds[item.name], float(share))
        for item, amount, share in zip(fit.unknowns, fit.amounts, left, strict=True)
    ]


def _determined(share: float) -> str:
    return "yes" if share < _DETERMINED else "with others only"


def _air(found: FromPressures) -> tuple[Block, ...]:
    if found.final[1] is None:
        return (Findings((Finding("note", "No commands were recorded: valves or regulators stay as configured."),)),)
    name = "Chambers and regulators" if found.start.drive == "regulator" else "Chambers and valves"
    return (_values(name, found.final[1]),)


def document(found: FromPressures, hashes: Sequence[str], with_figures: bool) -> Document:
    """The page.

    Args:
        found: the result.
        hashes: SHA-256 of the recordings.
        with_figures: whether to draw the held-out recordings.
    """
    lede = Text(f"Rig {found.start.name}, identified from measured pressures and motion.", "lede")
    tiles = Tiles(
        (
            Tile("angle, held-out", f"{number(found.pooled('identified'))}°", "RMS error of the filter"),
            Tile("as configured", f"{number(found.pooled('as_configured'))}°", "the same, with the rig file"),
            Tile("covered", percent(found.coverage), "of the angles in their 95 % intervals"),
        )
    )
    verdict, *rest = summary(found)
    drawn = [Section(one.name, (held_out_figure(one, found),), anchor=f"held-{k}") for k, one in enumerate(found.held)]
    definitions = (
        ("Value", "By its name in the rig file, which says beside each number what it is. (both): of both muscles."),
        ("Std", "Standard deviation that data and prior leave; it does not count errors of the model."),
        (
            "Held-out",
            "Data that no step used before these errors were computed. Then all values were fitted once more, "
            "to all of the data: these are the values of the table and of the rig file.",
        ),
        ("Determined", "The data leave less than half of the prior's standard deviation."),
        ("With others only", "The data determine a combination with other values; this one stays near its prior."),
    )
    provenance = [("Rig", found.start.name), *(("Recording", text) for text in hashes)]
    provenance += [(f"Fitted of {name}", f"the first {end:.1f} s") for name, end in found.fitted]
    figures = drawn if with_figures else []
    return Document(
        "Identified rig", found.start.name,
        (lede, verdict, tiles, *rest, *figures, *background(definitions, provenance)),
    )  # fmt: skip


def held_out_figure(item: Held, found: FromPressures) -> Figure:
    """Measured and estimated angle of a recording, and the error in its interval.

    Args:
        item: the recording.
        found: the result.
    """
    scale, x = float(np.degrees(1.0)), time(item.whole)
    recorded = item.whole.measured_angle
    assert recorded is not None
    value = item.whole.run.rows["angle"] * scale
    variance = item.whole.run.rows["covariance"][:, 0, 0] * scale**2
    half = metrics.interval_half_width(variance, found.rig.sensors.reading("angle").scaled(scale))
    shade = Region(item.from_s, float(x[-1]))
    signal = (Line("measured", x, recorded * scale, MEASURED), Line("UKF", x, value, ESTIMATE))
    error = (Band("95 % interval", x, -half, half, BAND), Line("UKF error", x, value - recorded * scale, ESTIMATE))
    panels = (
        Panel(TIME, Axis("Angle [°]"), (shade, *signal), 200),
        Panel(TIME, Axis("Error [°]"), (shade, *error), 170),
    )
    return Figure("Joint angle", "The shaded part was held out.", panels, item.name)


def numbers(found: FromPressures, hashes: Sequence[str]) -> dict[str, Any]:
    """Content of ``report.json``.

    Args:
        found: the result.
        hashes: SHA-256 of the recordings.
    """
    fits = {name: fit for name, fit in zip(("joint", "air"), found.final, strict=True) if fit is not None}
    return {
        "rig": found.start.name,
        "rejected": found.rejected or None,
        "errors_deg": {key: found.pooled(key) for key, _ in _COLUMNS},
        "coverage95": found.coverage,
        "held_out": [
            {"name": item.name, "from_s": item.from_s, "errors_deg": {key: item.error(key) for key, _ in _COLUMNS}}
            for item in found.held
        ],
        "values": {
            part: {
                name: {"start": start, "value": value, "std": std, "determined": share < _DETERMINED}
                for name, start, value, std, share in _rows(fit, fit.stds)
            }
            for part, fit in fits.items()
        },
        "unknown_torque_nm": found.covered.torque,
        "notes": list(found.notes),
        "recordings_sha256": list(hashes),
    }
