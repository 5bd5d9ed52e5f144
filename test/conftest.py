"""A short recording of a simulated joint, made once."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import hypothesis
import machine
import numpy as np
import pytest

from pam_antagonist.api.simulate import FIRST_STAMP_NS, simulate
from pam_antagonist.recording import Recording, read_bag, write_bag
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.simulation import excitation

# A busy machine is slow now and then, which is no defect of what is tested.
hypothesis.settings.register_profile("project", deadline=None)
hypothesis.settings.load_profile("project")

pytest_plugins = ["durations"]

SLOW_S = 10  # of a test that is marked slow without saying how slow [s]
FIRST_NS = 1_700_000_000_000_000_000


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What takes longest begins first: of two processes, none is left with a long file at the end."""
    seconds: Counter[Path] = Counter()
    for item in items:
        for marker in (item.get_closest_marker("slow"), item.get_closest_marker("thorough")):
            if marker is not None:
                seconds[item.path] += marker.args[0] if marker.args else SLOW_S
    items.sort(key=lambda item: -seconds[item.path])


FAILURES = 3
"""Tests of pipelines that fail before the machine is asked whether it keeps up, and again after so many more."""


@lru_cache
def _keeps_up(times: int) -> bool:
    return times == 0 or machine.keeps_up()


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Leave out pipelines where the machine turns out to be too slow: each would fail after a minute of waiting."""
    if item.get_closest_marker("realtime") and not _keeps_up(item.session.testsfailed // FAILURES):
        pytest.skip("this machine is too slow for 1 kHz")


@pytest.fixture(scope="session")
def rig() -> Rig:
    return load_rig("shin2022")


def _record(rig: Rig, folder: Path, joint: str) -> Recording:
    """Six seconds, 6000 samples, read back from a bag."""
    voltage = excitation.profile("steps", 6.0, rig.sample_period, seed=2)
    made = simulate(rig, voltage, joint=joint, seed=5, mismatch=0.01)
    write_bag(folder, replace(made, stamp_ns=made.stamp_ns - FIRST_STAMP_NS + FIRST_NS))
    return read_bag(folder)


@pytest.fixture(scope="session")
def free(rig: Rig, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A free joint."""
    return _record(rig, tmp_path_factory.mktemp("bags") / "free", "free")


@pytest.fixture(scope="session")
def locked(rig: Rig, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A joint that is held at 0, with encoder noise."""
    return _record(rig, tmp_path_factory.mktemp("bags") / "locked", "locked")


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


GOLDEN = Path(__file__).parent / "golden"
"""A report.json each, as it is meant to stay; a key that is missing there is new, one more there is gone."""
CHANGING = {"timing", "software", "sha256", "realtime_factor", "live_equal", "name", "files", "recording", "version"}
"""Keys whose values differ from machine to machine."""


@pytest.fixture
def golden(monkeypatch: pytest.MonkeyPatch) -> Callable[[str, Any], None]:
    """Compares a report with the one that is kept: keys and texts are the same, numbers within a few per cent.

    ``PAM_GOLDEN=write`` writes those that are kept anew.
    """

    def compare(name: str, content: Any) -> None:
        file = GOLDEN / f"{name}.json"
        if os.environ.get("PAM_GOLDEN") == "write":
            file.parent.mkdir(exist_ok=True)
            file.write_text(json.dumps(_short(content), indent=None, ensure_ascii=False) + "\n", encoding="utf-8")
        kept = json.loads(file.read_text(encoding="utf-8"))
        found = list(_differences(kept, _short(json.loads(json.dumps(content))), name))
        assert not found, "\n".join(found)

    return compare


def _short(value: Any, key: str = "") -> Any:
    """Without values that change, and of long lists only the first two."""
    if key in CHANGING and not isinstance(value, dict):
        return None
    if isinstance(value, dict):
        return {name: _short(item, name) for name, item in value.items()}
    if isinstance(value, list):
        return [_short(item) for item in value[: 2 if len(value) > 12 else None]]
    return value


def _differences(kept: Any, now: Any, where: str) -> Iterator[str]:
    if isinstance(kept, dict) and isinstance(now, dict):
        if list(kept) != list(now):
            yield f"{where}: keys {list(now)}, expected {list(kept)}"
        if where.rpartition(".")[2] not in CHANGING:
            for name in kept.keys() & now.keys():
                yield from _differences(kept[name], now[name], f"{where}.{name}")
    elif isinstance(kept, list) and isinstance(now, list):
        if len(kept) != len(now):
            yield f"{where}: {len(now)} entries, expected {len(kept)}"
        for k, pair in enumerate(zip(kept, now, strict=False)):
            yield from _differences(*pair, f"{where}[{k}]")
    elif isinstance(kept, float) and isinstance(now, (int, float)):
        # Changes of a fit that hardly moved are rounding, which other processors do otherwise.
        if now != pytest.approx(kept, rel=0.05, abs=1e-6):
            yield f"{where}: {now}, expected {kept}"
    elif kept != now and not isinstance(kept, str):
        yield f"{where}: {now!r}, expected {kept!r}"
