"""``commission``: what it refuses; stopped by Ctrl-C in the middle of each step it goes on where it was."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml

from pam_antagonist.cli import commission, commission_steps
from pam_antagonist.design import Plan
from pam_antagonist.design.apart import ExpectedOutcome
from pam_antagonist.design.first_fill import first_fill
from pam_antagonist.errors import BadInput
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.nodes.processes import ProcessFailed
from pam_antagonist.rig import load_rig
from pam_antagonist.rig.file import write_rig

RIG = load_rig("shin2022")
LEAKING = moved(RIG, {"effects.leak.area_1": 1e-9})


def commissioned(out: Path) -> int:
    """Status of a commissioning of a simulated joint, with nobody at it."""
    return commission.main(["--rig", "shin2022", "--out", str(out), "--unattended", "--source", "rehearsal"])


def short(joint: str = "free") -> Plan:
    """A second at rest, in the place of a design that takes long."""
    plan = first_fill(RIG)
    return replace(plan, voltage=plan.voltage[:1000], joint=joint)


class Stopped:
    """Whatever is called: the first call of each kind does its work, and is stopped by Ctrl-C before it is noted."""

    def __init__(self) -> None:
        self.calls: Counter[str] = Counter()

    def once(self, kind: str) -> None:
        self.calls[kind] += 1
        if self.calls[kind] == 1:
            raise KeyboardInterrupt


@pytest.fixture
def stopped(monkeypatch: pytest.MonkeyPatch) -> Stopped:
    """Commissioning with quick designs and findings; air goes in by the rehearsal as ever."""
    out, driven = Stopped(), commission_steps.drive

    def drive(owner: Any, plan: Plan, folder: Path, *more: Any) -> Any:
        result = driven(owner, plan, folder, *more)
        out.once(folder.name.partition("_")[0])
        return result

    class Found(SimpleNamespace):
        def save(self, path: Path, figures: bool) -> None:
            path.mkdir()
            write_rig(RIG, path / "rig.yaml")
            write_rig(LEAKING, path / "rig_extended.yaml")
            out.once(path.name)

    def diagnose(bags: list[Path], rig: Any, seed: int) -> Found:
        rivals = ("valve_offset",) if len(bags) == 2 else ()
        sentence = f"a leak, by {len(bags)} recordings"
        return Found(
            verdict="effect", effects=[SimpleNamespace(name="leak")], ambiguous_with=rivals, sentence=sentence,
            next_rig="rig_extended.yaml",
        )  # fmt: skip

    monkeypatch.setattr(commission_steps, "drive", drive)
    monkeypatch.setattr(commission_steps, "designed", lambda rig, limits, s, joint="free", *more, **k: short(joint))
    monkeypatch.setattr(
        commission_steps, "told_apart", lambda *given, **k: ExpectedOutcome(short(), 0.97, {"valve_offset": 0.97})
    )
    monkeypatch.setattr(
        "pam_antagonist.api.diagnose.identify", lambda bags, rig, seed: Found(rig=RIG, warnings=(), rejected="")
    )
    monkeypatch.setattr("pam_antagonist.api.diagnose.diagnose", diagnose)
    return out


@pytest.mark.slow(6)
def test_each_step_goes_on_after_ctrl_c(stopped, tmp_path, capsys):
    out = tmp_path / "commissioned"
    kinds = ("wiring", "free", "locked", "identified", "found", "apart", "found_again")
    for kind in kinds:
        assert commissioned(out) == 130
        assert stopped.calls[kind] == 1, "stopped in this step"
        assert "type the same command again" in capsys.readouterr().err
        assert json.loads((out / "report.json").read_text())["rig"] == "shin2022"
    assert commissioned(out) == 0
    said = capsys.readouterr().out
    assert "locked: done before. recorded 1 s" in said and "apart: a leak, by 3 recordings" in said
    # The last step is stopped twice: in its recording, and in its diagnosis, which needs the recording anew.
    assert stopped.calls == {**dict.fromkeys(kinds, 2), "apart": 3}
    steps = json.loads((out / "state.json").read_text())["steps"]
    assert list(steps) == list(commission_steps.Commission.STEPS) and all(step["done"] for step in steps.values())
    assert steps["wiring"]["rig_s"] == pytest.approx(19.0) and steps["free"]["bag"] == "free_2/bag"
    assert "leak" in load_rig(str(out / "rig.yaml")).effects
    gains = yaml.safe_load((out / "parameters.yaml").read_text())["/**/controller"]["ros__parameters"]
    assert 5.0 < gains["bias"] < 5.6 and gains["angle_proportional"] > 1.0


def test_a_person_is_asked_before_each_step_that_needs_one(stopped, monkeypatch, tmp_path):
    asked: list[str] = []
    monkeypatch.setattr("builtins.input", lambda prompt: asked.append(prompt.removesuffix(" [Enter] ")))
    stopped.calls.update(dict.fromkeys(("wiring", "free", "locked", "identified", "found", "apart", "found_again"), 1))
    words = ["--rig", "shin2022", "--out", str(tmp_path / "new"), "--source", "rehearsal"]
    assert commission.main(words) == 0
    first, *others = asked
    assert first == "Joint free, nothing in its way, supply on; keep away from it:"
    assert others == ["Joint free:", "Lock the joint at 0 degrees:", "Take the lock away:", "Joint free:"]


def test_recordings_that_no_model_fits_are_left_to_close_loop(stopped, monkeypatch, tmp_path, capsys):
    from pam_antagonist.api import diagnose

    def refuse(bags: list[Path], rig: Any, seed: int) -> Any:
        raise BadInput("free_1/bag and locked_1/bag are not recordings of one rig")

    def judged(*given: Any, **more: Any) -> Any:
        found = explained(*given, **more)
        found.verdict, found.ambiguous_with = "unexplained", ()
        return found

    explained = diagnose.diagnose
    monkeypatch.setattr("pam_antagonist.api.diagnose.identify", refuse)
    monkeypatch.setattr(diagnose, "diagnose", judged)
    stopped.calls.update(dict.fromkeys(("wiring", "free", "locked", "found"), 1))
    assert commissioned(tmp_path / "new") == 1
    said = capsys.readouterr()
    assert "identify: not identified, since the model does not fit" in said.out
    assert "are not recordings of one rig" in said.out
    assert "no model fits the joint" in said.err


@pytest.mark.parametrize(
    ("instead", "words"),
    [
        (("a third pressure sensor at muscle 1 (97%)",), "this would: a third pressure sensor at muscle 1 (97%)"),
        ((), "nor does another sensor or a lock"),
    ],
)
def test_where_no_motion_decides_the_joint_is_not_driven_and_the_sensor_is_named(
    instead, words, stopped, monkeypatch, tmp_path, capsys
):
    asked: list[Any] = []

    def told_apart(*given: Any, channels: Any, **more: Any) -> ExpectedOutcome:
        asked.append(channels)
        return ExpectedOutcome(short(), 0.12, {"valve_offset": 0.12})

    stopped.calls.update(dict.fromkeys(("wiring", "free", "locked", "identified", "found"), 1))
    monkeypatch.setattr(commission_steps, "told_apart", told_apart)
    monkeypatch.setattr("pam_antagonist.design.apart.instead_of", lambda *given: instead)
    out = tmp_path / "new"
    assert commissioned(out) == 0
    (said,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("apart: ")]
    assert "leak or valve_offset: the probability of a decision is 12%. No motion within the limits" in said
    assert words in said and said.endswith("The joint was not driven")
    assert asked == [[0, 1, 2, 3]] and not (out / "apart_1").exists()
    assert "leak" in load_rig(str(out / "rig.yaml")).effects


def test_a_joint_that_goes_farther_than_its_model_gets_advice_that_helps(stopped, monkeypatch, tmp_path, capsys):
    """A smaller --max-angle does not help: it is the limit at which the experiment ends."""

    def narrow(*given: Any, **more: Any) -> Plan:
        plan = short()
        return replace(plan, limits=replace(plan.limits, angle=1e-7))

    stopped.calls.update(dict.fromkeys(("wiring", "free"), 1))
    monkeypatch.setattr(commission_steps, "designed", narrow)
    assert commissioned(tmp_path / "new") == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "free: the experiment ended early, after" in said and "beyond the limit of 0.0 deg" in said
    assert "a larger uncertainty in the rig file" in said and "a wider limit, if the rig allows it" in said
    assert "pressures nearer to each other (--min-pressure, --max-pressure)" in said and "tighter limits" not in said


def test_a_sensor_that_always_shows_the_same_is_named(monkeypatch, tmp_path, capsys):
    from pam_antagonist.simulation import plant

    class Frozen(plant.Plant):
        def step(self, *given: Any) -> Any:
            sample = super().step(*given)
            sample.pressure[0] = 450.3e3
            return sample

    monkeypatch.setattr(plant, "Plant", Frozen)
    assert commissioned(tmp_path / "new") == 1
    assert "pressure sensor 1 shows 450.3 kPa all the time" in capsys.readouterr().err


def test_a_folder_of_something_else_stays_as_it_is(tmp_path, capsys):
    another = json.dumps({"rig": "another", "steps": {}})
    wrong = ("but commission did not write it", None), ("begun with --rig another", another), ("state.json", "no json")
    for said, state in wrong:
        if state is not None:
            (tmp_path / "state.json").write_text(state)
        assert commissioned(tmp_path) == 2
        assert said in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["state.json"]


def test_the_report_of_a_run_that_failed_says_so_first(tmp_path, capsys, monkeypatch):
    def drive(*_: object) -> None:
        raise ProcessFailed("plant ended with status 2: the supply is off")

    monkeypatch.setattr(commission_steps, "drive", drive)
    out = tmp_path / "new"
    assert commissioned(out) == 1
    assert "the supply is off" in capsys.readouterr().err
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "All is done" not in page
    first = page.index("<p", page.index("<h1"))
    assert "Step wiring failed: plant ended with status 2: the supply is off." in page[first : first + 300]
    assert "Not begun: free, locked, identify" in page
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert not report["steps"][0]["done"] and "gains" in report["left"]
