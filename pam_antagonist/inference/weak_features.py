"""What weak laws go with: pressures and further signals, their products, and what of them fades.

All of them are known before a simulation. So a rig's weak laws are further inputs of its model: a coefficient at each
row of a recording, for each way in which torque and friction go with angle and velocity.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.estimation.further import FADING, OWN, FurtherInputs, fading
from pam_antagonist.model.effects.base import COEFFICIENTS, SIGNALS
from pam_antagonist.rig import Rig
from pam_antagonist.rig.schema import WeakLaws

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

LASTING = FADING[1:]
"""[s] The longer ones of them, which come with angles and with other inputs."""


def features(inputs: Mapping[str, Floats], first: Indices, time: Floats) -> dict[str, Floats]:
    """Every feature at the rows (N,), by name.

    `inputs`: by name (N,) [-]. `first`: index of the first row of each episode, then the number of rows (E + 1,).
    """
    out = {"constant": np.ones(len(time)), **inputs}
    out |= {f"{a}*{b}": inputs[a] * inputs[b] for a, b in itertools.combinations_with_replacement(inputs, 2)}
    out |= {f"{name}^3": inputs[name] ** 3 for name in OWN}
    columns = np.column_stack(list(inputs.values()))
    for constant in FADING:
        late = columns - _held(columns, first, time, constant)
        out |= {fading(name, constant): column for name, column in zip(inputs, late.T, strict=True)}
    for name, constant, other in itertools.product(inputs, LASTING, inputs):
        late_name = fading(name, constant)
        out[f"{late_name}*{other}"] = out[late_name] * inputs[other]
    return out


def _held(columns: Floats, first: Indices, time: Floats, constant: float) -> Floats:
    """Columns (N, I) through a low-pass with a time constant [s]; each episode begins after a long rest."""
    out, begin, count = columns.copy(), first[:-1], np.diff(first)
    for k in range(1, int(count.max(initial=0))):
        rows = begin[count > k] + k
        stays = np.exp(-(time[rows] - time[rows - 1]) / constant)[:, None]
        out[rows] = stays * out[rows - 1] + (1.0 - stays) * 0.5 * (columns[rows] + columns[rows - 1])
    return out


def inputs_of(laws: WeakLaws, pressure: Floats, signals: Floats, names: Sequence[str]) -> dict[str, Floats]:
    """What the features are made of: pressures and further signals less their middle, in units of their range."""
    columns = dict(zip((*OWN, *names), np.column_stack([pressure, signals[:, : len(names)]]).T, strict=True))
    return {name: (columns[name] - middle) / laws.range[name] for name, middle in laws.middle.items()}


def coefficients(rig: Rig, pressure: Floats, signals: Floats, first: Indices, time: Floats) -> Floats:
    """Coefficients of a rig's weak laws at the rows of a recording (N, 15) [N m]; 0 without any.

    Args:
        rig: with its numbers.
        pressure: (N, 2) [Pa].
        signals: those of the rig file, less their values there (N, S) [SI].
        first: index of the first row of each episode, then the number of rows (E + 1,).
        time: of the rows (N,) [s].

    Raises:
        BadInput: numbers of a place, an input or a feature that there is not.
    """
    if rig.weak_laws is None:
        return np.zeros((len(time), COEFFICIENTS))
    inputs, parts = FurtherInputs(rig), []
    absolute = signals[:, : len(rig.signals)] + np.array(list(rig.signals.values()))
    for begin, end in zip(first[:-1], first[1:], strict=True):
        inputs.reset()
        rows = slice(begin, end)
        parts.append(inputs.follow(np.rint(1e9 * time[rows]).astype(np.int64), pressure[rows], absolute[rows]))
    return np.concatenate([np.zeros((0, SIGNALS + COEFFICIENTS)), *parts])[:, SIGNALS:]


def beside_signals(signals: Floats, driven: Floats) -> Floats:
    """Columns of the model's further inputs (N, 4 + 15): signals, and coefficients of weak laws."""
    out = np.zeros((len(driven), SIGNALS + COEFFICIENTS))
    out[:, : signals.shape[1]], out[:, SIGNALS:] = signals[:, :SIGNALS], driven
    return out
