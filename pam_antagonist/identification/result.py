"""What an identification found, and its errors on data that no step saw."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.lib.recfunctions import repack_fields
from numpy.typing import NDArray

from pam_antagonist.identification import joint_stage
from pam_antagonist.identification.filter_stage import Given, UnknownTorque
from pam_antagonist.identification.parts import held_runs, is_free
from pam_antagonist.identification.runs import SWINGS, Run
from pam_antagonist.inference.fit import Fit
from pam_antagonist.inference.pressure_driven import NO_REGULATORS
from pam_antagonist.model import parameters as par
from pam_antagonist.replays import Replay, after, replay
from pam_antagonist.replays.result import ReplayReport
from pam_antagonist.rig import Rig
from pam_antagonist.rig.file import refusal

Floats = NDArray[np.float64]

_ADAPTED = 0.9
"""The filter's error has to fall to this share for a rig to be adapted, on held-out data and on all: less may be
chance, and the end of a recording does not show how a joint begins to move."""
_KNOWN_RIG = 1.2
"""The filter's error may be larger by this factor than with a rig that was identified before."""


class Options(NamedTuple):
    """What the user chose."""

    free: tuple[str, ...] = ()  # names, or beginnings of names, of parameters that may move beside the usual ones
    frozen: tuple[str, ...] = ()  # names, or beginnings of names, of parameters that may not move
    holdout: float = 1.0 / 3.0
    starts: int = 2
    seed: int = 0
    adapts: bool = False  # whether a rig that was identified before follows its joint


AS_USUAL = Options()


class Step(NamedTuple):
    """A step of the identification."""

    name: str
    source: str
    values: Mapping[str, tuple[float, float]]
    before: Mapping[str, float]  # RMS errors before it, by channel [rad, N m, Pa]
    after: Mapping[str, float]
    note: str = ""


_AGAINST = -0.5
"""Largest correlation of an estimated angle that goes against the measured one."""
_EXPLAINED = 0.8
"""Largest error of the modelled pressures, as a share of the error if nothing flows. With exchanged commands it is 0.97
or more on three simulated joints, with the right ones 0.06 or less there."""


@dataclass(frozen=True, eq=False)
class HeldRecording:
    """Held-out data of one recording."""

    name: str
    from_s: float  # begin of the held-out part [s]
    # the recording, replayed with the identified rig, and as configured with angle and torque only.
    replays: Mapping[str, Replay]
    # errors of the held-out part: ``as_configured``, ``identified``, and ``own`` with the recording's own deviations
    # where recordings may deviate.
    reports: Mapping[str, ReplayReport]
    # error of the angle where the measured pressures drive the joint, RMS [deg]; NaN where locked.
    pressures_alone: float
    linear: float  # error of a linear map of the two pressures, fitted to the same data, RMS [deg]; NaN likewise
    rows: int
    number: int = 0  # of the recording, in the order in which they were given

    @property
    def whole(self) -> Replay:
        """The recording, replayed with the identified rig."""
        return self.replays["identified"]

    @property
    def identified(self) -> ReplayReport:
        """Errors of the held-out part with the identified rig."""
        return self.reports["identified"]

    @property
    def as_configured(self) -> ReplayReport:
        """Errors of the held-out part with the rig file."""
        return self.reports["as_configured"]

    def error(self, column: str) -> float:
        """Error of a free joint's angle, RMS [deg]; NaN without any.

        `column`: ``identified``, ``as_configured``, ``own``, ``model_alone``, ``pressures_alone`` or ``linear``.
        """
        if self.rows == 0:
            return math.nan
        if column in ("pressures_alone", "linear"):
            return float(getattr(self, column))
        report = self.reports["identified" if column == "model_alone" else column]
        errors = report.model_alone.angle if column == "model_alone" else report.ukf.angle
        return math.nan if errors is None else errors.rmse

    @property
    def goes_against(self) -> bool:
        """Whether the angle estimated with the rig file falls where the measured one rises."""
        whole = self.replays.get("as_configured", self.whole)
        measured = whole.recording.angle
        if self.rows == 0 or measured is None:
            return False
        pair = np.column_stack([whole.run.rows["angle"], measured[whole.run.index]])
        pair = pair[np.isfinite(pair).all(axis=1)]
        if len(pair) < 3 or not np.ptp(pair, axis=0).all():
            return False
        return bool(np.corrcoef(pair.T)[0, 1] < _AGAINST)

    @property
    def coverage(self) -> float:
        """Share of the angles in their 95 % intervals; NaN without any."""
        errors = self.identified.ukf.angle
        share = None if errors is None or self.rows == 0 else errors.coverage95
        return math.nan if share is None else share


@dataclass(frozen=True, eq=False)
class FromPressures:
    """An identified rig and how it was found."""

    start: Rig
    rig: Rig
    own: tuple[Rig, ...]  # the rig with the deviations of each recording, where recordings may deviate
    joint: Fit
    air: Fit | None  # values of chambers and valves, or regulators, likewise; None without commands
    final: tuple[Fit, Fit | None]  # the same two from all of the data, where the rig was guessed
    covered: UnknownTorque
    held: tuple[HeldRecording, ...]
    fitted: tuple[tuple[str, float], ...]  # name of each recording, and the end of its part that was fitted [s]
    notes: tuple[str, ...]
    # errors of the pressures in a second from the commands [Pa]: of the model, and if nothing flowed.
    pressures: tuple[float, float]
    steps: tuple[Step, ...] = ()
    options: Options = AS_USUAL
    start_saw: bool = False  # whether the rig file was fitted to what is held out here
    # SHA-256 of each recording that the delivered values were fitted to, and the end of that part [s].
    saw: Mapping[str, float] = field(default_factory=dict)

    @property
    def fits(self) -> tuple[Fit, ...]:
        """The fits of both parts of the model whose values the rig file has."""
        return tuple(fit for fit in self.final if fit is not None)

    def pooled(self, column: str) -> float:
        """Error of the angle over all held-out rows, RMS [deg]; NaN without any; as :func:`pooled`."""
        return pooled(self.held, column)

    @property
    def coverage(self) -> float:
        """Share of the held-out angles in their 95 % intervals; NaN without any."""
        known = [(item.coverage, item.rows) for item in self.held if math.isfinite(item.coverage)]
        total = sum(rows for _, rows in known)
        return sum(rows * share for share, rows in known) / total if total else math.nan

    @property
    def rejected(self) -> str:
        """Why the rig should not be used, in a sentence; empty if it may."""
        now, before = self.pooled("identified"), self.pooled("as_configured")
        if any(item.rows for item in self.held) and not math.isfinite(now):
            return "the filter gives no angle on the held-out data with it."
        if self.options.adapts:
            over_all = self._over_all("identified"), self._over_all("as_configured")
            for after, without, where in ((now, before, "held-out data"), (*over_all, "whole recording")):
                if math.isfinite(without) and not after <= _ADAPTED * without:
                    said = f"the filter errs by {after:.3g}° with today's values and by {without:.3g}° without"
                    return f"on the {where} {said}."
            return ""
        known = self.start.identified or not self.start.is_from_data_sheets
        if not self.start_saw and now > before * (_KNOWN_RIG if known else 1.0):
            what = f"on the held-out data the filter errs by {now:.3g}° with it and by {before:.3g}° with the rig file."
            return f"{what} {self._cause(now)}"
        if now > self.pooled("linear"):
            return f"on the held-out data the filter errs by {now:.3g}°. {self._cause(now)}"
        if said := refusal(self.rig):
            what = f"the values that fit best are impossible ({said})"
            return f"{what}. The recordings do not fit two muscles on one joint."
        model, rest = self.pressures
        if model > _EXPLAINED * rest:
            return (
                f"the commands do not explain the pressures: within a second the model errs by {model / 1e3:.3g} kPa, "
                f"and by {rest / 1e3:.3g} kPa if nothing flows. The commands are exchanged, or of another joint: run "
                "check."
            )
        return ""

    def _over_all(self, name: str) -> float:
        """Error of the angle over whole recordings with a rig, ``identified`` or ``as_configured``, RMS [deg]."""
        angles = [held.replays[name].report.ukf.angle for held in self.held]
        known = [one.rmse for one in angles if one is not None]
        return float(np.sqrt(np.mean(np.square(known)))) if known else math.nan

    def _cause(self, now: float) -> str:
        """What the recordings themselves show of the cause of an error [deg], in sentences."""
        seen = []
        if now > (linear := self.pooled("linear")):
            seen.append(
                f"A linear map of the two pressures errs by {linear:.3g}°: the recordings do not fit two muscles on "
                "one joint, the joint moved too little, or it hit a stop that the rig file does not have."
            )
        if against := [item.name for item in self.held if item.goes_against]:
            seen.append(
                f"In {', '.join(against)} the estimated angle goes against the measured one: channels are exchanged, "
                "or the encoder counts the other way: run check."
            )
        if any(SWINGS in note for note in self.notes):
            seen.append("Their pressures were read too rarely.")
        return " ".join(seen) or (
            "The held-out part is unlike the fitted one, or the model lacks something, which close_loop looks for."
        )


def pooled(every: Sequence[HeldRecording], column: str) -> float:
    """Error of the angle over all held-out rows, RMS [deg]; NaN without any. `column`: as for :meth:`Held.error`."""
    known = [(item.error(column), item.rows) for item in every if math.isfinite(item.error(column))]
    total = sum(rows for _, rows in known)
    return math.sqrt(sum(rows * error**2 for error, rows in known) / total) if total else math.nan


def linear_map(runs: Sequence[Run]) -> Floats | None:
    """Coefficients of a linear map from the two pressures [Pa] to the angle [rad] (3,); None without any angle."""
    free = [run for run in runs if run.moves]
    if not free:
        return None
    pressure, angle = np.concatenate([run.pressure for run in free]), np.concatenate([run.angle for run in free])
    known = np.isfinite(angle)
    found, *_ = np.linalg.lstsq(np.column_stack([pressure, np.ones(len(angle))])[known], angle[known], rcond=None)
    return np.asarray(found)


def held_of(given: Given, before: Given, end: float, rigs: Mapping[str, Rig], line: Floats | None) -> HeldRecording:
    """Errors of a recording's held-out part.

    `end`: of the part that was fitted [s]. `line`: coefficients of the linear map (3,); None without any.
    """
    recording, state, name = given
    begin, replays, reports = max(end, 0.0), {}, {}
    lock_angle = state.lock_angle if state.condition == "locked" else None
    for key, rig in rigs.items():
        one = before[0] if key == "as_configured" else recording
        whole = replay(one, rig, "default", state.condition, lock_angle)
        reports[key] = whole.report if begin == 0.0 else after(whole, begin).report
        replays[key] = whole if key == "identified" else _lean(whole)
    alone = mapped = math.nan
    rows = 0
    if is_free(given) and recording.angle is not None and line is not None:
        parts = held_runs(given, begin)
        p = par.changed(rigs["identified"].parameters(), NO_REGULATORS)
        alone = _rms_deg([joint_stage.simulated(run, p, 0.0, 0.0) - run.angle for run in parts])
        mapped = _rms_deg([np.column_stack([run.pressure, np.ones(len(run))]) @ line - run.angle for run in parts])
        rows = int(np.isfinite(recording.angle[recording.time_s >= begin]).sum())
    return HeldRecording(name, begin, replays, reports, alone, mapped, rows)


def _lean(item: Replay) -> Replay:
    """A copy of a replay that keeps only angle and torque of the estimates."""
    rows = repack_fields(item.run.rows[["angle", "torque"]])
    return replace(item, run=replace(item.run, rows=rows, added={}))


def _rms_deg(errors: Sequence[Floats]) -> float:
    values = np.concatenate([np.zeros(0), *errors])
    known = values[np.isfinite(values)]
    return math.degrees(math.sqrt(float(np.mean(known**2)))) if len(known) else math.nan
