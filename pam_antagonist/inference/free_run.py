"""The model alone along a recording, from its first sample on: one model, or many at once."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.estimation.divergence import DIVERGED, diverged_from
from pam_antagonist.inference.threads import side_by_side
from pam_antagonist.inference.trial import ANGLE, PRESSURE_1, Trial
from pam_antagonist.model import dynamics, equilibrium, lanes
from pam_antagonist.model import parameters as par
from pam_antagonist.model.drive import TORQUE, Inputs

Floats = NDArray[np.float64]
_Result = TypeVar("_Result")
Course = tuple[Floats, Floats]
"""States (N, n) and torques (N,) [N m]."""

_START_S = 0.02
"""[s] At the beginning of a recording: a straight line through it tells the first sample's true values."""
_LATEST_ANGLE_S = 0.5
"""[s] An angle that begins so late tells the start as well: a node of its own, or its stamps, may be late."""
_RATE_S = 0.1
"""[s] At the beginning of a recording, in which it is told how quickly something changes."""


class Phase(NamedTuple):
    """A part of a recording in which the same effects act."""

    begin_s: float  # since the first sample [s]; it lasts until the next phase or the recording's end
    parameters: Floats  # vector (P,) of the model


class StartedModel(NamedTuple):
    """A model, and where it starts."""

    parameters: Floats  # vector (P,)
    # deviation of the true start from what the sensors showed (3,) [rad, Pa, Pa]; None for none.
    shift: Floats | None = None
    # what the model is from some times on, in their order. States that a phase adds start settled.
    later: tuple[Phase, ...] = ()

    @property
    def key(self) -> Key:
        """What tells the model from others."""
        shift = b"" if self.shift is None else self.shift.tobytes()
        return self.parameters.tobytes(), shift, tuple((one.begin_s, one.parameters.tobytes()) for one in self.later)


Key = tuple[bytes, bytes, tuple[tuple[float, bytes], ...]]
"""A model by its parameters, its start and its phases."""


@dataclass(frozen=True)
class Start:
    """What the sensors showed at the start of a recording."""

    angle: float | None  # [rad], None where it was not measured
    pressure: Floats  # of both muscles (2,) [Pa]
    share: Floats  # standard deviation of these (2,), over that of one sample
    rate: Floats  # how quickly angle and pressures change there (3,) [rad/s, Pa/s, Pa/s]


def start_of(trial: Trial) -> Start:
    """What the first samples of a recording say of its start.

    The means of these samples lie behind it: valves that fill a muscle change its pressure by much more than the noise
    in that time.
    """
    first = trial.measured[: trial.samples(_START_S)]
    pressure, share = np.transpose([_at_first(first[:, k]) for k in (PRESSURE_1, PRESSURE_1 + 1)])
    early = trial.measured[: trial.samples(_LATEST_ANGLE_S), ANGLE]
    begin = int(np.argmax(np.isfinite(early)))
    angle = trial.lock_angle if trial.joint == "locked" else _at_first(early[begin : begin + len(first)])[0]
    begun = trial.measured[: trial.samples(_RATE_S)]
    rate = np.array([_rate(begun[:, k]) / trial.dt for k in (ANGLE, PRESSURE_1, PRESSURE_1 + 1)])
    return Start(angle if np.isfinite(angle) else None, pressure, share, rate)


def _at_first(values: Floats) -> tuple[float, float]:
    """The straight line through values (N,) at the first of them, and its standard deviation over that of a value."""
    known = np.flatnonzero(np.isfinite(values))
    if len(known) < 2:
        return (float(values[known[0]]), 1.0) if len(known) else (np.nan, 1.0)
    middle, spread = known.mean(), np.sum((known - known.mean()) ** 2)
    line = np.polynomial.Polynomial.fit(known, values[known], 1)
    return float(line(0.0)), float(np.sqrt(1.0 / len(known) + middle**2 / spread))


def _rate(values: Floats) -> float:
    """Size of the slope of values (N,), a sample; 0 where there are not two."""
    known = np.flatnonzero(np.isfinite(values))
    return abs(float(np.polynomial.Polynomial.fit(known, values[known], 1).deriv()(0.0))) if len(known) > 1 else 0.0


def predict(trial: Trial, model: StartedModel, start: Start) -> Floats:
    """The model alone, from the start of a recording on.

    `start`: what the sensors showed first; the added states start settled. Returns what the sensors would show (N, 4),
    in the order of ``trial.CHANNELS``.
    """
    return predict_each(trial, [model], start, 1, lambda _, shown: shown)[0]


def predict_each(
    trial: Trial, models: Sequence[StartedModel], start: Start, jobs: int, made: Callable[[int, Floats], _Result]
) -> list[_Result]:
    """:func:`predict` of many models, side by side: a group of them in lanes takes little longer than one model.

    Of a long recording, only one group is held at a time.

    `made`: is called with the number of a model, and with what the sensors would show (N, 4).
    """
    alike: dict[tuple[float, ...], list[int]] = {}
    for k, model in enumerate(models):
        alike.setdefault(tuple(phase.begin_s for phase in model.later), []).append(k)
    groups = [
        [some[k] for k in group]
        for some in alike.values()
        for group in lanes.groups([[models[k].parameters, *(one.parameters for one in models[k].later)] for k in some])
    ]

    def together(these: Sequence[int]) -> list[_Result]:
        there = courses(trial, [models[k] for k in these], start)
        return [made(k, _shown(trial, models[k], there.pop(0))) for k in these]

    results = side_by_side(together, groups, jobs)
    found = dict(zip(itertools.chain.from_iterable(groups), itertools.chain.from_iterable(results), strict=True))
    return [found[k] for k in range(len(models))]


def _shown(trial: Trial, model: StartedModel, course: Course) -> Floats:
    """What the sensors show (N, 4) of a model's course; from where it diverges on, ``DIVERGED``."""
    states, torque = course
    shown = np.empty((len(states), 2))
    with np.errstate(over="ignore", invalid="ignore"):
        for rows, vector in _parts(trial, model):
            shown[rows] = dynamics.readings(states[rows, 2:4], vector)
    out = np.column_stack([states[:, 0], torque, shown])
    out[diverged_from(out) :] = DIVERGED
    return out


def courses(trial: Trial, models: Sequence[StartedModel], start: Start) -> list[Course]:
    """States (N, n) and torques (N,) [N m] of models whose phases begin at the same times, side by side.

    `models`: the models.
    """
    given = trial.voltage if trial.external is None else trial.given
    parts = [_parts(trial, model) for model in models]
    done: list[list[Course]] = [[] for _ in models]
    for number, (rows, _) in enumerate(parts[0]):
        vectors = [part[number][1] for part in parts]
        # The first row of a later phase's course is its start, which is the last one of the course before.
        later = min(number, 1)
        begin = rows.start - later
        if not later:
            starts = [initial_state(trial, p, start, model.shift) for p, model in zip(vectors, models, strict=True)]
        else:
            ends = zip(done, parts, vectors, strict=True)
            starts = [_taken_over(own[-1][0][-1], part[number - 1][1], p, given[begin]) for own, part, p in ends]
        along = Inputs.even(rows.stop - begin, trial.dt, trial.substeps, command=given[begin : rows.stop])
        here = along.driven_each([x[None] for x in starts], vectors, TORQUE)
        for own, (states, (torque, _)) in zip(done, here, strict=True):
            own.append((states[later:], torque[later:]))
    return [_joined(own) for own in done]


def _joined(phases: Sequence[Course]) -> Course:
    """The course through all phases."""
    if len(phases) == 1:
        return phases[0]
    end = sum(len(states) for states, _ in phases)
    out = np.zeros((end, max(states.shape[1] for states, _ in phases)))
    last = end - 1
    for states, _ in reversed(phases):
        # States that a phase does not have yet stand where the next phase begins with them.
        out[end - len(states) : end] = out[min(end, last)]
        out[end - len(states) : end, : states.shape[1]] = states
        end -= len(states)
    return out, np.concatenate([torque for _, torque in phases])


def initial_state(trial: Trial, p: Floats, start: Start, shift: Floats | None = None) -> Floats:
    """State (n,) of the model at the first sample of a recording; the added states are settled.

    `p`: parameter vector (P,). `shift`: deviation of the true start from that (3,) [rad, Pa, Pa].
    """
    moved = np.zeros(3) if shift is None else shift
    pressures = [dynamics.pressure_behind(i, start.pressure[i] + moved[1 + i], p) for i in (0, 1)]
    angle = equilibrium.rest_angle(pressures[0], pressures[1], p) if start.angle is None else start.angle + moved[0]
    given = trial.voltage if trial.external is None else trial.given
    return np.asarray(equilibrium.initial_state(angle, pressures[0], pressures[1], given[0], p))


def _parts(trial: Trial, model: StartedModel) -> list[tuple[slice, Floats]]:
    """The samples of each phase, with its parameter vector (P,); a phase has one sample at least."""
    first = [0, *(round(phase.begin_s / trial.dt) for phase in model.later), len(trial)]
    rows = [slice(begin, min(end, len(trial))) for begin, end in zip(first[:-1], first[1:], strict=True)]
    vectors = [model.parameters, *(phase.parameters for phase in model.later)]
    return [(part, vector) for part, vector in zip(rows, vectors, strict=True) if part.start < part.stop]


def _taken_over(x: Floats, before: Floats, after: Floats, given: Floats) -> Floats:
    """A state of one model as a state of another one: what that has besides is settled.

    Args:
        x: state (n,).
        before: parameter vector (P,) of the model that it is of.
        given: input (2,) or (3,).
    """
    out = np.asarray(equilibrium.initial_state(x[0], x[2], x[3], given, after))
    out[:4] = x[:4]
    for slot in par.SLOT_OF.values():
        if before[slot] > 0.0 and after[slot] > 0.0:
            out[int(after[slot])] = x[int(before[slot])]
    return out


# A recording as a model in longer steps sees it, and what such a model says in blocks.


def in_steps(trial: Trial, longest: float) -> Trial:
    """A recording as a model in longer steps sees it: every so many-th sample, and the means of the inputs between.

    `longest`: step [s]; whole blocks have a whole number of them.
    """
    most = max(1, round(longest / trial.dt))
    stride = max(count for count in range(1, most + 1) if trial.block % count == 0)
    if stride == 1:
        return replace(trial, longest_step=longest)
    steps = (len(trial) - 1) // stride

    def means(values: Floats) -> Floats:
        # Row k holds over the step that ends at sample k.
        cut = values[1 : 1 + steps * stride]
        return np.concatenate([values[:1], np.add.reduceat(cut, np.arange(0, len(cut), stride)) / stride])

    external = None if trial.external is None else means(np.nan_to_num(trial.external))
    measured = trial.measured[: 1 + steps * stride : stride]
    voltage = means(trial.voltage)
    return replace(
        trial, dt=stride * trial.dt, voltage=voltage, measured=measured, external=external, longest_step=longest
    )


def stride_blocks(values: Floats, stride: int, count: int, size: int) -> Floats:
    """What :func:`~pam_antagonist.inference.trial.blocks` gives of the samples between as well, (count, C).

    `values`: every stride-th sample (N, C).
    """
    steps = size // stride
    missing = max(count * steps + 1 - len(values), 0)
    values = np.concatenate([values, np.repeat(values[-1:], missing, axis=0)])
    means = np.add.reduceat(values[: count * steps], np.arange(0, count * steps, steps)) / steps
    if stride == 1:
        return np.asarray(means)
    ends = values[: count * steps + 1 : steps]
    # A block's samples lie half a sample before the middle of its ends, the means half a stride.
    return np.asarray(means + (0.5 - 0.5 / stride) / steps * np.diff(ends, axis=0))
