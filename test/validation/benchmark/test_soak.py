"""What the soak run makes of its series: growth, drift, bounds; and the run itself, short."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist.recording import Arrival, Recording
from pam_antagonist.replays.accounting import STAGES
from validation.benchmark import command as benchmark
from validation.benchmark.figure import at_most
from validation.benchmark.soak import Usage, clock_drift, growth


def usage(resident: np.ndarray) -> Usage:
    time = np.arange(len(resident), dtype=float)
    return Usage(time, {"plant": resident}, {"plant": 0.1 * time})


def test_growth_counts_from_the_end_of_the_warm_up() -> None:
    time = np.arange(601.0)
    assert growth(usage(200.0 + np.minimum(time, 50.0)), "plant") == 0.0  # all of it in the first minute
    leak = growth(usage(200.0 + 0.01 * time), "plant")
    assert leak == pytest.approx(0.01 * (595.0 - 64.5))
    spikes = 200.0 + 50.0 * (time % 20 == 0)
    assert growth(usage(spikes), "plant") == 0.0


def recorded(drift: float, delays: np.ndarray) -> Recording:
    """Samples at 1 kHz whose device runs slow by ``drift``."""
    size = len(delays)
    stamp_ns = 10**18 + 10**6 * np.arange(size)
    log_ns = stamp_ns + (drift * (stamp_ns - stamp_ns[0])).astype(np.int64) + (delays * 1e6).astype(np.int64)
    arrival = Arrival(log_ns, stamp_ns)
    return Recording(
        Path("x"), stamp_ns, np.full((size, 2), 4e5), np.full((size, 2), 5.0), received_ns={"pressure_1": arrival}
    )


def test_drift_is_told_from_delays() -> None:
    rng = np.random.default_rng(1)
    delays = 0.15 + rng.exponential(0.3, 60_000)
    delays[30_000:45_000] += rng.exponential(5.0, 15_000)  # the machine was busy
    assert np.abs(clock_drift(recorded(0.0, delays))).max() < 0.03  # ms
    drift = clock_drift(recorded(50e-6, delays))
    assert len(drift) == 6
    assert drift[-1] == pytest.approx(50e-6 * 50e3, rel=0.02)  # 50 ppm over 50 s


@pytest.mark.ros
@pytest.mark.realtime
@pytest.mark.skipif(not os.environ.get("PAM_PROOF"), reason="a release measures it: PAM_PROOF=1 ./run test runs it")
def test_a_short_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("rclpy")
    monkeypatch.setenv("ROS_DOMAIN_ID", "0")  # it takes a free one and leaves that behind
    assert benchmark.main(["--soak", "15", "--json", str(tmp_path / "soak.json")]) == 0
    said = json.loads((tmp_path / "soak.json").read_text())
    assert set(said["figures"]) == {
        "soak_memory_growth", "soak_recorder_growth", "soak_lost", "soak_drift", "soak_processor",
    }  # fmt: skip
    series = said["series"]
    assert 15 <= len(series["time_s"]) <= 17
    assert set(series["resident_mb"]) == set(series["cpu_s"]) == {"plant", "estimator", "controller", "record"}
    assert all(len(values) == len(series["time_s"]) for values in series["resident_mb"].values())
    assert said["figures"]["soak_lost"]["value"] <= 0.1
    assert set(series["lost"]) == set(STAGES) and len(series["lost"]["pressure_1"]) == 2
    worst = max(sum(values) for values in series["lost"].values())
    assert worst == max(said["figures"]["soak_lost"]["parts"][stage] for stage in STAGES)
    assert "soak_memory_growth" in capsys.readouterr().out


def test_the_figures_as_json_on_standard_output(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from validation.benchmark import kernels

    monkeypatch.setattr(kernels, "measure", lambda rig: [at_most("step", "what a step costs", 2.0, 3.0, "", {})])
    assert benchmark.main(["--only", "kernels", "--json", "-"]) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["figures"]["step"]["value"] == 2.0
    assert "what a step costs" in printed.err
