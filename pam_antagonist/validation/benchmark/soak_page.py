"""The page of a soak run: what grew, what was lost, how long it took and what drifted, over the time of the run."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.report.document import Block, Definitions, Document, Finding, Findings, Section, Text, Tile, Tiles
from pam_antagonist.report.figure import TIME, Axis, Figure, Panel, Reference
from pam_antagonist.report.figures import lines
from pam_antagonist.report.table import number
from pam_antagonist.validation.benchmark.figure import Figure as Measured
from pam_antagonist.validation.benchmark.soak import BLOCK, WARM_UP, Soak

Floats = NDArray[np.float64]

_LINK = "soak"
_SMOOTH = 10  # seconds over which processor time is taken
_WORDS = {
    "soak_memory_growth": ("Growth of a node's memory", "the largest of all nodes"),
    "soak_recorder_growth": ("Growth of the recorder's memory", "it keeps an index of its file"),
    "soak_lost": ("Samples lost", "on the worst topic"),
    "soak_drift": ("Drift of the clocks", "from the fastest deliveries"),
    "soak_processor": ("Processor", "of one core, all processes"),
}
DEFINITIONS = (
    (
        "Resident memory",
        "The memory of a process, shared libraries included, sampled once a second. Growth counts from "
        f"{WARM_UP:.0f} s on, or from a third of a shorter run on.",
    ),
    (
        "Lost",
        "Samples that have no message of a topic in the recording. The recorder's own losses are included. The count "
        "begins when all nodes have discovered each other.",
    ),
    (
        "Round trip",
        "Time from the reception of a sample's first pressure to the reception of its command, both at the recorder.",
    ),
    (
        "Drift",
        "The fastest delivery of a pressure in each block minus that in the first block. A busy machine delays most "
        "samples, but not the fastest of ten thousand. So the difference is the drift between the device's clock, "
        "which counts samples, and the machine's clock.",
    ),
)


def page(soak: Soak, rig: str) -> Document:
    """The page.

    Args:
        soak: a finished run.
        rig: name of its rig.
    """
    length = f"{soak.usage.time[-1] / 60.0:.3g} min"
    broken = [figure for figure in soak.figures if figure.holds is False]
    verdict = "Every bound held." if not broken else f"{len(broken)} of {len(soak.figures)} figures broke their bound."
    lede = (
        f"Plant, estimator, controller and recorder ran as processes for {length} on rig {rig}. The report shows "
        "growth of memory, losses, delays and drift."
    )
    content: tuple[Block, ...] = (
        Text(lede, "lede"),
        Text(verdict, "verdict"),
        Tiles(tuple(map(_tile, soak.figures))),
        Findings(tuple(map(_finding, broken))),
        _memory(soak),
        _processor(soak),
        _losses(soak),
        _round_trip(soak),
        _drift(soak),
        Section("What the words mean", (Definitions(DEFINITIONS),), folded=True),
    )
    return Document("Soak run of the live pipeline", f"{length} of {rig}", content)


def _tile(figure: Measured) -> Tile:
    title, note = _WORDS[figure.name]
    return Tile(
        title,
        f"{number(figure.value)} {figure.unit}",
        f"{note}; {figure.wanted} {figure.unit}" if figure.wanted else note,
    )


def _finding(figure: Measured) -> Finding:
    return Finding("warn", f"{figure.meaning}: {number(figure.value)} {figure.unit}, expected {figure.wanted}.")


def _memory(soak: Soak) -> Figure:
    usage = soak.usage
    warm = int(np.searchsorted(usage.time, min(WARM_UP, usage.time[-1] / 3.0)))
    grown = {name: values - np.median(values[warm : warm + 10]) for name, values in usage.resident.items()}
    bound = Reference(2.0, "bound of a node")
    panels = (
        Panel(TIME, Axis("Resident [MB]"), lines(usage.time, usage.resident), 200),
        Panel(TIME, Axis("Growth [MB]", bounds=_around(grown)), (*lines(usage.time, grown, quiet=True), bound), 200),
    )
    about = "Above, what each process has; below, against what it had after the warm-up. A leak is a line that climbs."
    return Figure("Memory", about, panels, _LINK)


def _around(grown: dict[str, Floats]) -> tuple[float, float]:
    """Bounds that show the end of the run; what was there before the warm-up may leave the picture."""
    late = np.concatenate([values[len(values) // 3 :] for values in grown.values()])
    return float(min(-1.0, late.min() * 1.1)), float(max(2.5, late.max() * 1.1))


def _processor(soak: Soak) -> Figure:
    usage = soak.usage
    span = min(_SMOOTH, len(usage.time) - 1)
    passed = usage.time[span:] - usage.time[:-span]
    share = {name: 100.0 * (cpu[span:] - cpu[:-span]) / passed for name, cpu in usage.cpu.items()}
    panel = Panel(TIME, Axis("Of one core [%]"), lines(usage.time[span:], share), 200)
    about = f"Share of one core over the last {span} seconds."
    return Figure("Processor", about, (panel,), _LINK)


def _losses(soak: Soak) -> Figure:
    samples = soak.samples
    most = max(float(values.max()) for values in samples.lost.values())
    axis = Axis("Lost [samples]", bounds=(-0.02 * max(most, 5.0), max(most, 5.0)))
    panel = Panel(TIME, axis, lines(samples.time, samples.lost), 180)
    about = f"Samples without a message of a topic, in blocks of {BLOCK:g} s."
    return Figure("Losses", about, (panel,), _LINK)


def _round_trip(soak: Soak) -> Figure:
    samples = soak.samples
    trips = {"median": samples.median, "99th percentile": samples.p99, "largest": samples.largest}
    known = np.concatenate(list(trips.values()))
    known = known[np.isfinite(known) & (known > 0.0)]
    decades = (math.floor(math.log10(known.min())), math.ceil(math.log10(known.max()))) if len(known) else (-1, 1)
    bounds = (10.0 ** decades[0], 10.0 ** max(decades[1], decades[0] + 1))
    panel = Panel(TIME, Axis("Round trip [ms]", log=True, bounds=bounds), lines(samples.time, trips), 230)
    about = f"The time from a pressure to the command that answers it, in blocks of {BLOCK:g} s."
    return Figure("Round trip", about, (panel,), _LINK)


def _drift(soak: Soak) -> Figure:
    count = len(soak.drift)
    seconds = np.linspace(0.5, count - 0.5, count) * BLOCK
    panel = Panel(TIME, Axis("Drift [ms]"), lines(seconds, {"quickest delivery": soak.drift}), 180)
    about = "Device time against the machine's; a straight slope would be clocks that run apart."
    return Figure("Drift", about, (panel,), _LINK)
