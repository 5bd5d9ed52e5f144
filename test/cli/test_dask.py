"""Commands whose work is done by two processes of a Dask scheduler give what they give by themselves."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from joblib import Parallel, delayed

from pam_antagonist.cli import close_loop, identify, simulate
from pam_antagonist.cli.recordings import connected

pytestmark = pytest.mark.thorough(20)

distributed = pytest.importorskip("distributed", reason="Dask is an option: pip install 'pam_antagonist[dask]'")

FEW = ["--freeze", "muscle_1", "--freeze", "muscle_2", "--freeze", "gas", "--freeze", "joint", "--freeze", "friction"]


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as local:
        yield local.scheduler_address


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bags")
    for joint, length in (("free", "10"), ("locked", "22")):
        arguments = ["--rig", "shin2022", "--out", str(folder / joint), "--duration", length, "--profile", "steps"]
        assert simulate.main([*arguments, "--seed", "3", "--mismatch", "0.02", "--joint", joint]) == 0
    return folder


def test_work_is_done_by_both_workers_and_not_here(scheduler):
    def where(number: int) -> int:
        return os.getpid()

    with connected(scheduler):
        places = set(Parallel(n_jobs=1, prefer="threads")(delayed(where)(number) for number in range(40)))
    assert os.getpid() not in places and len(places) == 2


def without_times(file: Path) -> dict[str, Any]:
    found = json.loads(file.read_text())
    return {key: value for key, value in found.items() if key not in ("timing", "seconds", "threads", "created")}


@pytest.mark.parametrize(("command", "options"), [(identify.main, ["free", *FEW]), (close_loop.main, ["locked"])])
def test_a_report_is_the_same(command, options, scheduler, bags, tmp_path):
    bag, *further = options
    reports, statuses = [], []
    for name, where in (("here", []), ("there", ["--dask", scheduler])):
        arguments = [str(bags / bag), "--rig", "shin2022", "--out", str(tmp_path / name), "--no-figures", *further]
        statuses.append(command([*arguments, *where]))
        reports.append(without_times(tmp_path / name / "report.json"))
    assert reports[0] == reports[1]
    # So little data may give no better rig, which is status 1.
    assert statuses in ([0, 0], [1, 1])
