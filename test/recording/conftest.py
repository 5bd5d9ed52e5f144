"""Fixtures: a rig of made-up samples, and the recordings of rig A."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

# pytest's importlib mode puts no folder on the path: fake_bags.py stands beside the tests.
sys.path.insert(0, str(Path(__file__).parent))

from fake_bags import FakeRig


@pytest.fixture
def rig() -> FakeRig:
    return FakeRig()


@pytest.fixture(scope="session")
def rig_a() -> Path:
    """Recordings of rig A, which lie beside the project where somebody put them there."""
    folder = Path(__file__).parents[3] / "shared" / "data" / "rig_a"
    if not folder.is_dir():
        pytest.skip(f"the recordings of rig A are not at {folder}")
    return folder
