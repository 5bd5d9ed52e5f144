"""``rehearse_new_rigs``: rigs of ``new_rig``, each commissioned on a joint drawn from the file's own priors."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pam_antagonist.cli import commission, common, new_rig
from pam_antagonist.cli.commission_guessed import gains_for
from pam_antagonist.cli.demo_steps import MODEL, task
from pam_antagonist.control import Box, Laws, Mode, ModelController, Reachable, VoltageLimits
from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import Estimator
from pam_antagonist.identification import air_stage, joint_stage
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.model import equilibrium
from pam_antagonist.recording import read_bag
from pam_antagonist.report import terminal
from pam_antagonist.report.table import Table, markdown
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.rig.load import write_rig
from pam_antagonist.rig.physical import angle_range, rest_pressure, rest_voltage, unphysical
from pam_antagonist.simulation.plant import Plant
from pam_antagonist.strict_json import write_json
from validation.control.loop import held, seen

_DESCRIPTION = """\
Commission twelve rigs of new_rig, unattended, each on a joint that is drawn from the priors of its file.

DIR keeps a folder for each rig. A rig that has an outcome is not done again.
"""
_EXAMPLES = """\
examples:
  {run} rehearse_new_rigs --out rehearsed
"""
_MOVES_S = 40.0
"""[s] Of the quick moves, at the end of their recording."""
_SEED, _HOLD_S, _LAST_S = 1, 5.0, 1.0
_ALLOWED_DEG, _ALLOWED_SHARE = 1.0, 0.03
"""Largest error of the controlled joint at rest [deg], or as a share of its range."""

_WIDEST = 1.5
"""Standard deviations of the priors at most: beyond, a ruler was read wrongly."""
_TRIES = 200


@dataclass(frozen=True)
class Described:
    """What a laboratory types into ``new_rig``, beside the name.

    Attributes:
        name: of the rig.
        words: options.
    """

    name: str
    words: str


def _valve(kind: str, muscle: str, valve: str, more: str) -> str:
    return f"--kind {kind} --muscle {muscle} --drive valve --valve {valve} {more}"


def _regulator(kind: str, muscle: str, regulator: str, time: float, more: str) -> str:
    return f"--kind {kind} --muscle {muscle} --drive regulator --regulator {regulator} --regulator-time {time} {more}"


_SMALL = "--radius 14mm --nominal-length 150mm --length 137mm --inertia 0.001 --mass 0.3kg"
_USUAL = "--radius 25mm --nominal-length 300mm --length 272mm --inertia 0.02 --mass 1.5kg"
_LARGE = "--radius 45mm --nominal-length 600mm --length 545mm --inertia 0.25 --mass 5kg"
_DRUM = f"{_SMALL} --supply 7bar --stop 35deg --rate 100"
_ARM = f"{_USUAL} --supply 6bar --stop 40deg --rate 100"
_LEG = f"{_LARGE} --supply 8bar --stop 40deg --rate 100"
DESCRIBED = (
    Described("finger", _valve("pulley", "DMSP-10", "MPYE-5-M5", f"{_SMALL} --supply 7bar --stop 35deg --rate 500")),
    Described("wrist", _valve("lever", "MAS-10", "shin2022", f"{_SMALL} --supply 6bar --stop 30deg --rate 1000")),
    Described("elbow", _valve("pulley", "DMSP-20", "own --valve-flow 60",
                              f"{_USUAL} --supply 6bar --stop 45deg --rate 200 --limb-mass 1kg --limb-distance 12cm "
                              "--limb-hanging=-40deg")),
    Described("bench", _valve("pulley", "MAS-20", "MPYE-5-1/8-LF", f"{_USUAL} --supply 6bar --stop none --rate 1000")),
    Described("crank", _valve("lever", "DMSP-20", "MPYE-5-1/8-HF", f"{_USUAL} --supply 6bar --stop 30deg --rate 500")),
    Described("knee", _valve("pulley", "DMSP-40", "MPYE-5-1/4", f"{_LARGE} --supply 6bar --stop 40deg --rate 250")),
    Described("hip", _valve("lever", "MAS-40", "MPYE-5-3/8", f"{_LARGE} --supply 6bar --stop none --rate 500")),
    Described("drum", _regulator("pulley", "DMSP-10", "VEAA-D9", 0.08, _DRUM)),
    Described("hand", _regulator("lever", "MAS-10", "ITV1050", 0.15, f"{_SMALL} --supply 8bar --stop none --rate 50")),
    Described("arm", _regulator("pulley", "DMSP-20", "VPPM-0L6H", 0.1, _ARM)),
    Described("crane", _regulator("lever", "MAS-20", "ITV2050", 0.2, f"{_USUAL} --supply 7bar --stop 30deg --rate 50")),
    Described("leg", _regulator("pulley", "DMSP-40", "VEAA-D11", 0.25, _LEG)),
)  # fmt: skip
"""Every muscle and valve of the lists, levers and pulleys, with and without a stop, valves and regulators."""


def written(described: Described, path: Path) -> Rig:
    """Type a description into ``new_rig``.

    Args:
        described: the rig.
        path: new file.
    """
    if new_rig.main(["--out", str(path), "--name", described.name, *described.words.split()]) != 0:
        raise BadInput(f"{described.name}: new_rig refuses it")
    return load_rig(path, regulators=True)


def drawn(rig: Rig, seed: int) -> Rig:
    """A joint that a guessed rig file may be of.

    What could not be driven at all is drawn again: a joint that no pressures bring to its middle and to a third of its
    range either way.

    Args:
        rig: made by ``new_rig``.
        seed: of the draw.
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


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("rehearse_new_rigs", _DESCRIPTION, _EXAMPLES)
    out.add_argument("--out", required=True, type=Path, metavar="DIR", help="folder of the results; may exist")
    out.add_argument("--rig", action="append", metavar="NAME", help="this rig only; may be given several times")
    out.add_argument("--docs", type=Path, metavar="FILE", help="write the table as Markdown; FILE is replaced")
    return out


def main(argv: list[str] | None = None) -> int:
    """Run the command; the result is its exit status."""
    return common.run(parser, _main, argv)


def _main(arguments: argparse.Namespace) -> int:
    found = []
    for number, described in enumerate(DESCRIBED):
        if arguments.rig and described.name not in arguments.rig:
            continue
        folder = arguments.out / described.name
        if not (folder / "outcome.json").exists():
            write_json(folder / "outcome.json", rehearsed(described, number, folder))
        found.append(json.loads((folder / "outcome.json").read_text(encoding="utf-8")))
    if arguments.docs is not None:
        common.write_text(arguments.docs, "\n".join(markdown(table(found))) + "\n")
    print(terminal.table(table(found), indent=""))
    return common.DONE


def rehearsed(described: Described, seed: int, folder: Path) -> dict[str, Any]:
    """Commission a rig, and what came of it.

    Args:
        described: the rig.
        seed: of the joint.
        folder: of the rehearsal.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / "truth.yaml").exists():
        write_rig(drawn(written(described, folder / "rig.yaml"), seed), folder / "truth.yaml")
    out = folder / "commissioned"
    given = ["--rig", str(folder / "rig.yaml"), "--plant", str(folder / "truth.yaml"), "--out", str(out)]
    status = commission.main([*given, "--mismatch", "0", "--source", "rehearsal", "--unattended"])
    steps = json.loads((out / "state.json").read_text(encoding="utf-8"))["steps"]
    outcome = {
        "rig": described.name,
        "status": status,
        "said": next(
            (step["said"] for step in steps.values() if not step["done"]), steps.get("identify", {}).get("said", "")
        ),
        "rig_s": sum(step.get("rig_s", 0.0) for step in steps.values()),
        "beyond_deg": _beyond(out) if steps.get("quick", {}).get("done") else None,
    }
    return {**outcome, **(controlled(folder) if status == common.DONE else {})}


def _beyond(out: Path) -> float:
    """By how much the angle of the quick moves left its limit [deg]; below 0 within it."""
    (bag,) = out.glob("quick_*/bag")
    limit = json.loads((bag.parent / "plan.json").read_text(encoding="utf-8"))["limits"]["angle_rad"]
    angle = read_bag(bag, judge=False).angle
    assert angle is not None
    # The muscles are filled first; the joint hangs as it likes until then.
    moves = round(_MOVES_S / load_rig(out.parent / "rig.yaml", regulators=True).sample_period)
    return math.degrees(float(np.max(np.abs(angle[-moves:]))) - limit)


def controlled(folder: Path) -> dict[str, Any]:
    """Steps of the angle, as a demo asks for them, on the joint with the rig and the gains that came out.

    Args:
        folder: of the rehearsal.
    """
    rig, joint = (
        load_rig(folder / name, regulators=True) for name in (Path("commissioned", "rig.yaml"), Path("truth.yaml"))
    )
    p, period = rig.parameters(), rig.sample_period
    box = Box.of(p)
    command = (rest_pressure(rig),) * 2 if rig.drive == "regulator" else rest_voltage(rig)
    law = ModelController(
        p, box, gains_for(rig), sample_period=period, limits=VoltageLimits(*rig.command_limits), safe_voltage=command
    )
    laws = Laws(None, law, Reachable(p, box), MODEL, None)
    largest = max(value for _, value, _ in task(rig, Mode.ANGLE, MODEL, 20.0).references)
    values = [0.0, largest, -largest, 0.5 * largest]
    wanted = held(Mode.ANGLE, [(_HOLD_S, value, math.nan) for value in values], period)
    plant, estimator, angles = Plant(joint, seed=_SEED), Estimator(rig, "default", "free"), []
    for k, reference in enumerate(wanted):
        sample = plant.step(command)
        row = estimator.step((k + 1) * round(period * 1e9), *sample.pressure, *sample.voltage)
        assert row is not None
        command = laws.step(reference, seen(row)).voltage
        # The rig's angle is what the encoder shows, less its zero.
        angles.append(float(sample.truth[0]) - rig.calibration.encoder_zero)
    size, last = len(wanted) // len(values), round(_LAST_S / period)
    ends = [np.array(angles[(k + 1) * size - last : (k + 1) * size]) - value for k, value in enumerate(values)]
    span = 2.0 * math.degrees(angle_range(rig))
    return {
        "angle_error_deg": math.degrees(max(float(np.sqrt(np.mean(end**2))) for end in ends)),
        "allowed_deg": max(_ALLOWED_DEG, _ALLOWED_SHARE * span),
        "step_deg": math.degrees(largest),
    }


def table(found: Sequence[dict[str, Any]]) -> Table:
    """A row a rig.

    Args:
        found: outcomes.
    """
    rows = []
    for one in found:
        error = one.get("angle_error_deg")
        said = "-" if error is None else f"{error:.2f} of {one['allowed_deg']:.2f}"
        beyond = one["beyond_deg"]
        kept = "-" if beyond is None else "yes" if beyond <= 0.0 else f"by {beyond:.1f}°"
        done = "yes" if one["status"] == common.DONE else "no"
        step = f"±{one['step_deg']:.0f}" if "step_deg" in one else "-"
        rows.append((one["rig"], done, f"{one['rig_s']:.0f}", kept, step, said, one["said"]))
    header = ("rig", "to the end", "rig time [s]", "limits kept", "steps [°]", "joint's error [°]", "said")
    return Table(header, tuple(rows))
