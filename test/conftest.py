"""A short recording of a simulated joint, made once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path

import hypothesis
import numpy as np
import pytest

from pam_antagonist.recording import Recording, read_bag, write_bag
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.simulation import excitation
from pam_antagonist.simulation.plant import Plant

# A busy machine is slow now and then, which is no defect of what is tested.
hypothesis.settings.register_profile("project", deadline=None)
hypothesis.settings.load_profile("project")

SLOW_S = 10  # of a test that is marked slow without saying how slow [s]
FIRST_NS = 1_700_000_000_000_000_000


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What takes longest begins first: of two processes, none is left with a long file at the end."""
    seconds: Counter[Path] = Counter()
    for item in items:
        if (slow := item.get_closest_marker("slow")) is not None:
            seconds[item.path] += slow.args[0] if slow.args else SLOW_S
    items.sort(key=lambda item: -seconds[item.path])


@pytest.fixture(scope="session")
def rig() -> Rig:
    return load_rig("shin2022")


def _record(rig: Rig, folder: Path, joint: str, seconds: float) -> Recording:
    plant = Plant(rig, joint=joint, seed=5, mismatch=0.01)
    voltage = excitation.profile("steps", seconds, rig.sample_period, seed=2)
    samples = [plant.step(u) for u in voltage]
    stamps = FIRST_NS + np.arange(1, len(samples) + 1) * 1_000_000
    recording = Recording(
        path=folder,
        stamp_ns=stamps,
        pressure=np.array([sample.pressure for sample in samples]),
        voltage=voltage,
        angle=np.array([sample.angle for sample in samples]),
        torque=np.array([sample.torque for sample in samples]),
    )
    write_bag(folder, recording)
    return read_bag(folder)


@pytest.fixture(scope="session")
def free(rig: Rig, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Six seconds of a free joint, 6000 samples, read back from a bag."""
    return _record(rig, tmp_path_factory.mktemp("bags") / "free", "free", 6.0)


@pytest.fixture(scope="session")
def locked(rig: Rig, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Six seconds of a joint that is held at 0, with encoder noise."""
    return _record(rig, tmp_path_factory.mktemp("bags") / "locked", "locked", 6.0)


@pytest.fixture(scope="session")
def changed() -> Callable[..., Recording]:
    """A recording with other values: ``changed(recording, keep=mask, angle=None)``."""

    def change(recording: Recording, keep: np.ndarray | None = None, **values: object) -> Recording:
        mask = np.ones(len(recording.stamp_ns), dtype=bool) if keep is None else keep
        names = ("stamp_ns", "pressure", "voltage", "angle", "torque")
        arrays = {name: values.get(name, getattr(recording, name)) for name in names}
        kept = {name: None if array is None else np.asarray(array)[mask] for name, array in arrays.items()}
        others = {name: value for name, value in values.items() if name not in names}
        return Recording(path=recording.path, **kept, **others)  # type: ignore[arg-type]

    return change
