"""What the user is told beside the verdict."""

from __future__ import annotations

from pam_antagonist.diagnosis import warnings
from pam_antagonist.diagnosis.ambiguity import distinguishing_experiments


def test_an_experiment_that_tells_is_named() -> None:
    said = distinguishing_experiments(("leak",), ("valve_offset",), {"free"})
    assert "close the valves" in said["valve_offset"]
    assert "locked" in said["valve_offset"]


def estimated(angle: float | None, torque: float) -> dict[str, object]:
    return {"angle": None if angle is None else {"rmse_deg": angle}, "torque": {"rmse_nm": torque}}


def test_an_estimator_that_got_worse_is_told_with_its_numbers() -> None:
    worse = {"recording": "free", "ukf": {"as_configured": estimated(0.07, 0.01), "extended": estimated(0.41, 0.011)}}
    (said,) = warnings.estimator_worse([worse])
    assert "0.41°" in said and "0.07°" in said and "free" in said
    locked = {"recording": "held", "ukf": {"as_configured": estimated(None, 0.02), "extended": estimated(None, 0.05)}}
    assert "torque 0.05 N m" in warnings.estimator_worse([locked])[0]
    better = {"recording": "free", "ukf": {"as_configured": estimated(0.4, 0.03), "extended": estimated(0.01, 0.01)}}
    assert warnings.estimator_worse([better, {"recording": "fitted", "errors": None}]) == []
