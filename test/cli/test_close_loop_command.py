"""The command as users meet it."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from pam_antagonist import simulate
from pam_antagonist.cli.close_loop import main
from pam_antagonist.diagnosis.hypotheses import ResumeFolder
from pam_antagonist.recording import write_bag
from pam_antagonist.rig import load_rig
from validation.battery.plants import Case


@pytest.fixture(scope="module")
def leaking(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bags") / "leaking"
    case = Case("leaking", "single", (("leak", 2),), ("seeping",), 5, (15.0,))
    write_bag(folder, case.recording("locked", 24.0))
    return folder


@pytest.fixture(scope="module")
def done(leaking: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out") / "found"
    assert main([str(leaking), "--rig", "shin2022", "--out", str(out), "--jobs", "1"]) == 0
    return out


@pytest.mark.slow
def test_report_and_rig_are_written(done):
    names = ["report.html", "report.json", "rig_extended.log.jsonl", "rig_extended.yaml"]
    assert sorted(path.name for path in done.iterdir()) == names
    assert not (done.parent / "found.part").exists()
    assert load_rig(done / "rig_extended.yaml").effects["leak"]["area_2"] > 0.0
    assert "Air leaks from muscle 2" in (done / "report.html").read_text()


def test_the_report_stays_as_it_is(done, golden):
    golden("close_loop", json.loads((done / "report.json").read_text()))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("--holdout 0.9", ["--holdout", "0.1 to 0.5"]),
        ("--holdout 0,3", ["--holdout", "such as 0.3"]),
        ("--topic pressure_1:=/mine/p1", ["--topic pressure_1=/NAME"]),
        ("--jobs 0", ["--jobs"]),
        ("--lock-angle 3", ["--lock-angle"]),
        ("--seed -1", ["--seed"]),
        ("--holdout 0.3 --holdout 0.2", ["--holdout", "one share"]),
        ("--holdout 0.3 --holdout another_bag", ["--holdout", "one share"]),
        ("{bag}", ["same recording"]),
        ("--holdout {bag}", ["same recording"]),
        ("--rig sealed_joint", ["the chambers of rig sealed_joint are sealed"]),
    ],
)
def test_wrong_arguments_are_one_line(leaking, tmp_path, arguments, words, refused):
    given = arguments.format(bag=leaking).split()
    bags = [given.pop(0)] if not given[0].startswith("-") else []
    refused(main, [str(leaking), *bags, "--rig", "shin2022", "--out", str(tmp_path / "o"), *given], *words)
    assert not (tmp_path / "o").exists() and not (tmp_path / "o.part").exists()


@pytest.mark.parametrize(
    ("moves", "said", "expected"), [("free", "locked", "stands still"), ("locked", "free", "expected locked")]
)
def test_a_condition_that_the_encoder_contradicts_is_refused_before_any_fit(moves, said, expected, tmp_path, capsys):
    """It used to end in an error about an option that nobody typed, or in effects that explain the wrong condition."""
    write_bag(tmp_path / "bag", simulate("shin2022", duration=21.0, joint=moves))
    arguments = [str(tmp_path / "bag"), "--rig", "shin2022", "--joint", said, "--out", str(tmp_path / "out")]
    assert main([*arguments, "--no-check"]) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert f"declared {said}, but its measured angle moves by" in error and expected in error
    assert not (tmp_path / "out.part").exists()


def test_what_was_interrupted_wants_resume(leaking, tmp_path, refused):
    (tmp_path / "o.part").mkdir()
    refused(main, [str(leaking), "--rig", "shin2022", "--out", str(tmp_path / "o")], "--resume")


@pytest.mark.slow(4)
def test_an_interrupted_run_goes_on_to_the_same_report(leaking, done, tmp_path, monkeypatch, capsys):
    out = tmp_path / "o"
    arguments = [str(leaking), "--rig", "shin2022", "--out", str(out), "--jobs", "1", "--no-figures"]
    save = ResumeFolder.save

    def interrupted(self: ResumeFolder, *what: object) -> None:
        save(self, *what)  # type: ignore[arg-type]
        if self.finished() == 2:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(ResumeFolder, "save", interrupted)
        assert main(arguments) == 130
    said = capsys.readouterr().err
    assert "2 finished refits are kept" in said and "--resume" in said and str(leaking) in said
    assert not out.exists()
    assert main([*arguments, "--resume", "--seed", "8"]) == 2
    assert "another seed" in capsys.readouterr().err
    assert main([*arguments, "--resume"]) == 0
    assert not (tmp_path / "o.part").exists()
    reports = [json.loads((folder / "report.json").read_text()) for folder in (done, out)]
    assert reports[0].pop("timing") and reports[1].pop("timing")
    assert reports[0] == reports[1]


def test_without_dask_the_command_says_how_to_get_it(leaking, tmp_path, monkeypatch, refused):
    monkeypatch.setitem(sys.modules, "distributed", None)
    arguments = [str(leaking), "--rig", "shin2022", "--out", str(tmp_path / "o"), "--dask", "tcp://127.0.0.1:1"]
    refused(main, arguments, "pip install 'pam_antagonist[dask]'")
    assert not (tmp_path / "o.part").exists()
