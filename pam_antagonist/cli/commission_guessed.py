"""Commission a joint whose rig file was never identified: cautious steps, by what is measured, in place of a plan.

The gains of the law through the model are tried on simulated joints: of a few, those that hold the angles best. A joint
that is hardly damped swings where the integral is quick, a regulator with a lag hunts where the torque against friction
changes its side at once, and a closed valve lets the pressures ripple. No linear model shows all of that. So the loop
is run: the law and the filter of the rig that was found, on joints that differ from it a little.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from typing_extensions import override

from pam_antagonist.cli.commission_steps import FIRST_AIR, Commission, StepFailed, from_to
from pam_antagonist.cli.demo import MODEL, task
from pam_antagonist.cli.driving import SIMULATED
from pam_antagonist.control.command import Mode, VoltageLimits
from pam_antagonist.control.laws import Laws, Reachable
from pam_antagonist.control.model_law import ModelController, ModelGains, Seen, voltage_towards
from pam_antagonist.control.reference import Wanted
from pam_antagonist.control.stiffness import Box
from pam_antagonist.design import Plan
from pam_antagonist.design.exploration import FirstAir, Quick, Slow, Towards
from pam_antagonist.design.first_fill import TURNS, pulse_faults
from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import Estimator
from pam_antagonist.identification import air_stage, joint_stage
from pam_antagonist.identification.from_pressures import FromPressures
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.model import equilibrium
from pam_antagonist.rig import Rig
from pam_antagonist.rig.file import write_rig
from pam_antagonist.rig.physical import angle_range, rest_pressure, rest_voltage, unphysical, vented
from pam_antagonist.simulation.plant import Plant

_FASTEST = 20.0
"""[1/s] Rate at which a pressure's error is corrected; a slow log has a lower one."""
_SAMPLES = 0.4
"""The same, in a sample; of the gains that are tried as well."""
_WIDEST = 1.5
"""Standard deviations of the priors at most: beyond, a ruler was read wrongly."""
_TRIES = 200
_WIDER = "; let the air out, and give wider limits if the rig allows it (--max-angle, --max-pressure)"
_HOLD_S, _LAST_S = 5.0, 1.0
"""[s] Of each step, and of its end, where the joint should rest."""
_INTEGRALS = (3.0, 1.0, 0.3)
"""[1/s] That are tried."""
_APPROACHES = (0.3, 0.1, 0.03)
"""[rad] Distances within which the torque against friction fades, that are tried with each integral."""
_SEEDS, _MISMATCH = (1, 2), 0.01
"""Of the simulated joints."""
_GOOD = 0.25
"""Gains with an error below this share of what is allowed are taken at once."""
_ALLOWED, _ALLOWED_SHARE = math.radians(1.0), 0.03
"""Largest error of the controlled joint at rest [rad], or as a share of its range."""


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

    STEPS: Mapping[str, str] = {
        "wiring": FIRST_AIR, "slow": "Joint free; it will turn slowly:", "quick": "Joint free; it will turn quickly:",
        "identify": "", "gains": "",
    }  # fmt: skip

    def __init__(self, arguments: argparse.Namespace, rig: Rig) -> None:
        super().__init__(arguments, rig)
        least, command = vented(rig)
        self._start = Plan(np.empty((0, 2)), rig.sample_period, "free", 0.0, self._limits, least, command)
        if arguments.source in SIMULATED and arguments.plant is None:
            # The file itself would be too easy: its numbers are a guess.
            joint = self._out / "simulated_joint.yaml"
            if not joint.exists():
                about = f"The simulated joint of a rehearsal, drawn from the priors of {rig.name}."
                write_rig(drawn(rig, arguments.seed), joint, [about])
            self._owner = replace(self._owner, rig=str(joint.resolve()), mismatch=0.0)

    def _towards(self) -> Towards:
        p, (low, high) = self._rig.parameters(), self._rig.command_limits
        rate = min(_FASTEST, _SAMPLES / self._rig.sample_period)

        def towards(i: int, pressure: float, wanted: float) -> float:
            return float(np.clip(voltage_towards(i, pressure, wanted, 0.0, 0.0, rate, p), low, high))

        return towards

    @override
    def _wiring(self) -> dict[str, Any]:
        program = FirstAir(self._rig)
        _, recording = self._driven("wiring", self._start, program, _WIDER)
        self._refuse(pulse_faults(self._rig, recording, program.pulses))
        turned = ", ".join(f"{math.degrees(pulse.turned):+.1f}" for pulse in program.pulses)
        said = f"each valve fills its muscle; a little air turned the joint by {turned} deg"
        if still := [str(i) for i, pulse in enumerate(program.pulses, 1) if not abs(pulse.turned) > TURNS]:
            said += f"; with valve {' and '.join(still)} too little to show the encoder's sign: check it by hand"
        return {"said": said, "doubt": bool(still), "rig_s": recording.duration_s}

    def _slow(self) -> dict[str, Any]:
        program = Slow(self._rig, self._limits, self._towards())
        driven = self._recorded("slow", self._start, program, _WIDER)
        if not program.confined:
            raise StepFailed(
                "slow: the difference of the pressures did not turn the joint to its middle: is a muscle off, does a "
                "load hold it, or does the encoder count the other way?"
            )
        return {"said": f"the joint turned slowly {from_to(self._recording(driven))}", **driven}

    def _quick(self) -> dict[str, Any]:
        seconds, slow = self._arguments.duration, self._recording(self.steps["slow"])
        program = Quick(self._rig, self._limits, self._towards(), slow, seconds, self._arguments.seed)
        driven = self._recorded("quick", self._start, program, _WIDER)
        return {"said": f"moved for {seconds:.0f} s, at last within {program.fastest:.2g} s a move", **driven}

    @override
    def _identify(self) -> dict[str, Any]:
        result = self._identified(figures=True)
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
        return {"said": said + held.in_words(), "gains": given}


class Held(NamedTuple):
    """How a joint held the angles that were asked for."""

    error: float  # largest RMS of the last second of a step [rad]
    allowed: float  # [rad]
    largest: float  # largest angle that was asked for [rad]

    def in_words(self) -> str:
        """How the simulated joints did."""
        if self.error <= self.allowed:
            return f"simulated joints hold their angles within {math.degrees(self.error):.2g} deg"
        how = f"err by {math.degrees(self.error):.2g} deg" if math.isfinite(self.error) else "run away"
        return f"with the best gains simulated joints {how}, expected {math.degrees(self.allowed):.2g} deg at most"


def held_angles(rig: Rig, plant: Plant, gains: ModelGains, zero: float = 0.0) -> Held:
    """Steps of the angle, as a demo asks for them, on a simulated joint, with filter and law of a rig.

    `zero`: the joint's angle at the rig's angle 0 [rad].
    """
    p, period = rig.parameters(), rig.sample_period
    box = Box.of(p)
    command = (rest_pressure(rig),) * 2 if rig.drive == "regulator" else rest_voltage(rig)
    limits = VoltageLimits(*rig.command_limits)
    law = ModelController(p, box, gains, sample_period=period, limits=limits, safe_voltage=command)
    laws, estimator, angles = Laws(None, law, Reachable(p, box), MODEL), Estimator(rig, "default", "free"), []
    largest = max(value for _, value, _ in task(rig, Mode.ANGLE, MODEL, 20.0).references)
    allowed = max(_ALLOWED, _ALLOWED_SHARE * 2.0 * angle_range(rig))
    values = np.array([0.0, largest, -largest, 0.5 * largest])
    size, last = math.ceil(_HOLD_S / period - 1e-9), round(_LAST_S / period)
    for k in range(size * len(values)):
        sample = plant.step(command)
        row = estimator.step((k + 1) * round(period * 1e9), *sample.pressure, *sample.voltage)
        assert row is not None  # every sample is newer than the one before
        if abs(sample.truth[0]) > 0.5 * math.pi:
            return Held(math.inf, allowed, largest)  # it has run away
        command = laws.step(Wanted(Mode.ANGLE, float(values[k // size])), Seen.of(row)).voltage
        angles.append(float(sample.truth[0]) - zero)
    ends = np.reshape(angles, (len(values), size))[:, -last:] - values[:, None]
    error = float(np.max(np.sqrt(np.mean(ends**2, axis=1))))
    return Held(error, allowed, largest)


def tried_gains(rig: Rig) -> tuple[ModelGains, Held]:
    """The gains with which simulated joints hold their angles best, and how they do."""
    bandwidth, found = min(ModelGains().bandwidth, _SAMPLES / rig.sample_period), []
    for integral, approach in product(_INTEGRALS, _APPROACHES):
        gains = ModelGains(bandwidth, integral, approach)
        joints = (Plant(rig, seed=seed, mismatch=_MISMATCH) for seed in _SEEDS)
        held = max((held_angles(rig, joint, gains) for joint in joints), key=lambda one: one.error)
        found.append((gains, held))
        if held.error < _GOOD * held.allowed:
            break
    return min(found, key=lambda one: one[1].error)
