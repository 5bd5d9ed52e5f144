"""What the user is told beside the verdict."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from pam_antagonist.diagnosis import warnings
from pam_antagonist.diagnosis.ambiguity import distinguishing_experiments
from pam_antagonist.diagnosis.models import Model
from pam_antagonist.estimation.errors import ChannelErrors
from pam_antagonist.inference.free_parameters import FreeEffectParameter
from pam_antagonist.inference.point import Point
from pam_antagonist.model.effects import CATALOGUE


def test_an_experiment_that_tells_is_named() -> None:
    said = distinguishing_experiments(("leak",), ("valve_offset",), {"free"})
    assert "close the valves" in said["valve_offset"]
    assert "locked" in said["valve_offset"]


@dataclass
class Ended:
    point: Point
    free: tuple[FreeEffectParameter, ...]


@dataclass
class Recorded:
    trial: SimpleNamespace


def test_a_number_that_ends_at_its_bound_is_named() -> None:
    items = {item.name: item for item in CATALOGUE["creep"].parameters}
    values = {"time": items["time"].high, "share_1": items["share_1"].low, "share_2": 0.0, "stiffness": 700.0}
    free = tuple(FreeEffectParameter((f"effects.creep.{name}",), items[name]) for name in values)
    point = Point(np.zeros(0), {f"effects.creep.{name}": value for name, value in values.items()})
    recorded = Recorded(SimpleNamespace(name="free"))
    size, time = sorted(warnings.at_bounds(Model((recorded,), (Ended(point, free),), ("creep",))))
    assert size.startswith("creep.share_1 ends at its bound") and "in free" in size
    assert time.startswith(f"creep.time ends at its bound, {values['time']:g} s") and "how much further" in time


def test_a_small_leak_is_not_at_its_bound() -> None:
    area = next(item for item in CATALOGUE["leak"].parameters if item.name == "area_1")
    point = Point(np.zeros(0), {"effects.leak.area_1": 1e-9})
    free = (FreeEffectParameter(("effects.leak.area_1",), area),)
    recorded = Recorded(SimpleNamespace(name="free"))
    assert warnings.at_bounds(Model((recorded,), (Ended(point, free),), ("leak",))) == []


def estimated(angle: float | None, torque: float) -> SimpleNamespace:
    return SimpleNamespace(
        angle=None if angle is None else ChannelErrors("deg", angle, angle, 0.1, None),
        torque=ChannelErrors("nm", torque, torque, 0.1, None),
    )


def recording(name: str, before: SimpleNamespace, after: SimpleNamespace) -> Any:
    """The entry of a recording with the estimator's errors as configured and extended."""
    return SimpleNamespace(recording=name, ukf=SimpleNamespace(as_configured=before, extended=after))


def test_an_estimator_that_got_worse_is_told_with_its_numbers() -> None:
    worse = recording("free", estimated(0.07, 0.01), estimated(0.41, 0.011))
    (said,) = warnings.estimator_worse([worse])
    assert "0.41°" in said and "0.07°" in said and "free" in said
    locked = recording("held", estimated(None, 0.02), estimated(None, 0.05))
    assert "torque 0.05 N m" in warnings.estimator_worse([locked])[0]
    better = recording("free", estimated(0.4, 0.03), estimated(0.01, 0.01))
    fitted: Any = SimpleNamespace(recording="fitted", ukf=None)
    assert warnings.estimator_worse([better, fitted]) == []
