"""Virtual rigs: one as the scenario has it, one without any mismatch."""

from __future__ import annotations

import pytest

from validation.paper.scenario import Hysteresis, Mismatch, Scenario, load_scenario


@pytest.fixture(scope="session")
def scenario() -> Scenario:
    return load_scenario()


@pytest.fixture(scope="session")
def exact(scenario: Scenario) -> Scenario:
    """The plant is the declared rig, behind its noisy sensors."""
    nothing = Hysteresis(amplitude=0.0, spread=0.0, width=2e-3)
    return scenario.replaced(mismatch=Mismatch(parameters=0.0, valve_curve=0.0, hysteresis=nothing))
