"""The trial of a small computer: what it starts shares one core, and nothing of it is left."""

from __future__ import annotations

import os
from pathlib import Path

from pam_antagonist.nodes.processes import PRIORITY_VARIABLE
from pam_antagonist.rig import load_rig
from validation.benchmark import board


def _children() -> set[int]:
    """Processes that this thread started."""
    me = os.getpid()
    return {int(k) for k in Path(f"/proc/{me}/task/{me}/children").read_text().split()}


def test_a_pipeline_on_a_board_shares_one_core_with_busy_processes(tmp_path: Path) -> None:
    cores, before, seen = os.sched_getaffinity(0), _children(), []
    priority = os.environ.get(PRIORITY_VARIABLE)

    def run(rig: str) -> dict[str, float]:
        busy = _children() - before
        there = {tuple(os.sched_getaffinity(k)) for k in (os.getpid(), *busy)}
        seen.append((load_rig(rig).sample_period, len(busy), there, os.environ[PRIORITY_VARIABLE]))
        return {
            "samples in time [%]": 98.5, "joints, share of a core [%]": 12.0, "record, share of a core [%]": 5.0
        }  # fmt: skip

    found = board.measure("shin2022", tmp_path, run)
    assert [period for period, *_ in seen] == [0.001, 0.002, 0.004]
    assert {count for _, count, *_ in seen} == {3}
    assert all(len(there) == 1 and len(*there) == 1 and asked == "0" for *_, there, asked in seen)
    assert os.sched_getaffinity(0) == cores
    assert os.environ.get(PRIORITY_VARIABLE) == priority
    assert _children() == before
    assert found["beside three busy processes, 500 Hz: samples in time [%]"] == 98.5
    assert found["beside three busy processes, 500 Hz: nodes and recorder, share of a core [%]"] == 17.0
