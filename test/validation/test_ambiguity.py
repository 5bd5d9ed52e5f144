"""Laws that look alike: a law imitates itself, another one as far as the sensors allow."""

from __future__ import annotations

import pytest

from validation import ambiguity


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(ambiguity, "_SECONDS", 4.0)
    ambiguity.shown.cache_clear()
    yield
    ambiguity.shown.cache_clear()


def test_what_a_law_leaves_of_itself_and_of_another_one() -> None:
    before, after = ambiguity.left(ambiguity.SENSOR, ambiguity.SENSOR, pressures=True)
    assert after < 0.1 * before and before > 0.5
    # Of the pressures alone a flow imitates a part of it, and none that muscle 2 could.
    _, by_flow = ambiguity.left(ambiguity.SENSOR, ambiguity.FLOW, pressures=True)
    assert after < by_flow < before


def test_a_locked_joint_is_blind_to_friction_and_its_pressures_to_forces() -> None:
    assert not ambiguity.changed_by(ambiguity.FRICTION.law, "locked").any()
    torque, *pressures = (ambiguity.changed_by(ambiguity.CREEP.law, "locked") ** 2).mean(axis=0)
    assert torque > 0.0 and not any(pressures)
