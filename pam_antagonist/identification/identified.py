"""What ``identify`` returns: the identified rig, its numbers, and the rig files."""

from __future__ import annotations

import datetime
import math
import textwrap
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from typing_extensions import Self, override

from pam_antagonist.identification.held_out import (
    COLUMNS,
    do_not_use,
    entry,
    lacks_an_effect,
    pooled_coverage,
    rejection,
)
from pam_antagonist.identification.joint_stage import DELAY, ZERO
from pam_antagonist.identification.result import FromPressures, HeldRecording, pooled
from pam_antagonist.identification.sealed import ASSUMED, SealedIdentified
from pam_antagonist.inference.bootstrap import Interval
from pam_antagonist.inference.fit import Fit
from pam_antagonist.inference.unknown import Unknown
from pam_antagonist.program import versions
from pam_antagonist.recording import Recording, recording_hash
from pam_antagonist.recording.joint import JointCondition
from pam_antagonist.replays.result import JointFacts
from pam_antagonist.report_keys import IDENTIFY, with_all_keys
from pam_antagonist.rig import Rig
from pam_antagonist.rig.file import RefusedRig, refusal, write_rig, write_unread
from pam_antagonist.rig.units import assumption, unit_of
from pam_antagonist.shown import Shown
from pam_antagonist.strict_json import picked

STRONG = 0.9
"""Least correlation of two parameters that are listed as a pair."""
_PAIRS = 12
_CERTAIN = 2.0
"""A difference is significant from so many standard errors on."""
_WHAT_SHOWS = (
    ("joint.inertia", "a free joint that is made to move fast: large voltage steps in opposite directions"),
    ("joint.viscous_friction", "a free joint that moves fast for long: alternate the valves' extremes every 0.3 s"),
    ("joint.stop", "a free joint that is driven against its stops"),
    ("friction", "a free joint with a measured angle that comes to rest at many angles and pressures"),
    (".force.", "a free joint over its whole angle range, at low and at high pressures, with torque or angle measured"),
    ("limb:", "a free joint over its whole angle range, at low and at high pressures"),
    ("inflow_area", "fast fillings of this muscle from low pressure: steps of its valve to the highest voltage"),
    ("outflow_area", "fast emptyings of this muscle from high pressure: steps of its valve to the lowest voltage"),
    (
        "gas.polytropic_flow",
        "a separate measurement of the chambers' volume or of the orifice areas: a recording shows only both together",
    ),
    ("gas.polytropic_volume", "a free joint that moves while the valves are still, so that only the volume changes"),
    (".volume.", "the volume of the muscle by length in a graduated cylinder (a static CSV)"),
    ("supply.pressure", "a steady pressure with the valve fully open, or a gauge on the tank"),
    ("effects.regulator_", "steps of both commanded pressures of different sizes, a locked joint's as well"),
    ("effects.", "longer recordings in which the effect is at work"),
)
_UNITS = {ZERO: "rad", DELAY: "s"}


class ParameterEntry(NamedTuple):
    """A free parameter before and after the fit, in SI units; `record` would determine it."""

    name: str
    start: float
    value: float
    std: float
    relative_change: float
    prior_std: float
    bound: float | None
    determined: bool
    reason: str
    record: str | None
    unit: str

    @classmethod
    def of_interval(cls, name: str, rig: Rig, start: float, found: Interval) -> ParameterEntry:
        """A value that has a 95 % interval and no prior."""
        reason = "" if found.is_known else "the episodes do not determine it"
        return cls(
            name, start, found.value, found.std, _relative(start, found.value), math.nan, None, found.is_known, reason,
            recording_that_shows(name) if reason else None, unit_of(rig, name),
        )  # fmt: skip


class Difference(NamedTuple):
    """Relative differences between the recordings in one parameter."""

    name: str
    deviations: tuple[float, ...]
    largest: float
    std: float
    certain: bool


@dataclass(frozen=True, eq=False, repr=False)
class Identified(Shown):
    """An identified rig; the fields are those of ``IdentifyResult``, which adds the page."""

    rig: Rig
    own: tuple[Rig, ...]
    found: FromPressures | SealedIdentified
    held: tuple[HeldRecording, ...]
    recordings: tuple[tuple[Recording, JointCondition, str], ...]
    seed: int = 0

    @override
    def _brief(self) -> str:
        names = ", ".join(name for _, _, name in self.recordings)
        return f"rig {self.rig.name} from {names}; {len(self.warnings)} warnings; .summary() has the errors"

    @cached_property
    def rejected(self) -> str:
        """Why the identified rig should not be used, in a sentence; empty if it may."""
        found = self.found
        saw = isinstance(found, FromPressures) and found.start_saw
        return found.rejected or rejection(self.held, refusal(self.rig), self.parameters, found.start.bounds, saw)

    @property
    def adapts(self) -> bool:
        """Whether an identified rig followed its joint, by :func:`adapt`."""
        return isinstance(self.found, FromPressures) and self.found.options.adapts

    @property
    def warnings(self) -> tuple[str, ...]:
        """For the user."""
        return (*([do_not_use(self.rejected, self.adapts)] if self.rejected else []), *self.found.notes)

    def named(self) -> Self:
        """This result with rigs that say what they were identified from, in memory as in their files."""
        start, names = self.found.start, ", ".join(name for _, _, name in self.recordings)
        source = f"identified from {names}; started from: {start.source.strip()}"
        fitted = {**start.fitted, **self.fitted}

        def of(rig: Rig, more: str = "") -> Rig:
            name = f"{start.name.removesuffix('_identified')}_identified"
            words = " ".join(f"{source}{more}".split())
            return rig.replaced(name=name, source=words, identified=names, fitted=fitted)

        alone = zip(self.own, self.recordings, strict=False)
        own = tuple(of(rig, f"; with the values of {name} alone") for rig, (_, _, name) in alone)
        return replace(self, rig=of(self.rig), own=own)

    @property
    def fitted(self) -> Mapping[str, float]:
        """SHA-256 of each recording that the values were fitted to, and the end of that part [s]."""
        if isinstance(self.found, FromPressures):
            return self.found.saw
        held = {held.name: held.from_s for held in self.held}
        return {recording_hash(one): held[name] for one, _, name in self.recordings}

    @property
    def lacks_an_effect(self) -> bool:
        """Whether the filter got no better on held-out data; :func:`diagnose` then searches for the missing effect."""
        no_better = self.errors_deg.get("identified", 0.0) > self.errors_deg.get("as_configured", math.inf)
        return no_better or lacks_an_effect(self.held)

    @cached_property
    def parameters(self) -> tuple[ParameterEntry, ...]:
        """All free parameters before and after the fit."""
        found, start = self.found, self.found.start
        if isinstance(found, FromPressures):
            return tuple(item for fit in found.fits for item in _parameters(start, fit))
        return tuple(
            ParameterEntry(
                name, start.value(name), after, stage.std.get(name, math.nan), _relative(start.value(name), after),
                math.nan, None, True, "", None, unit_of(start, name),
            )
            for stage in found.stages
            for name, after in stage.values.items()
        )  # fmt: skip

    @cached_property
    def errors_deg(self) -> dict[str, float]:
        """Errors of the angle, over all held-out data of free joints, by what gives it, RMS [deg]."""
        return {key: error for key in COLUMNS if math.isfinite(error := pooled(self.held, key))}

    @property
    def coverage95(self) -> tuple[float, float]:
        """Mean coverage of the 95 % interval on held-out parts, and with own values; NaN where there is none."""
        return pooled_coverage(self.held), pooled_coverage(self.held, "own")

    @cached_property
    def correlations(self) -> tuple[tuple[str, str, float], ...]:
        """Pairs of strongly correlated parameters, the strongest of each fit first."""
        return tuple(pair for fit in self.found.fits for pair in _correlations(fit))

    @cached_property
    def between(self) -> tuple[Difference, ...]:
        """How the recordings deviate from each other; empty where they may not."""
        out = [item for fit in self.found.fits for item in _differences(fit)]
        return tuple(sorted(out, key=lambda item: -item.largest / max(item.std, 1e-12)))

    def to_json(self) -> dict[str, Any]:
        """The content of ``report.json``."""
        found = self.found
        coverage, of_own = self.coverage95
        common = {
            "held_out": [entry(held) for held in self.held],
            "coverage95": coverage,
            "coverage95_own": of_own,
            "errors_deg": self.errors_deg,
            "parameters": [item._asdict() for item in self.parameters],
            "correlations": [{"first": a, "second": b, "correlation": value} for a, b, value in self.correlations],
            "between": {"differences": [item._asdict() for item in self.between]} if self.between else None,
            "noise": {"declared": _noise(found.start), "found": _noise(found.rig)},
            "recordings": self._recordings(),
            "warnings": found.notes,
            "software": versions(),
            "assumption": assumption(found.start, identified=True),
            "rejected": self.rejected,
        }
        own = _full_json(found) if isinstance(found, FromPressures) else self._sealed_json(found)
        return with_all_keys(IDENTIFY, {**common, **own})

    def _recordings(self) -> list[dict[str, Any]]:
        whole, out = {held.name: held for held in self.held}, []
        for recording, state, name in self.recordings:
            if (held := whole.get(name)) is not None:
                report = held.whole.report
                about = picked(report.recording, "sha256", "topics", "issues") | {"name": name}
                about |= vars(JointFacts.of(state)) | picked(report, "samples", "duration_s")
                out.append(about | {"fitted_until_s": min(held.from_s, recording.duration_s)})
        return out

    def _sealed_json(self, fit: SealedIdentified) -> dict[str, Any]:
        known = {item.name: item for item in self.parameters}
        return {
            "stages": [
                {
                    "name": stage.name,
                    "values": {
                        name: {"before": one.start, "after": one.value, "std": one.std, "unit": one.unit}
                        for name, one in ((name, known[name]) for name in stage.values)
                    },
                    **picked(stage, "residual", "unit", "note"),
                }
                for stage in fit.stages
            ],
            "tuning": fit.tuning,
            "assumed": ASSUMED,
            "settings": {"rig": fit.start.name, "seed": self.seed},
        }

    def write_rigs(self, folder: Path) -> None:
        """Write the rig files into a folder that exists."""
        start, held = self.found.start, {held.name: held.from_s for held in self.held}
        when = datetime.datetime.now(datetime.timezone.utc).strftime("%Y-%m-%d %H:%M UTC")
        about = [
            f"Identified on {when} by pam_antagonist identify, from rig {start.name}, seed {self.seed}.",
            "Recordings (the part that was fitted, joint, SHA-256):",
        ]
        for recording, state, name in self.recordings:
            part = "all" if name not in held else f"first {held[name]:.1f} s" if held[name] else "held out"
            about.append(f"  {name}: {part}, {state.condition}, {recording_hash(recording)}")
        if self.rig.directions:
            about.append(
                "Standard errors are in report.json. The directions below are the combinations of errors that change "
                "the estimate most."
            )
        if self.rejected:
            lines = textwrap.wrap(do_not_use(self.rejected, self.adapts), 110)
            write_unread(self.rig, folder / "rig_rejected.yaml", [*lines, *about])
            return
        write_rig(self.rig, folder / "rig.yaml", about)
        for number, (own, (_, _, name)) in enumerate(zip(self.own, self.recordings, strict=False), 1):
            remark = f"The values of {name} alone, which deviate a little from the common ones in rig.yaml."
            with suppress(RefusedRig):  # nobody is asked to use it
                write_rig(own, folder / f"rig_{number}.yaml", [*about, remark])


def _full_json(fit: FromPressures) -> dict[str, Any]:
    """What only an identification from pressures has."""
    now, before = fit.rig.tuning("default"), fit.start.tuning("default")
    return {
        "stages": [
            picked(step, "name", "source")
            | {"values": {name: {"before": old, "after": new} for name, (old, new) in step.values.items()}}
            | picked(step, "before", "after", "note")
            for step in fit.steps
        ],
        "tuning": {
            "process": now.process,
            "process_before": before.process,
            "measurement": now.measurement,
            "measurement_before": before.measurement,
            "unknown_torque_nm": fit.covered.torque,
            "directions": fit.rig.directions,
        },
        "settings": {"rig": fit.start.name, **picked(fit.options, "free", "frozen", "holdout", "starts", "seed")},
    }


def _relative(start: float, value: float) -> float:
    return (value - start) / abs(start) if start else math.nan


def _parameters(rig: Rig, fit: Fit) -> list[ParameterEntry]:
    stds, reasons, out = fit.stds, fit.reasons, []
    for item, amount in zip(fit.unknowns, fit.amounts, strict=True):
        value = item.value(float(amount))
        if not item.recording:
            reason = reasons[item.name]
            at_bound = item.name in fit.at_bounds and item.name not in fit.kept and not item.is_none(float(amount))
            out.append(
                ParameterEntry(
                    item.name, item.start, value, stds[item.name], _relative(item.start, value),
                    item.prior_std, value if at_bound else None, not reason, reason,
                    recording_that_shows(item.name) if reason else None, unit_of_unknown(rig, item),
                )
            )  # fmt: skip
    return out


def unit_of_unknown(rig: Rig, item: Unknown) -> str:
    """SI unit of an unknown."""
    path = next(iter((*item.paths, *item.adds)), "")
    return unit_of(rig, path) if path else _UNITS.get(item.name, "N m")


def recording_that_shows(name: str) -> str:
    """What to record so that a value shows."""
    return next((text for part, text in _WHAT_SHOWS if part in name), "a longer recording with larger steps")


def _correlations(fit: Fit) -> list[tuple[str, str, float]]:
    common = [k for k, item in enumerate(fit.unknowns) if not item.recording]
    stds = np.sqrt(np.diag(fit.covariance))
    matrix = fit.covariance / np.outer(stds, stds)
    pairs = [(float(matrix[i, j]), i, j) for i in common for j in common if j < i]
    strong = sorted((pair for pair in pairs if abs(pair[0]) >= STRONG), key=lambda pair: -abs(pair[0]))
    return [(fit.unknowns[j].name, fit.unknowns[i].name, value) for value, i, j in strong[:_PAIRS]]


def _differences(fit: Fit) -> list[Difference]:
    out, ways = [], dict[str, list[int]]()
    for k, item in enumerate(fit.unknowns):
        if item.recording:
            ways.setdefault(item.name.removeprefix(f"{item.recording}: "), []).append(k)
    for name, places in ways.items():
        values = np.array([fit.unknowns[k].value(float(fit.amounts[k])) for k in places])
        low, high = places[int(np.argmin(values))], places[int(np.argmax(values))]
        pick = np.zeros(len(fit.unknowns))
        pick[low] -= fit.unknowns[low].std
        pick[high] += fit.unknowns[high].std
        std, largest = math.sqrt(float(pick @ fit.covariance @ pick)), float(np.ptp(values))
        out.append(Difference(name, tuple(values.tolist()), largest, std, largest > _CERTAIN * std))
    return out


def _noise(rig: Rig) -> dict[str, float]:
    return picked(rig.sensors, "pressure_std", "angle_std", "angle_step", "torque_std", "torque_step")
