"""The recurrent network of ``peers`` on the arm's episodes, where torch is installed."""

from __future__ import annotations

import numpy as np

from pam_antagonist.diagnosis.episodes import Row
from pam_antagonist.inference.bootstrap import Interval, rmse
from pam_antagonist.inference.pressure_driven import PressureDriven
from validation.peers.joints import Course
from validation.peers.soft_sensors import recurrent

NUMBERS = 39041
EARLIER = (2.32, 2.2)
"""Errors [deg] on later and interleaved episodes of an earlier run, shown where torch is not installed."""


def row(pool: PressureDriven, later: PressureDriven, between: PressureDriven) -> Row:
    """Errors of the network: all pressures and the first angle in, the angle out."""
    found = recurrent([_course(pool)], [_course(later), _course(between)])
    errors: list[Interval] = []
    for one, said in zip((later, between), found.angle, strict=True):
        errors.append(rmse(*one.squares((one.angle - said)[:, None])))
    return Row("recurrent network, GRU, 2 × 64", errors[0], None, errors[1])


def _course(joint: PressureDriven) -> Course:
    begin = np.repeat(joint.first[:-1], np.diff(joint.first))
    inputs = np.column_stack([joint.pressure, joint.signals]) / 1e5
    return Course(inputs, joint.angle, np.ones(len(begin), bool), begin, float(np.median(np.diff(joint.time[:100]))))
