"""A recording as a model in longer steps sees it, and what such a model says in blocks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.inference.trial import Trial

Floats = NDArray[np.float64]


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
