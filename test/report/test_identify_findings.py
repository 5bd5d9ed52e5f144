"""What the report of an identification says of a rig that became worse."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from pam_antagonist.estimation.errors import ChannelErrors
from pam_antagonist.report import identify_findings
from pam_antagonist.report.held_out import HeldOut


def held_out(before: float, now: float) -> Any:
    """A held-out part whose angle has these errors [°]."""

    def figures(rmse: float) -> SimpleNamespace:
        errors = ChannelErrors("deg", rmse, 2.0 * rmse, 0.1, 0.95)
        return SimpleNamespace(ukf=SimpleNamespace(angle=errors, torque=None))

    joint = SimpleNamespace(condition="free")
    return HeldOut("lab/free", 20.0, joint, figures(before), figures(now), None)  # type: ignore[arg-type]


@pytest.mark.parametrize(("before", "now", "said"), [(0.15, 0.43, 1), (0.15, 0.16, 0), (0.15, 0.05, 0)])
def test_a_rig_that_became_worse_is_a_warning(before: float, now: float, said: int) -> None:
    found = identify_findings._worse(held_out(before, now))
    assert len(found) == said
    report: Any = SimpleNamespace(held_out=(held_out(before, now),))
    assert identify_findings.lacks_an_effect(report) == bool(said)
    for item in found:
        assert item.status == "warn" and "0.43°" in item.text and "close_loop" in item.text
