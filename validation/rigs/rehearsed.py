"""Commission twelve rigs of new_rig, unattended, each on a joint that is drawn from the priors of its file.

DIR keeps a folder for each rig. A rig that has an outcome is not done again.

examples:
  {run} rehearse_new_rigs --out rehearsed
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pam_antagonist.cli import commission, common, new_rig
from pam_antagonist.cli.commission_guessed import drawn, held_angles
from pam_antagonist.cli.demo import found_gains
from pam_antagonist.control.model_law import ModelGains
from pam_antagonist.errors import BadInput
from pam_antagonist.recording import read_bag
from pam_antagonist.report.document import Table, Text
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.rig.file import write_rig
from pam_antagonist.simulation.plant import Plant
from validation import frame
from validation.battery.scores import interval

_MOVES_S = 40.0
"""[s] Of the quick moves, at the end of their recording."""


def _valve(kind: str, muscle: str, valve: str, more: str) -> str:
    return f"--kind {kind} --muscle {muscle} --drive valve --valve {valve} {more}"


def _regulator(kind: str, muscle: str, regulator: str, time: float, more: str) -> str:
    return f"--kind {kind} --muscle {muscle} --drive regulator --regulator {regulator} --regulator-time {time} {more}"


_SMALL = "--radius 14mm --nominal-length 150mm --length 137mm --inertia 0.001 --mass 0.3kg"
_USUAL = "--radius 25mm --nominal-length 300mm --length 272mm --inertia 0.02 --mass 1.5kg"
_LARGE = "--radius 45mm --nominal-length 600mm --length 545mm --inertia 0.25 --mass 5kg"
_LIMB = "--limb-mass 1kg --limb-distance 12cm --limb-hanging=-40deg"
DESCRIBED = {
    "finger": _valve("pulley", "DMSP-10", "MPYE-5-M5", f"{_SMALL} --supply 7bar --stop 35deg --rate 500"),
    "wrist": _valve("lever", "MAS-10", "shin2022", f"{_SMALL} --supply 6bar --stop 30deg --rate 1000"),
    "elbow": _valve("pulley", "DMSP-20", "own --valve-flow 60",
                    f"{_USUAL} --supply 6bar --stop 45deg --rate 200 {_LIMB}"),
    "bench": _valve("pulley", "MAS-20", "MPYE-5-1/8-LF", f"{_USUAL} --supply 6bar --stop none --rate 1000"),
    "crank": _valve("lever", "DMSP-20", "MPYE-5-1/8-HF", f"{_USUAL} --supply 6bar --stop 30deg --rate 500"),
    "knee": _valve("pulley", "DMSP-40", "MPYE-5-1/4", f"{_LARGE} --supply 6bar --stop 40deg --rate 250"),
    "hip": _valve("lever", "MAS-40", "MPYE-5-3/8", f"{_LARGE} --supply 6bar --stop none --rate 500"),
    "drum": _regulator("pulley", "DMSP-10", "VEAA-D9", 0.08, f"{_SMALL} --supply 7bar --stop 35deg --rate 100"),
    "hand": _regulator("lever", "MAS-10", "ITV1050", 0.15, f"{_SMALL} --supply 8bar --stop none --rate 50"),
    "arm": _regulator("pulley", "DMSP-20", "VPPM-0L6H", 0.1, f"{_USUAL} --supply 6bar --stop 40deg --rate 100"),
    "crane": _regulator("lever", "MAS-20", "ITV2050", 0.2, f"{_USUAL} --supply 7bar --stop 30deg --rate 50"),
    "leg": _regulator("pulley", "DMSP-40", "VEAA-D11", 0.25, f"{_LARGE} --supply 8bar --stop 40deg --rate 100"),
}  # fmt: skip
"""What a laboratory types into ``new_rig`` beside the name.

Every muscle and valve of the lists, levers and pulleys, with and without a stop, valves and regulators.
"""


def written(name: str, path: Path) -> Rig:
    """Type a description into ``new_rig``."""
    if new_rig.main(["--out", str(path), "--name", name, *DESCRIBED[name].split()]) != 0:
        raise BadInput(f"{name}: new_rig refuses it")
    return load_rig(path, regulators=True)


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("rehearse_new_rigs", __doc__)
    out.add_argument("--out", required=True, type=Path, metavar="DIR", help="folder of the results; may exist")
    out.add_argument("--rig", action="append", metavar="NAME", help="this rig only; may be given several times")
    draw = "draw of the joints, from 0 (default: 0); may be given several times"
    out.add_argument("--seed", action="append", type=int, metavar="N", help=draw)
    frame.add_docs(out, "the table")
    return out


def _main(arguments: argparse.Namespace) -> int:
    found = []
    for draw in arguments.seed or [0]:
        for number, name in enumerate(DESCRIBED):
            if arguments.rig and name not in arguments.rig:
                continue
            folder, seed = frame.made(arguments.out / f"{name}_{draw}"), len(DESCRIBED) * draw + number
            kept = frame.kept(folder / "outcome.json", partial(rehearsed, name, seed, folder))
            found.append({"draw": draw, **kept})
    frame.show([table(found), *map(Text, summary(found))], arguments)
    return common.DONE


def rehearsed(name: str, seed: int, folder: Path) -> dict[str, Any]:
    """Commission a rig, and what came of it."""
    if not (folder / "truth.yaml").exists():
        write_rig(drawn(written(name, folder / "rig.yaml"), seed), folder / "truth.yaml")
    out = folder / "commissioned"
    given = ["--rig", str(folder / "rig.yaml"), "--plant", str(folder / "truth.yaml"), "--out", str(out)]
    status = commission.main([*given, "--mismatch", "0", "--source", "rehearsal", "--unattended"])
    steps = json.loads((out / "state.json").read_text(encoding="utf-8"))["steps"]
    failed = (step["said"] for step in steps.values() if not step["done"])
    outcome = {
        "rig": name, "status": status, "said": next(failed, steps.get("identify", {}).get("said", "")),
        "rig_s": sum(step.get("rig_s", 0.0) for step in steps.values()),
        "beyond_deg": _beyond(out) if steps.get("quick", {}).get("done") else None,
    }  # fmt: skip
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
    """Steps of the angle, as a demo asks for them, on the joint with the rig and the gains that came out."""
    rig, joint = (load_rig(folder / name, regulators=True) for name in ("commissioned/rig.yaml", "truth.yaml"))
    given = found_gains(str(folder / "commissioned" / "parameters.yaml"))
    gains = ModelGains(given["pressure_bandwidth"], given["model_integral"], given["approach"])
    # The rig's angle is what the encoder shows, less its zero.
    held = held_angles(rig, Plant(joint, seed=1), gains, rig.calibration.encoder_zero)
    angles = {"angle_error_deg": held.error, "allowed_deg": held.allowed, "step_deg": held.largest}
    return {name: math.degrees(angle) for name, angle in angles.items()}


def table(outcomes: Sequence[dict[str, Any]]) -> Table:
    """A row a rig and draw."""
    rows = []
    for one in outcomes:
        error, allowed = (f"{one[name]:.2f}" if name in one else "-" for name in ("angle_error_deg", "allowed_deg"))
        beyond = one["beyond_deg"]
        kept = "-" if beyond is None else "yes" if beyond <= 0.0 else f"by {beyond:.1f}°"
        done = "yes" if one["status"] == common.DONE else "no"
        rows.append((one["rig"], str(one["draw"]), done, f"{one['rig_s']:.0f}", kept, error, allowed))
    header = ("rig", "draw", "to the end", "rig time [s]", "limits kept", "joint's error [°]", "allowed [°]")
    return Table(header, tuple(rows))


def summary(outcomes: Sequence[dict[str, Any]]) -> list[str]:
    """How many came to the end and held their angles, and why the others did not."""
    ended = [one for one in outcomes if one["status"] == common.DONE]
    held = [one for one in ended if one["angle_error_deg"] <= one["allowed_deg"]]
    low, high = interval(len(held), len(outcomes)) or (0.0, 1.0)
    said = [f"{len(ended)} of {len(outcomes)} come to the end, {len(held)} hold their angles within what is allowed: "
            f"{len(held) / len(outcomes):.0%}, by Clopper and Pearson {low:.0%} to {high:.0%} (95 %)."]  # fmt: skip
    return said + [f"{one['rig']}, draw {one['draw']}: {one['said']}" for one in outcomes if one not in ended]


main = common.command(parser, _main)
