"""The report of an identified sealed joint: ``report.json`` and ``report.html``.

Keys::

    held_out     [{name, from_s, as_configured, identified}]: figures of a replay
                 (:mod:`pam_antagonist.report.replay`: ukf, model_alone, innovation) of the part that was not fitted
    stages       [{name, values: {name: {before, after, std}}, residual, unit, note}]
    tuning       R, Q, random walk of the torque from outside, likelihood of the angle's errors before and after
    assumed      sentences: what the recordings do not tell
    recordings   [{name, sha256, duration_s, fitted_until_s}]
    software     versions
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pam_antagonist.identification.sealed_session import SealedIdentified
from pam_antagonist.recording import Recording
from pam_antagonist.report import html
from pam_antagonist.report.document import Block, Document, Section, Text, Tile, Tiles
from pam_antagonist.report.replay import Replay, after, replay
from pam_antagonist.report.replay_figures import replay_figures
from pam_antagonist.report.table import MISSING, Table, number, percent
from pam_antagonist.rig import Rig
from pam_antagonist.software import versions

_RIGS = ("as_configured", "identified")
ASSUMED = (
    "The volume of each muscle at angle 0 and the polytropic index: closed chambers tell only k_2 (dV/dl)/V.",
    "The force map but for the difference of the two: a sealed joint does not tell how force grows with pressure.",
    "The inertia, and whatever else slow motion does not tell.",
    "The charge at angle 0 holds while the muscles stay closed: pressures alone cannot tell an angle from a difference "
    "in charge.",
)


@dataclass(frozen=True, eq=False)
class SealedJudged:
    """One recording by both rigs: replays of the whole of it and of the part that was held out."""

    name: str
    from_s: float
    whole: dict[str, Replay]
    held: dict[str, Replay]


def judge(recordings: Sequence[tuple[Recording, str]], found: SealedIdentified) -> list[SealedJudged]:
    """Run every recording through both rigs and judge what was held out.

    Args:
        recordings: as they were identified.
        found: the identification.
    """
    out = []
    for (recording, name), begin in zip(recordings, found.held_from, strict=True):
        rigs = dict(zip(_RIGS, (found.start, found.rig), strict=True))
        whole = {key: replay(recording, rig, joint="free") for key, rig in rigs.items()}
        out.append(SealedJudged(name, begin, whole, {key: after(item, begin) for key, item in whole.items()}))
    return out


def document(found: SealedIdentified, judged: Sequence[SealedJudged]) -> dict[str, Any]:
    """What goes into ``report.json``.

    Args:
        found: the identification.
        judged: of :func:`judge`.
    """
    before, now = found.start.tuning("default"), found.rig.tuning("default")
    keys = ("samples", "duration_s", "ukf", "model_alone", "innovation")
    return {
        "held_out": [
            {
                "name": item.name,
                "from_s": item.from_s,
                **{key: {name: item.held[key].report[name] for name in keys} for key in _RIGS},
            }
            for item in judged
        ],
        "stages": [
            {
                "name": stage.name,
                "values": {
                    name: {"before": found.start.value(name), "after": value, "std": stage.std.get(name)}
                    for name, value in stage.values.items()
                },
                "residual": stage.residual,
                "unit": stage.unit,
                "note": stage.note,
            }
            for stage in found.stages
        ],
        "tuning": {
            "measurement": {"before": list(before.measurement), "after": list(now.measurement)},
            "process": {"before": list(before.process), "after": list(now.process)},
            "random_walk": {"before": _walk(found.start), "after": _walk(found.rig)},
            "log_likelihood": {"before": found.likelihood[0], "after": found.likelihood[1]},
            "evaluations": found.evaluations,
        },
        "assumed": list(ASSUMED),
        "recordings": [
            {
                "name": item.name,
                "sha256": item.whole["identified"].report["recording"]["sha256"],
                "duration_s": item.whole["identified"].report["duration_s"],
                "fitted_until_s": item.from_s,
            }
            for item in judged
        ],
        "software": versions(),
    }


def _walk(rig: Rig) -> float:
    return rig.value("effects.external_torque.noise")


def held_out_table(entry: dict[str, Any]) -> Table:
    """Errors on the held-out part of one recording, the rig as configured beside the identified one."""
    rows: list[tuple[str, ...]] = []

    def add(text: str, *path: str, scale: float = 1.0, shown: Any = number) -> None:
        values = []
        for rig in _RIGS:
            node: Any = entry[rig]
            for part in path:
                node = None if node is None else node.get(part)
            values.append(MISSING if node is None else shown(node * scale))
        rows.append((text, *values))

    add("UKF, angle RMSE 𝕀 [°]", "ukf", "angle", "rmse_deg")
    add("UKF, largest error over range, ℚ", "ukf", "angle", "q", shown=percent)
    add("UKF, angle in the 95 % interval", "ukf", "angle", "coverage95", shown=percent)
    add("UKF, torque from outside, RMSE [N m]", "ukf", "external_torque", "rmse_nm")
    add("Model alone, given that torque: angle RMSE [°]", "model_alone", "angle", "rmse_deg")
    caption = f"{entry['name']}, from {entry['from_s']:.1f} s on"
    return Table((caption, "as configured", "identified"), tuple(rows))


def values_table(content: dict[str, Any]) -> Table:
    """The parameters that were found."""
    rows = []
    for stage in content["stages"]:
        for name, item in stage["values"].items():
            std = MISSING if item["std"] is None else number(item["std"], 2)
            rows.append((name, number(item["before"], 5), number(item["after"], 5), std))
    return Table(("Parameter, SI units", "as configured", "identified", "standard error"), tuple(rows))


def write_report(
    folder: Path, content: dict[str, Any], judged: Sequence[SealedJudged], with_figures: bool = True
) -> None:
    """Write ``report.json`` and ``report.html`` into a folder that exists.

    Args:
        folder: where to.
        content: of :func:`document`.
        judged: of :func:`judge`.
        with_figures: False leaves the figures out of the page.
    """
    html.write(folder, page(content, judged, with_figures), content)


def page(content: dict[str, Any], judged: Sequence[SealedJudged], with_figures: bool = True) -> Document:
    """The report as a page.

    Args:
        content: of :func:`document`.
        judged: of :func:`judge`.
        with_figures: False leaves the figures out.
    """
    first = content["held_out"][0]["identified"]["ukf"]["angle"]
    verdict = (
        f"On data that were not fitted the filter finds the angle from the two pressures alone to "
        f"{first['rmse_deg']:.2f}° RMS, at most {100 * first['q']:.1f} % of its range; "
        f"{percent(first['coverage95'])} of the angles lie in their 95 % interval."
    )
    tiles = [Tile("Angle error (RMS)", f"{first['rmse_deg']:.3f}°", "from pressures alone, held-out part")]
    external = content["held_out"][0]["identified"]["ukf"]["external_torque"]
    if external is not None and math.isfinite(external["rmse_nm"]):
        note = "estimated without having been told it; where the joint sticks, friction hides it"
        tiles.append(Tile("Torque from outside (RMS)", f"{external['rmse_nm']:.2f} N m", note))
    held: list[Block] = []
    for entry, item in zip(content["held_out"], judged, strict=True):
        held.append(held_out_table(entry))
        if with_figures:
            held += replay_figures(item.whole["identified"])
    stages = tuple((s["name"], f"{number(s['residual'])} {s['unit']}", s["note"]) for s in content["stages"])
    tuning = content["tuning"]
    rows = tuple(
        (name, number(tuning[key]["before"][place], 3), number(tuning[key]["after"][place], 3))
        for name, key, place in (("R [Pa²]", "measurement", 0), ("Q of a pressure, a step [Pa²]", "process", 2))
    )
    walk = (
        "Random walk of the torque [N m/s^0.5]",
        *(number(tuning["random_walk"][key], 3) for key in ("before", "after")),
    )
    provenance = tuple((r["name"], f"{r['duration_s']:.1f} s, fitted to {r['fitted_until_s']:.1f} s", r["sha256"])
                       for r in content["recordings"])  # fmt: skip
    parts: list[Block] = [
        Text("A joint whose muscles are sealed: no air flows, a torque from outside moves it.", "lede"),
        Text(verdict, "verdict"),
        Tiles(tuple(tiles)),
        Section("On data that were held out", tuple(held), 2, "held-out"),
        Section("Parameters", (values_table(content),), 2, "parameters"),
        Section(
            "Step by step",
            (Table(("Step", "left over (RMS)", "to be known"), stages, prose=True),),
            2,
            "steps",
        ),
        Section(
            "Tuning",
            (
                Text("The values under which the errors of the measured angle are most likely, on the fitted part."),
                Table(("", "as configured", "identified"), (*rows, walk)),
            ),
            2,
            "tuning",
        ),
        Section("What is assumed", tuple(Text(text) for text in content["assumed"]), 2, "assumed"),
        Section(
            "How this report was made",
            (Table(("Recording", "Length", "SHA-256"), provenance, prose=True),),
            folded=True,
        ),
    ]
    rig = judged[0].whole["identified"].rig.name
    return Document("Identification of a sealed muscle joint", f"Rig {rig}", tuple(parts))
