"""What each hypothesis would change in the innovations of a running filter, to first order and sample by sample.

Beside the filter's estimate x runs, for each hypothesis h of a small size, its deviation δ: with the same gain K, the
model f_h of the hypothesis would predict f_h(x + δ), while the filter predicts f_0(x). With z what the sensors would
show differently,

    g = H (f_h(x + δ) − f_0(x)) + z,    δ⁺ = f_h(x + δ) − f_0(x) − K g,

and g is the mean of the filter's innovation if h is true. A state of h that is a muscle's pressure is corrected as
that is. The filter's posterior gives all that is needed: K = P Hᵀ R⁻¹,
S⁻¹ ν = R⁻¹ (y − H x⁺) and S⁻¹ = R⁻¹ − R⁻¹ H P Hᵀ R⁻¹, for pressures and a measured angle alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pam_antagonist._jit import in_place
from pam_antagonist.estimation.estimator import considered
from pam_antagonist.inference.free_parameters import base_directions
from pam_antagonist.model import dynamics, integration
from pam_antagonist.model import parameters as par
from pam_antagonist.model.dynamics import ANGLE, PRESSURE_1
from pam_antagonist.model.effects import CATALOGUE, parameter_path
from pam_antagonist.model.parameters import STATES
from pam_antagonist.rig import Rig
from pam_antagonist.rig.physical import varied
from pam_antagonist.rig.schema import ENCODER_ZERO

READINGS = 3
"""Both pressures and the angle."""
_step, _behind, _reading = integration.rk4_step_within, dynamics.pressure_behind, dynamics.reading


class HypothesisResponses(NamedTuple):
    """Hypotheses beside a filter of n states, H of them, and what they have gathered in a block."""

    sets: np.ndarray  # parameters of each hypothesis (H, SIZE)
    air: np.ndarray  # index of the pressure that each state beside these is measured with, −1 for none (H, most states)
    common: np.ndarray  # index of each of the filter's states in the hypothesis's state (H, n)
    zero: np.ndarray  # what the encoder reads too high in it (H,) [rad]
    states: np.ndarray  # whole state of its model (H, most states)
    apart: np.ndarray  # δ (H, n)
    moved: np.ndarray  # f_h(x + δ) − f_0(x) (H, n)
    shown: np.ndarray  # g (H, READINGS)
    weighed: np.ndarray  # S⁻¹ g (H, READINGS)
    score: np.ndarray  # Σ gᵀ S⁻¹ ν (H,)
    information: np.ndarray  # Σ gᵀ S⁻¹ g (H, H)
    plain: np.ndarray  # f_0(x) (n,)
    stages: np.ndarray  # of a Runge-Kutta step (STAGES + 1, most states)


@in_place
def _advance(x, u, p, h, steps, stages):
    """Steps of the model, in place. `h`: length of each [s]."""
    for _ in range(steps):
        _step(x, u, p, h, x, stages)


@in_place
def respond(  # noqa: C901
    before, after, covariance, u, y, variance, used, p, dt, steps, work
):
    """One sample: what each hypothesis predicts for it, added to the block's score and information.

    `before`, `after`: the filter's estimates after the last sample and after this one (n,). `covariance`: after this
    one (n, n). `u`: voltages since the last (2,). `y`, `variance`, `used`: readings, their variances R, and whether the
    filter used them (READINGS,). `p`: the filter's parameters. `dt`: time since the last sample [s], in `steps` steps
    of the model.
    """
    n, hypotheses = before.shape[0], work.sets.shape[0]
    h = dt / steps
    plain, moved, apart, shown = work.plain, work.moved, work.apart, work.shown
    for i in range(n):
        plain[i] = before[i]
    _advance(plain, u, p, h, steps, work.stages)
    for k in range(hypotheses):
        q = work.sets[k]
        states = work.states[k, : int(q[STATES])]
        for i in range(n):
            states[work.common[k, i]] = before[i] + apart[k, i]
        _advance(states, u, q, h, steps, work.stages)
        for i in range(n):
            moved[k, i] = states[work.common[k, i]] - plain[i]
        shown[k, 2] = moved[k, ANGLE] + work.zero[k]
        for i in range(2):
            shown[k, i] = (
                moved[k, PRESSURE_1 + i] + _reading(i, plain[PRESSURE_1 + i], q) - _reading(i, plain[PRESSURE_1 + i], p)
            )
        for a in range(READINGS):
            if not used[a]:
                shown[k, a] = 0.0
    places = (PRESSURE_1, PRESSURE_1 + 1, ANGLE)
    for k in range(hypotheses):
        for a in range(READINGS):
            if used[a]:
                left = (_behind(a, y[a], p) if a < 2 else y[a]) - after[places[a]]
                work.score[k] += shown[k, a] * left / variance[a]
        for i in range(n):
            total = moved[k, i]
            for a in range(READINGS):
                if used[a]:
                    total -= covariance[i, places[a]] / variance[a] * shown[k, a]
            apart[k, i] = total
        for i in range(int(work.sets[k, STATES])):
            if work.air[k, i] >= 0:
                work.states[k, i] += after[work.air[k, i]] - plain[work.air[k, i]]
        for a in range(READINGS):
            total = 0.0
            if used[a]:
                total = shown[k, a]
                for b in range(READINGS):
                    if used[b]:
                        total -= covariance[places[a], places[b]] / variance[b] * shown[k, b]
            work.weighed[k, a] = total / variance[a]
        for j in range(k + 1):
            for a in range(READINGS):
                work.information[k, j] += shown[j, a] * work.weighed[k, a]
            work.information[j, k] = work.information[k, j]


SHARE = 0.1
"""Size of a hypothesis, in typical sizes: small enough for a first-order response."""
_ZERO = 5e-4
"""[rad] Likewise of the encoder's zero."""
_LARGEST_ZERO = 0.35
_KNOWN_TO = 0.01
"""Relative standard deviation of a parameter for which the rig file gives none."""
_CONVERTER = 1e-3
"""[V] Standard deviation of what a valve gets beside its command, in its mean over a sample."""
_CHAMBERS = {
    state.name for effect in CATALOGUE.values() if "chamber_pressure" in effect.hooks for state in effect.states
}
"""States that are the pressure in a muscle."""


@dataclass(frozen=True)
class Watched:
    """A hypothesis: a size of an effect, or the encoder's zero."""

    name: str  # of the effect, or ENCODER_ZERO
    muscle: int | None
    parameter: str
    unit: str
    step: float  # size that is carried along
    low: float  # least size
    high: float
    paths: tuple[str, ...] = ()  # dotted, of the parameters that have this size

    @property
    def label(self) -> str:
        """Effect, parameter and muscle, in words."""
        where = f" {self.muscle}" if self.muscle else ""
        return f"{self.name.replace('_', ' ')}{where}, {self.parameter.replace('_', ' ')}"


def hypotheses(rig: Rig, encoder: bool) -> list[Watched]:
    """What a joint may come to have beside its rig file."""
    found = []
    for effect in CATALOGUE.values():
        if {"valve": "valve", "regulator": "command"}[rig.drive] not in effect.tested_with:
            continue
        if effect.of_tables or not effect.deterministic:
            continue
        for item in effect.parameters:
            tied = effect.form.tied and item.muscle is not None
            left_out = not {item.name, item.family}.isdisjoint(effect.form.without)
            if not item.is_size or item.fixed or left_out or (tied and item.muscle == 2):
                continue
            names = [f"{item.family}_{i}" for i in (1, 2)] if tied else [item.name]
            paths = tuple(parameter_path(effect.name, name) for name in names)
            present = rig.value(paths[0])
            found.append(
                Watched(
                    effect.name, None if tied else item.muscle, item.family, item.unit, SHARE * item.scale,
                    item.low - present, item.high - present, paths,
                )
            )  # fmt: skip
    zero = Watched(ENCODER_ZERO, None, "angle", "rad", _ZERO, -_LARGEST_ZERO, _LARGEST_ZERO)
    return [*found, zero] if encoder else found


def uncertain(rig: Rig) -> list[dict[str, float]]:
    """Changes of one standard deviation in which a joint may differ from its rig file from the start."""
    declared = considered(rig)
    if rig.drive == "valve":
        declared += [{parameter_path("valve_offset", f"voltage_{i}"): _CONVERTER} for i in (1, 2)]
    names = {name for step in declared for name in step}
    others = [each for each in base_directions(rig) if names.isdisjoint(each.adds)]
    return declared + [
        {name: change * (_KNOWN_TO if each.shown_in == "%" else each.std) for name, change in each.adds.items()}
        for each in others
    ]


def make_responses(rig: Rig, p: np.ndarray, watched: list[Watched], longest: float) -> HypothesisResponses:
    """Responses of the hypotheses, then of what is uncertain. `p`: parameters; `longest`: step of the model [s]."""
    sets = [_with_size(p, item, longest) for item in watched]
    sets += [
        par.changed(p, {name: varied(name, float(p[par.INDEX[name]]), std) for name, std in step.items()})
        for step in uncertain(rig)
    ]
    n, most, count = int(p[STATES]), int(max(q[STATES] for q in sets)), len(sets)
    common, air, own = np.zeros((count, n), dtype=np.int64), np.full((count, most), -1), par.added_states(p)
    for k, q in enumerate(sets):
        names = par.added_states(q)
        common[k] = [*range(par.BASE_STATES), *(par.BASE_STATES + names.index(name) for name in own)]
        for i, name in enumerate(names):
            if name in _CHAMBERS and name not in own:
                air[k, par.BASE_STATES + i] = PRESSURE_1 + int(name[-1]) - 1
    zero = np.array([item.step if not item.paths else 0.0 for item in watched])
    return HypothesisResponses(
        np.array(sets), air, common, np.append(zero, np.zeros(count - len(watched))), np.zeros((count, most)),
        np.zeros((count, n)), np.zeros((count, n)), np.zeros((count, READINGS)), np.zeros((count, READINGS)),
        np.zeros(count), np.zeros((count, count)), np.zeros(n), np.zeros((integration.STAGES + 1, most)),
    )  # fmt: skip


def _with_size(p: np.ndarray, item: Watched, longest: float) -> np.ndarray:
    """Parameters with the size of a hypothesis, and with time constants that steps of the model can follow."""
    changes = {path: float(p[par.INDEX[path]]) + item.step for path in item.paths}
    for each in CATALOGUE[item.name].parameters if item.paths else ():
        if each.unit == "s" and not each.is_size:
            path = parameter_path(item.name, each.name)
            changes[path] = max(float(p[par.INDEX[path]]), longest)
    return par.changed(p, changes)
