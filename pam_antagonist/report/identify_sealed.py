"""The report of an identified sealed joint."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pam_antagonist.identification.sealed import SealedIdentified
from pam_antagonist.identification.sealed_tuning import drift_size
from pam_antagonist.report import html
from pam_antagonist.report.assumption import assumption, in_first_lines
from pam_antagonist.report.document import Block, Document, Section, Text, Tile, Tiles, background
from pam_antagonist.report.held_out import HeldOut, Judged, held_out_table
from pam_antagonist.report.identify_entries import Change
from pam_antagonist.report.identify_findings import DEFINITIONS, do_not_use, rejection
from pam_antagonist.report.replay_figures import replay_figures
from pam_antagonist.report.table import MISSING, Table, number, percent
from pam_antagonist.report.units import readable, unit_of
from pam_antagonist.rig import Rig
from pam_antagonist.rig.load import refusal
from pam_antagonist.software import versions

ASSUMED = (
    "The volume of each muscle at angle 0 and the polytropic index: closed chambers determine k_2 (dV/dl)/V only.",
    "The force map: a sealed joint determines the difference of the two muscles' forces only, not how a force grows "
    "with pressure.",
    "The inertia, and whatever else does not matter in slow motion.",
    "The charge: at angle 0 it stays the same while the muscles are closed. Pressures alone do not distinguish an "
    "angle from a difference in charge.",
)


@dataclass(frozen=True)
class ValueChange(Change):
    """A parameter before and after."""

    std: float | None
    unit: str


@dataclass(frozen=True)
class StepEntry:
    """A step of the identification."""

    name: str
    values: Mapping[str, ValueChange]
    residual: float
    unit: str
    note: str


@dataclass(frozen=True)
class VectorChange:
    """Diagonal of a covariance, in squared SI units."""

    before: tuple[float, ...]
    after: tuple[float, ...]


@dataclass(frozen=True)
class SealedTuning:
    """The filter's tuning.

    Attributes:
        drift_std_pa: standard deviation of the readings' drift [Pa].
        drift_time_s: time constant of the drift [s].
        random_walk: noise of the external torque [N m/√s].
        log_likelihood: log likelihood of the angle's errors, minus the square of ln(NIS/2).
    """

    measurement: VectorChange
    process: VectorChange
    drift_std_pa: Change
    drift_time_s: Change
    random_walk: Change
    log_likelihood: Change
    evaluations: int


@dataclass(frozen=True)
class SealedRecording:
    """A recording that was used.

    Attributes:
        duration_s: length [s].
        fitted_until_s: end of the fitted part [s].
    """

    name: str
    sha256: str
    duration_s: float
    fitted_until_s: float


@dataclass(frozen=True)
class SealedReport:
    """All numbers of the identification of a sealed joint.

    Attributes:
        held_out: errors on the part of each recording that was not fitted.
        assumption: the uncertainty that the rig file claims; None for an identified rig.
        rejected: why the identified rig should not be used; empty if it may.
    """

    held_out: tuple[HeldOut, ...]
    stages: tuple[StepEntry, ...]
    tuning: SealedTuning
    assumed: tuple[str, ...]
    recordings: tuple[SealedRecording, ...]
    software: Mapping[str, str]
    assumption: str | None = None
    rejected: str = ""


def report(found: SealedIdentified, judged: Sequence[Judged]) -> SealedReport:
    """The numbers of an identification.

    Args:
        judged: of :func:`pam_antagonist.report.held_out.judge`.
    """
    before, now = found.start.tuning("default"), found.rig.tuning("default")
    walk = "effects.external_torque.noise"
    return SealedReport(
        held_out=tuple(HeldOut.of(item) for item in judged),
        stages=tuple(
            StepEntry(
                stage.name,
                {
                    name: ValueChange(found.start.value(name), value, stage.std.get(name), unit_of(found.start, name))
                    for name, value in stage.values.items()
                },
                stage.residual,
                stage.unit,
                stage.note,
            )
            for stage in found.stages
        ),
        tuning=SealedTuning(
            VectorChange(tuple(before.measurement), tuple(now.measurement)),
            VectorChange(tuple(before.process), tuple(now.process)),
            Change(_drift(found.start), _drift(found.rig)),
            Change(found.start.value(_DRIFT_TIME), found.rig.value(_DRIFT_TIME)),
            Change(found.start.value(walk), found.rig.value(walk)),
            Change(*found.likelihood),
            found.evaluations,
        ),
        assumed=ASSUMED,
        recordings=tuple(
            SealedRecording(item.name, whole.recording.sha256, whole.duration_s, item.from_s)
            for item in judged
            for whole in [item.whole["identified"].report]
        ),
        software=versions(),
        assumption=assumption(found.start, identified=True),
        rejected=rejection(tuple(HeldOut.of(item) for item in judged), refusal(found.rig)),
    )


_DRIFT_TIME = "effects.pressure_sensor.drift_time"


def _drift(rig: Rig) -> float:
    """Standard deviation of the drift of the pressure readings, the larger of both [Pa]."""
    noise = max(rig.value(f"effects.pressure_sensor.drift_{muscle}") for muscle in (1, 2))
    return drift_size(noise, rig.value(_DRIFT_TIME))


def write_report(folder: Path, numbers: SealedReport, judged: Sequence[Judged], with_figures: bool = True) -> None:
    """Write ``report.json`` and ``report.html`` into an existing folder.

    Args:
        numbers: of :func:`report`.
        judged: of :func:`pam_antagonist.report.held_out.judge`.
    """
    html.write(folder, document(numbers, judged, with_figures), numbers)


def summary(numbers: SealedReport) -> tuple[Block, ...]:
    """Blocks for the terminal."""
    said = (Text(do_not_use(numbers.rejected), "verdict"),) if numbers.rejected else ()
    return *said, *in_first_lines(numbers.assumption), _values_table(numbers), *map(held_out_table, numbers.held_out)


def document(numbers: SealedReport, judged: Sequence[Judged], with_figures: bool = True) -> Document:
    """The report as a document.

    Args:
        numbers: of :func:`report`.
        judged: of :func:`pam_antagonist.report.held_out.judge`.
    """
    ukf = numbers.held_out[0].identified.ukf
    parts: list[Block] = [Text("A joint whose muscles are sealed: no air flows, an external torque moves it.", "lede")]
    if numbers.rejected:
        parts.append(Text(do_not_use(numbers.rejected), "verdict"))
    tiles = []
    if ukf.angle is not None:
        text = (
            f"On held-out data the filter's angle error is {ukf.angle.rmse:.2f}° (RMS), from the two pressures alone. "
            f"The largest error is {percent(ukf.angle.ratio)} of the range. {percent(ukf.angle.coverage95)} of the "
            "angles lie in their 95 % interval."
        )
        parts.append(Text(text, "verdict"))
        tiles.append(Tile("Angle error (RMS)", f"{ukf.angle.rmse:.3f}°", "from pressures alone, held-out part"))
    if ukf.external_torque is not None and math.isfinite(ukf.external_torque.rmse):
        note = "estimated by the filter; where the joint sticks, friction hides it"
        tiles.append(Tile("External torque (RMS)", f"{ukf.external_torque.rmse:.2f} N m", note))
    held: list[Block] = []
    for place, (entry, item) in enumerate(zip(numbers.held_out, judged, strict=True)):
        figures = replay_figures(item.whole["identified"], item.from_s) if with_figures else ()
        if place == 0:
            parts, figures = [*parts, *figures[:1]], figures[1:]
        held += [held_out_table(entry), *figures]
    steps = tuple((step.name, f"{number(step.residual)} {step.unit}", step.note) for step in numbers.stages)
    parts += [
        *in_first_lines(numbers.assumption),
        Tiles(tuple(tiles)),
        Section("On held-out data", tuple(held), 2, "held-out"),
        Section("Parameters", (_values_table(numbers),), 2, "parameters"),
        Section("Step by step", (Table(("Step", "residual (RMS)", "note"), steps, prose=True),), folded=True),
        Section("Tuning", _tuning(numbers.tuning), folded=True),
        Section("What is assumed", tuple(Text(text) for text in numbers.assumed), folded=True),
        *background([item for item in DEFINITIONS if item[0] in _TERMS], _provenance(numbers)),
    ]
    rig = judged[0].whole["identified"].rig.name
    return Document("Identification of a sealed muscle joint", f"Rig {rig}", tuple(parts))


_TERMS = ("Held out", "As configured", "UKF", "RMSE 𝕀, ratio ℚ", "Standard error")


def _tuning(tuning: SealedTuning) -> tuple[Block, ...]:
    text = (
        "R is the noise of the pressures. The other values maximise the likelihood of the errors of the measured angle "
        "on the fitted part, while the innovations are as large as the filter expects. The drift of the readings is a "
        "state of its own, and not in R."
    )
    rows = (
        ("R [Pa²]", tuning.measurement.before[0], tuning.measurement.after[0]),
        ("Drift of the readings, std. dev. [Pa]", tuning.drift_std_pa.before, tuning.drift_std_pa.after),
        ("Its time constant [s]", tuning.drift_time_s.before, tuning.drift_time_s.after),
        ("Q of the velocity, a step [rad²/s²]", tuning.process.before[1], tuning.process.after[1]),
        ("Q of a pressure, a step [Pa²]", tuning.process.before[2], tuning.process.after[2]),
        ("Random walk of the torque [N m/s^0.5]", tuning.random_walk.before, tuning.random_walk.after),
    )
    cells = tuple((name, number(before, 3), number(after, 3)) for name, before, after in rows)
    return Text(text), Table(("", "as configured", "identified"), cells)


def _provenance(numbers: SealedReport) -> list[tuple[str, str]]:
    return [
        (
            f"Recording {item.name}",
            f"{item.duration_s:.1f} s, fitted to {item.fitted_until_s:.1f} s; SHA-256 {item.sha256}",
        )
        for item in numbers.recordings
    ]


def _values_table(numbers: SealedReport) -> Table:
    """The identified parameters."""
    rows = tuple(
        (
            f"{name} [{unit.name}]",
            number(item.before * unit.scale, 5),
            number(item.after * unit.scale, 5),
            MISSING if item.std is None else number(item.std * unit.scale, 2),
        )
        for step in numbers.stages
        for name, item in step.values.items()
        for unit in [readable(item.unit)]
    )
    return Table(("Parameter", "as configured", "identified", "standard error"), rows)
