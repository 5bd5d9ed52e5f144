"""``benchmark --only before`` and ``--only growth``: what commands spend, and what is made of it."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import pytest

from pam_antagonist.api.simulate import simulate
from pam_antagonist.errors import BadInput
from pam_antagonist.validation.benchmark import added, before, growth
from pam_antagonist.validation.benchmark import busy as busy_part
from pam_antagonist.validation.benchmark import command as benchmark
from pam_antagonist.validation.benchmark import spent as spending
from pam_antagonist.validation.benchmark.spent import Spent, spent


def test_what_a_command_spends_is_that_of_its_process() -> None:
    found = spent("simulate", "--help")
    assert 0.0 < found.cpu_s < 60.0
    assert 0.0 < found.wall_s
    assert 10.0 < found.peak_mb < 2000.0


def test_a_command_that_fails_is_said_with_its_own_words(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"replay ended with status 2: error: .*no_such_bag"):
        spent("replay", str(tmp_path / "no_such_bag"), "--rig", "shin2022", "--out", str(tmp_path / "out"))


def test_the_code_of_another_checkout_runs(tmp_path: Path) -> None:
    package = tmp_path / "pam_antagonist"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "__main__.py").write_text("raise SystemExit('the other code ran')\n")
    with pytest.raises(BadInput, match="the other code ran"):
        spent("close_loop", checkout=tmp_path)


def test_verdicts_and_times_of_two_checkouts_are_compared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The commands themselves are replaced: what is made of their time and of their reports is the question here."""
    (tmp_path / "earlier" / "pam_antagonist").mkdir(parents=True)
    (tmp_path / "earlier" / "pam_antagonist" / "__main__.py").touch()
    for case in ("case_leak", "nominal"):
        (tmp_path / "cases" / case / "free").mkdir(parents=True)
        (tmp_path / "cases" / case / "free" / "metadata.yaml").touch()
    ran = []

    def run(*arguments: str, checkout: Path | None = None) -> Spent:
        out = Path(arguments[arguments.index("--out") + 1])
        if arguments[0] == "battery":
            return Spent(cpu_s=8.0 if checkout is None else 32.0, wall_s=5.0, peak_mb=100.0)
        ran.append((arguments[0], Path(arguments[1]).parent.name, checkout is None))
        effects = [{"name": "leak"}] if "case_leak" in arguments[1] and checkout is None else []
        out.mkdir()
        (out / "report.json").write_text(json.dumps({"verdict": "effect" if effects else "none", "effects": effects}))
        return Spent(cpu_s=10.0 if checkout is None else 40.0, wall_s=5.0, peak_mb=100.0)

    for module in (before, spending):
        monkeypatch.setattr(module, "spent", run)
    monkeypatch.setattr(added, "parts", lambda bags, rig: {"splits": 1.0, "calibrations": 2.0})
    figures = {found.name: found for found in before.measure("shin2022", tmp_path / "earlier", tmp_path / "cases")}
    cases = {"close_loop_case_leak", "close_loop_nominal", "identify_nominal"}
    assert set(figures) == {*cases, "close_loop_all", "close_loop_same_work", "battery"}
    assert figures["battery"].value == 0.25
    assert figures["battery"].parts == {"before_cpu_s": 4.0, "now_cpu_s": 1.0}, "of one case of eight"
    assert figures["close_loop_all"].value == 0.25
    assert figures["close_loop_all"].parts == {"before_cpu_s": 80.0, "now_cpu_s": 20.0, "added_cpu_s": 6.0}
    assert figures["close_loop_same_work"].value == 14.0 / 80.0
    assert figures["close_loop_case_leak"].meaning.endswith("verdict effect leak, was none")
    assert figures["close_loop_nominal"].meaning.endswith("verdict none")
    assert ran[:2] == [("close_loop", "case_leak", False), ("close_loop", "case_leak", True)], "both compile first"


def test_parts_of_close_loop_are_told_apart() -> None:
    recording = simulate("shin2022", profile="steps", duration=20.0, joint="locked", seed=1, mismatch=0.01)
    found = added.parts([recording], "shin2022")
    assert found["calibrations"] > 0.0
    assert found["joints that stick"] == 0.0, "a joint that is held sticks all the time"


def test_a_command_beside_other_work_is_compared_with_itself_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """The commands themselves are replaced; the other work is real, and ends with the command."""
    started: list[subprocess.Popen[bytes]] = []

    class Seen(subprocess.Popen):  # type: ignore[type-arg]
        def __init__(self, *arguments: object, **options: object) -> None:
            super().__init__(*arguments, **options)  # type: ignore[call-overload]
            started.append(self)

    def run(*arguments: str, checkout: Path | None = None) -> Spent:
        busy = [process for process in started if process.poll() is None]
        return Spent(cpu_s=12.0 if len(busy) == os.cpu_count() else 10.0, wall_s=5.0, peak_mb=100.0)

    monkeypatch.setattr(busy_part.subprocess, "Popen", Seen)
    for module in (growth, spending):
        monkeypatch.setattr(module, "spent", run)
    figures = {found.name: found for found in busy_part.measure("shin2022")}
    assert {name: found.value for name, found in figures.items()} == {"close_loop_beside": 1.2, "identify_beside": 1.2}
    assert started and all(process.poll() is not None for process in started)


def test_growth_is_the_exponent_between_the_smallest_and_the_largest() -> None:
    def run(cpu: float, memory: float) -> Spent:
        return Spent(cpu, cpu, memory)

    time, memory = growth._growth(
        "identify", "minutes", {1: run(10.0, 300.0), 5: run(30.0, 500.0), 30: run(300.0, 900.0)}
    )
    assert time.value == pytest.approx(1.0)
    assert time.holds
    assert memory.value == pytest.approx(0.9)
    time, _ = growth._growth("identify", "recordings", {2: run(10.0, 300.0), 8: run(160.0, 300.0)})
    assert time.value == pytest.approx(2.0)
    assert not time.holds


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--only", "before"], "--before DIR (an earlier checkout) and --cases DIR"),
        (["--only", "growth", "--minutes", "5,1"], "expected increasing whole numbers"),
        (["--only", "growth", "--recordings", "two"], "expected increasing whole numbers"),
    ],
)
def test_what_is_missing_or_wrong_is_refused_in_one_line(
    arguments: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert benchmark.main(arguments) == 2
    said = capsys.readouterr().err
    assert complaint in said
    assert said.count("\n") == 1


def test_a_folder_that_is_no_checkout_or_has_no_cases_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="no checkout of this package; expected the folder of `git worktree add"):
        before.measure("shin2022", tmp_path, tmp_path)
    (tmp_path / "pam_antagonist").mkdir()
    (tmp_path / "pam_antagonist" / "__main__.py").touch()
    with pytest.raises(BadInput, match="expected a folder for each case"):
        before.measure("shin2022", tmp_path, tmp_path)
