"""Parameter vectors of the rigs, free of what a test does not ask for."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist.rig import Rig, load_rig

# pytest's importlib mode puts no folder on the path: transcription.py and states.py stand beside the tests.
sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(scope="session")
def rig() -> Rig:
    return load_rig("shin2022")


@pytest.fixture(scope="session")
def p(rig) -> np.ndarray:
    """A free joint without a mechanical stop, which the paper's equations do not have."""
    return rig.parameters(changes={"joint.stop": math.inf})


@pytest.fixture(scope="session")
def p_stop(rig) -> np.ndarray:
    """A free joint as the rig declares it."""
    return rig.parameters()


@pytest.fixture(scope="session")
def p_locked(rig) -> np.ndarray:
    return rig.parameters("locked", changes={"joint.stop": math.inf})
