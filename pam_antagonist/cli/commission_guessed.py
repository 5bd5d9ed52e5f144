"""Commission a joint whose rig file was never identified: cautious steps, by what is measured, in place of a plan."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from typing import Any

import numpy as np
from typing_extensions import override

from pam_antagonist.checks.wiring import guessed
from pam_antagonist.cli.commission_steps import Commission, StepFailed
from pam_antagonist.cli.driving import SIMULATED
from pam_antagonist.cli.tried_gains import tried_gains
from pam_antagonist.control.model_law import voltage_towards
from pam_antagonist.design import Plan
from pam_antagonist.design.exploration import FirstAir, Program, Quick, Slow, Towards
from pam_antagonist.design.first_fill import pulse_faults
from pam_antagonist.errors import BadInput
from pam_antagonist.identification import air_stage, joint_stage
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.model import equilibrium
from pam_antagonist.recording import read_bag
from pam_antagonist.rig import Rig
from pam_antagonist.rig.file import write_rig
from pam_antagonist.rig.physical import unphysical, vented

_FASTEST = 20.0
"""[1/s] Rate at which a pressure's error is corrected; a slow log has a lower one."""
_SAMPLES = 0.4
"""The same, in a sample."""
_WIDEST = 1.5
"""Standard deviations of the priors at most: beyond, a ruler was read wrongly."""
_TRIES = 200


def is_for(rig: Rig) -> bool:
    """Whether a rig is commissioned in this way: a file of ``new_rig`` that was never identified."""
    return guessed(rig) and rig.model.force == "braided"


def drawn(rig: Rig, seed: int) -> Rig:
    """A joint that a guessed rig file may be of.

    What could not be driven at all is drawn again: a joint that no pressures bring to its middle and to a third of its
    range either way.
    """
    rng = np.random.default_rng(seed)
    sought = [*joint_stage.unknowns(rig, []), *air_stage.unknowns(rig)]
    for _ in range(_TRIES):
        values = {
            path: item.value(float(np.clip(rng.standard_normal(), -_WIDEST, _WIDEST)))
            for item in sought
            for path in item.paths
        }
        if "effects.limb_weight.torque" in rig.priors:
            weight, told = rig.priors["effects.limb_weight.torque"], rig.value("effects.limb_weight.torque")
            values["effects.limb_weight.torque"] = abs(told + weight * float(np.clip(rng.standard_normal(), -1.0, 1.0)))
            if not told:
                values["effects.limb_weight.hanging"] = float(rng.uniform(-np.pi, np.pi))
        joint = moved(rig, values)
        if not unphysical(joint) and _drivable(joint):
            return joint
    raise BadInput(f"{rig.name}: no joint of its priors can be driven")


def _drivable(joint: Rig) -> bool:
    """Whether pressures hold the joint in the middle, and a third of its range either way."""
    p = joint.parameters()
    air, supply = joint.atmosphere.pressure, joint.supply.pressure
    low, high = air + 0.15 * (supply - air), air + 0.85 * (supply - air)
    if joint.drive == "regulator":
        low, high = max(low, joint.command_limits[0]), min(high, joint.command_limits[1])
    third = (np.radians(20.0) if joint.joint.stop is None else joint.joint.stop) / 3.0
    return bool(equilibrium.rest_angle(high, low, p) > third and equilibrium.rest_angle(low, high, p) < -third)


class GuessedCommission(Commission):
    """A commissioning of a joint whose rig file is a guess."""

    STEPS = ("wiring", "slow", "quick", "identify", "gains")

    def __init__(self, arguments: argparse.Namespace) -> None:
        super().__init__(arguments)
        if arguments.source in SIMULATED and arguments.plant is None:
            # The file itself would be too easy: its numbers are a guess.
            joint = self._out / "simulated_joint.yaml"
            if not joint.exists():
                about = f"The simulated joint of a rehearsal, drawn from the priors of {self._rig.name}."
                write_rig(drawn(self._rig, arguments.seed), joint, [about])
            self._owner = replace(self._owner, rig=str(joint.resolve()), mismatch=0.0)

    def _explored(self, name: str, program: Program) -> dict[str, Any]:
        """Drive the joint by a program, from muscles without air on."""
        least, command = vented(self._rig)
        plan = Plan(np.empty((0, 2)), self._rig.sample_period, "free", 0.0, self._limits, least, command)
        bag, _, ended = self._driven(name, plan, program)
        if ended:
            raise StepFailed(
                f"{name}: the experiment ended early, {ended}; let the air out, and give wider limits if the rig "
                "allows it (--max-angle, --max-pressure)"
            )
        seconds = read_bag(bag, judge=False).duration_s
        return {"bag": str(bag.relative_to(self._out)), "rig_s": seconds}

    def _towards(self) -> Towards:
        p, (low, high) = self._rig.parameters(), self._rig.command_limits
        rate = min(_FASTEST, _SAMPLES / self._rig.sample_period)

        def towards(i: int, pressure: float, wanted: float) -> float:
            return float(np.clip(voltage_towards(i, pressure, wanted, 0.0, 0.0, rate, p), low, high))

        return towards

    @override
    def _wiring(self) -> dict[str, Any]:
        self._ask("wiring", "Joint free, nothing in its way, supply on; keep away from it:")
        program = FirstAir(self._rig)
        driven = self._explored("wiring", program)
        recording = read_bag(self._out / driven.pop("bag"), judge=False)
        if found := pulse_faults(self._rig, recording, program.pulses):
            raise StepFailed("\n".join(fault.sentence for fault in found))
        turned = ", ".join(f"{math.degrees(pulse.turned):+.1f}" for pulse in program.pulses)
        return {"said": f"each valve fills its muscle; a little air turned the joint by {turned} deg", **driven}

    def _slow(self) -> dict[str, Any]:
        self._ask("slow", "Joint free; it will turn slowly:")
        program = Slow(self._rig, self._limits, self._towards())
        driven = self._explored("slow", program)
        recording = read_bag(self._out / driven["bag"], judge=False)
        assert recording.angle is not None
        low, high = (math.degrees(float(value)) for value in np.nanquantile(recording.angle, [0.02, 0.98]))
        if not program.confined:
            raise StepFailed(
                "slow: the difference of the pressures did not turn the joint to its middle: is a muscle off, does a "
                "load hold it, or does the encoder count the other way?"
            )
        return {"said": f"the joint turned slowly from {low:+.1f} to {high:+.1f} deg", **driven}

    def _quick(self) -> dict[str, Any]:
        self._ask("quick", "Joint free; it will turn quickly:")
        slow = read_bag(self._out / self.steps["slow"]["bag"], judge=False)
        seconds, seed = self._arguments.duration, self._arguments.seed
        program = Quick(self._rig, self._limits, self._towards(), slow, seconds, seed)
        driven = self._explored("quick", program)
        return {"said": f"moved for {seconds:.0f} s, at last within {program.fastest:.2g} s a move", **driven}

    @override
    def _identify(self) -> dict[str, Any]:
        from pam_antagonist.api.identify import IdentifyResult, identify
        from pam_antagonist.identification.from_pressures import FromPressures

        result = identify(self._bags(), self._rig, seed=self._arguments.seed)
        assert isinstance(result, IdentifyResult), "a rig of new_rig"
        result.save(self._result("identified"), figures=True)
        self._note_down(result)
        if result.rejected:
            raise StepFailed(f"identify: do not use this rig: {result.rejected}")
        found = result.found
        assert isinstance(found, FromPressures)
        return {
            "said": f"on held-out data the filter errs by {found.pooled('identified'):.2g} deg "
            f"({found.pooled('as_configured'):.2g} deg with the rig file), {found.coverage:.0%} in the interval",
            "warnings": list(result.warnings),
            "folder": "identified",
        }

    @override
    def found_rig(self) -> Rig:
        return self._use_rig(self._out / "identified" / "rig.yaml")

    @override
    def _gains(self) -> dict[str, Any]:
        self._at("gains", "trying gains on simulated joints")
        gains, held = tried_gains(self.found_rig())
        given = {
            "law": "model", "pressure_bandwidth": gains.bandwidth, "model_integral": gains.integral,
            "approach": gains.approach,
        }  # fmt: skip
        self._write_parameters(given)
        said = f"law through the model: pressures in {1e3 / gains.bandwidth:.0f} ms, integral {gains.integral:.2g}/s; "
        said += held.in_words()
        return {"said": said, "gains": given}
