"""The steps of a commissioning: each drives the joint or learns from recordings, and notes what came of it."""

from __future__ import annotations

import argparse
import json
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pam_antagonist.cli.driving import SIMULATED, DrivenExperiment, Owner, drive, how_to_watch, limits_of, stay_apart
from pam_antagonist.cli.progress import counted
from pam_antagonist.cli.recordings import note_down
from pam_antagonist.design import Plan, designed
from pam_antagonist.design.apart import LIKELY, no_motion_decides, told_apart
from pam_antagonist.design.exploration import Program
from pam_antagonist.design.first_fill import WiringFault, dead_sensors, faults, first_fill, turns_visibly
from pam_antagonist.design.loop_gains import loop_gains
from pam_antagonist.errors import BadInput
from pam_antagonist.inference.trial import ANGLE, CHANNELS, TORQUE
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.program import typed
from pam_antagonist.recording import Recording, read_bag
from pam_antagonist.report.experiments import CommissionResult, ExciteResult
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.rig.physical import steady_voltage
from pam_antagonist.shown import widened
from pam_antagonist.strict_yaml import dump

if TYPE_CHECKING:
    from pam_antagonist.api.diagnose import IdentifyResult

_LOCKED_S = 26.0
"""[s] Shortest experiment with the joint locked: close_loop wants 20 s and more in which the valves move."""
_LATEST_NS = 500_000_000
FIRST_AIR = "Joint free, nothing in its way, supply on; keep away from it:"
_CHECK = "; let the air out, and check valves and sensors"
_BEYOND = """\
. The joint goes farther than its model says. What helps:
  - a larger uncertainty in the rig file, so that the experiment keeps more distance from the limits
  - a wider limit, if the rig allows it (--max-angle, --max-pressure)
  - for the angle: pressures nearer to each other (--min-pressure, --max-pressure)
A tighter limit ends the experiment as well."""
"""What a design keeps away from a limit grows and shrinks with the limit."""


class StepFailed(Exception):
    """A step found a fault, or ended early. The message is what to do, in a sentence or more."""


def _begun(out: Path, rig: str) -> dict[str, dict[str, Any]]:
    """The steps that an earlier start noted in ``state.json``; a folder of something else is refused."""
    state = out / "state.json"
    if not state.exists():
        if out.exists():
            raise BadInput(f"{out}: exists, but commission did not write it; expected the name of a new folder")
        return {}
    try:
        content = json.loads(state.read_text(encoding="utf-8"))
        begun_for, steps = content.get("rig"), dict(content["steps"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise BadInput(f"{state}: cannot be read: {error}; expected what commission wrote") from None
    if begun_for != rig:
        raise BadInput(f"{out}: was begun with --rig {begun_for}, not {rig}; give that rig, or another --out")
    return steps


class Commission:
    """A commissioning, and what of it is done.

    `STEPS`: what the person at the rig is asked before each step; nothing before one that needs nobody. `steps`: of
    each step that was tried, by its name: whether it is ``done``, what it ``said``, and what else it found.
    """

    STEPS: Mapping[str, str] = {
        "wiring": FIRST_AIR, "free": "Joint free:", "locked": "Lock the joint at 0 degrees:", "identify": "",
        "close_loop": "", "apart": "", "gains": "",
    }  # fmt: skip

    def __init__(self, arguments: argparse.Namespace, rig: Rig) -> None:
        self._arguments, self._rig = arguments, rig
        self._out: Path = arguments.out
        self._limits = limits_of(arguments, rig)
        self._say: Callable[[str, float | None], None] = lambda text, seconds: None
        self._owner = Owner.of(arguments, arguments.plant or arguments.rig)
        self.steps = _begun(self._out, rig.name)
        self._out.mkdir(parents=True, exist_ok=True)
        self._note()

    def _note(self) -> None:
        """Note what came of the steps. In one go: an interruption must not cost the steps that are done."""
        new = self._out / "state.json.new"
        new.write_text(json.dumps({"rig": self._rig.name, "steps": self.steps}, indent=1) + "\n", encoding="utf-8")
        new.replace(self._out / "state.json")

    def _recording(self, step: Mapping[str, Any]) -> Recording:
        """What was recorded in a step, by its result."""
        return read_bag(self._out / step["bag"], judge=False)

    def _bags(self) -> list[Path]:
        """The recordings of all steps."""
        return [self._out / step["bag"] for step in self.steps.values() if "bag" in step]

    def _result(self, name: str) -> Path:
        """A result's folder, which is not there: what an attempt left that was interrupted is removed."""
        shutil.rmtree(self._out / name, ignore_errors=True)
        return self._out / name

    @contextmanager
    def announced(self) -> Iterator[None]:
        """Say meanwhile on ``/diagnostics`` which step it is at, where there is ROS."""
        if self._owner.source == "rehearsal":
            yield
            return
        from pam_antagonist.nodes.client import Announcer

        if self._owner.source != "none":
            stay_apart()
        print(how_to_watch(), flush=True)
        with Announcer("commission") as announcer:
            self._say = announcer.say
            yield

    def step(self, name: str) -> None:
        """Do a step, unless it is done. `name`: one of ``STEPS``."""
        if self.steps.get(name, {}).get("done"):
            print(f"{name}: done before. {self.steps[name]['said']}")
            return
        print(f"{name} ...", flush=True)
        self._at(name, "working")
        begin, result = time.monotonic(), {"done": False, "said": "interrupted"}
        try:
            if self.STEPS[name]:
                self._ask(name, self.STEPS[name])
            result = {"done": True, **getattr(self, f"_{name}")()}
        except Exception as fault:
            result["said"] = str(fault) or type(fault).__name__
            raise
        finally:
            self.steps[name] = {**result, "seconds": time.monotonic() - begin}
            self._note()
        print(f"{name}: {result['said']}", flush=True)

    def _at(self, name: str, what: str, seconds: float | None = None) -> None:
        self._say(f"step {list(self.STEPS).index(name) + 1} of {len(self.STEPS)}, {name}: {what}", seconds)

    def _ask(self, name: str, text: str) -> None:
        if not self._arguments.unattended:
            self._at(name, "waiting for Enter")
            try:
                input(f"{text} [Enter] ")
            except EOFError:
                raise BadInput(
                    "there is no terminal to answer at: start the command in a terminal, or with --unattended "
                    "(simulated joint only)"
                ) from None

    def _driven(
        self, name: str, plan: Plan, program: Program | None = None, advice: str = _BEYOND
    ) -> tuple[DrivenExperiment, Recording]:
        """Drive the joint by a plan or a program, to its end, and record it into a new folder.

        The advice is for an experiment that ends early.
        """
        number = next(k for k in count(1) if not (self._out / f"{name}_{k}").exists())
        folder = self._out / f"{name}_{number}"
        folder.mkdir()
        widened(ExciteResult, plan, rig=self._rig).write(folder)
        self._at(name, "driving the joint", plan.duration if program is None else program.seconds)
        driven = drive(self._owner, plan, folder, self._rig, program)
        recording = read_bag(driven.bag, judge=False)
        if driven.ended:
            if name == "wiring":  # a sensor that always shows a high pressure ends it as well
                self._refuse(dead_sensors(recording.pressure))
            raise StepFailed(f"{name}: the experiment ended early, {driven.ended}{advice}")
        return driven, recording

    def _recorded(self, name: str, plan: Plan, program: Program | None = None, advice: str = _BEYOND) -> dict[str, Any]:
        """Drive the joint for a recording that the next steps learn from."""
        driven, recording = self._driven(name, plan, program, advice)
        seconds = plan.duration if program is None else recording.duration_s
        return {"bag": str(driven.bag.relative_to(self._out)), "rig_s": seconds}

    def _refuse(self, found: Sequence[WiringFault]) -> None:
        if found:
            raise StepFailed("\n".join(fault.sentence for fault in found))

    def _wiring(self) -> dict[str, Any]:
        plan = first_fill(self._rig, self._limits.pressure[1])
        driven, recording = self._driven("wiring", plan, advice=_CHECK)
        samples = driven.begun_ns + np.round(np.arange(len(plan.voltage)) * plan.period * 1e9).astype(np.int64)
        if recording.stamp_ns[-1] < samples[-1] - _LATEST_NS:
            raise StepFailed(
                "wiring: the samples stopped before the end of the experiment; check the device, its plug and its power"
            )
        place = np.clip(np.searchsorted(recording.stamp_ns, samples), 0, len(recording.stamp_ns) - 1)
        angle = None if recording.angle is None else recording.angle[place]
        self._refuse(faults(self._rig, recording.pressure[place], angle, plan))
        said, doubt = "each valve fills its muscle, signs and zeros are right, no leak", False
        if angle is not None and not turns_visibly(self._rig, plan):
            said = said.replace("signs and zeros", "zeros")
            said += "; the encoder's sign was not tested: below --max-pressure the joint hardly turns"
            doubt = True
        elif angle is not None:
            said += f"; the joint turned {from_to(recording)}"
        return {"said": said, "doubt": doubt, "rig_s": plan.duration}

    def _free(self) -> dict[str, Any]:
        return self._excited("free", self._arguments.duration)

    def _locked(self) -> dict[str, Any]:
        result = self._excited("locked", max(_LOCKED_S, 0.5 * self._arguments.duration))
        self._ask("locked", "Take the lock away:")
        return result

    def _excited(self, joint: str, seconds: float) -> dict[str, Any]:
        """Drive a free or locked joint by an experiment that is designed for it."""
        self._at(joint, "designing the experiment")
        with counted(seconds, "design") as advance:
            seed = self._arguments.seed
            plan = designed(self._rig, self._limits, seconds, joint, 0.0, seed=seed, progress=advance)
        return {"said": f"recorded {plan.duration:.0f} s", **self._recorded(joint, plan)}

    def _identified(self, figures: bool) -> IdentifyResult:
        """What the recordings say of the rig; it is noted in the log book, unless the joint is simulated."""
        from pam_antagonist.api.diagnose import EpisodesIdentifyResult, identify

        result = identify(self._bags(), self._rig, seed=self._arguments.seed)
        assert not isinstance(result, EpisodesIdentifyResult), "recorded in one piece"
        result.save(self._result("identified"), figures=figures)
        if self._arguments.source not in SIMULATED:
            recordings = [recording for recording, _, _ in result.recordings]
            note_down(self._arguments, "commission", recordings, self._rig, result, self._out / "rig.yaml")
        return result

    def _identify(self) -> dict[str, Any]:
        try:
            result = self._identified(figures=False)
        except BadInput as error:
            # An effect that acts on the free joint only lets both recordings look like two joints.
            return {"said": f"not identified, since the model does not fit ({error}); close_loop looks for the reason"}
        warnings = list(result.warnings)
        if result.rejected:
            return {"said": f"the identified rig is not used: {result.rejected}", "warnings": warnings}
        left = f"{len(result.rig.directions)} uncertain directions are left"
        return {"said": left, "warnings": warnings, "folder": "identified"}

    def _diagnosed(self, name: str) -> dict[str, Any]:
        from pam_antagonist.api.diagnose import EpisodesDiagnoseResult, diagnose

        result = diagnose(self._bags(), self._rig, seed=self._arguments.seed)
        assert not isinstance(result, EpisodesDiagnoseResult), "recorded in one piece"
        result.save(self._result(name), figures=False)
        return {
            "said": result.sentence,
            "verdict": result.verdict,
            "effects": [effect.name for effect in result.effects],
            "rivals": [rival for rival in result.ambiguous_with if rival in CATALOGUE],
            "folder": name,
            "rig": result.next_rig,
        }

    def _close_loop(self) -> dict[str, Any]:
        return self._diagnosed("found")

    def _apart(self) -> dict[str, Any]:
        before = self.steps["close_loop"]
        if not (before["effects"] and before["rivals"]):
            return {"said": "not needed, since no two effects explain the data equally well"}
        found = self._out / "found" / "rig_extended.yaml"
        if not found.exists():
            return {"said": "not done, since no rig with the effect is better than the rig given"}
        given = load_rig(str(found)), before["effects"][0], before["rivals"]
        free, seed = self._recording(self.steps["free"]), self._arguments.seed
        missing = [k for k, values in ((ANGLE, free.angle), (TORQUE, free.torque)) if values is None]
        channels = [k for k in range(len(CHANNELS)) if k not in missing]
        self._at("apart", "designing the experiment")
        with counted(60.0, "design") as advance:
            verdict = told_apart(*given, self._limits, seed=seed, channels=channels, progress=advance)
        if verdict.chance < LIKELY:
            self._at("apart", "looking for what would decide")
            said = f"{given[1]} or {' or '.join(given[2])}: the probability of a decision is {verdict.chance:.0%}. "
            said += no_motion_decides(*given, verdict, channels)
            return {"said": f"{said}. The joint was not driven", "chance": verdict.chance}
        seconds, likely = f"{verdict.plan.duration:.0f} s", f"{verdict.chance:.0%}"
        print(f"the experiment takes {seconds} and decides with a probability of {likely}", flush=True)
        self._ask("apart", "Joint free:")
        recorded = self._recorded("apart", verdict.plan)
        self.steps["apart"] = {"done": False, "said": "", **recorded}
        return {**self._diagnosed("found_again"), **recorded, "chance": verdict.chance}

    def found_rig(self) -> Rig:
        """The rig that the steps found: with its effects, or identified where there are none."""
        last = self.steps["apart"] if "folder" in self.steps["apart"] else self.steps["close_loop"]
        folder = self._out / last["folder"]
        chosen = folder / (last["rig"] or "rig_extended.yaml")
        if last["verdict"] != "effect" or not chosen.exists():
            chosen = self._out / "identified" / "rig.yaml"
        if not chosen.exists():
            raise StepFailed(
                f"gains: no model fits the joint. {self.steps['identify']['said']}. {last['said']} "
                f"Read {folder / 'report.html'}, and repair what it names"
            )
        return self._use_rig(chosen)

    def _use_rig(self, chosen: Path) -> Rig:
        """The rig file of a step, as the one of the commissioning."""
        return load_rig(shutil.copyfile(chosen, self._out / "rig.yaml"), regulators=True)

    def _write_parameters(self, of_controller: dict[str, Any]) -> None:
        content = {
            "/**": {"ros__parameters": {"rig": str((self._out / "rig.yaml").resolve())}},
            "/**/controller": {"ros__parameters": of_controller},
        }
        (self._out / "parameters.yaml").write_text(dump(content), encoding="utf-8")

    def _gains(self) -> dict[str, Any]:
        rig = self.found_rig()
        gains = {mode: loop_gains(rig, mode) for mode in ("angle", "torque")}
        given = {"bias": sum(steady_voltage(rig, 0.5 * (rig.atmosphere.pressure + rig.supply.pressure))) / 2.0}
        for mode, one in gains.items():
            given |= {f"{mode}_proportional": one.proportional, f"{mode}_integral": one.integral}
        self._write_parameters({name: float(f"{value:.4g}") for name, value in given.items()})
        said = "; ".join(f"{mode}: {one.in_words()}" for mode, one in gains.items())
        return {"said": said, "gains": {mode: asdict(one) for mode, one in gains.items()}}

    def report(self) -> None:
        """Write ``report.html`` and ``report.json`` on what was done so far."""
        driven = {name: self._recording(step) for name, step in self.steps.items() if "bag" in step}
        left = tuple(name for name in self.STEPS if name not in self.steps and not self.left_out(name))
        command = typed(f"commission --rig {self._arguments.rig} --out {self._out}")
        result = CommissionResult(self._rig.name, self.steps, driven, self._limits, command, left, self.next_line())
        result.write(self._out)

    def next_line(self) -> str:
        """The command that shows the joint under control."""
        return typed(f"demo --rig {self._out / 'rig.yaml'} --gains {self._out / 'parameters.yaml'}")

    def left_out(self, name: str) -> bool:
        """Whether a step is left out, by the arguments."""
        return name == "locked" and bool(self._arguments.no_lock)


def from_to(recording: Recording) -> str:
    """The range of the angle of a recording that has one, in words."""
    assert recording.angle is not None
    low, high = np.degrees([np.nanmin(recording.angle), np.nanmax(recording.angle)])
    return f"from {low:+.1f} to {high:+.1f} deg"
