"""``rehearse``: whole commissionings, unattended, of simulated joints that have an effect which nobody declared."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from pam_antagonist.cli import commission, common
from pam_antagonist.cli.numbers import whole
from pam_antagonist.control.command import Mode, VoltageLimits
from pam_antagonist.control.laws import Laws
from pam_antagonist.control.pi import Gains, PiController
from pam_antagonist.errors import BadInput
from pam_antagonist.inference.free_parameters import Candidate, moved
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.recording import read_bag
from pam_antagonist.report import terminal
from pam_antagonist.report.table import Table, markdown, number, percent
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.rig.write import write_rig
from pam_antagonist.strict_json import write_json
from validation.battery.draw import LARGE, LEVELS
from validation.battery.page import interval_text
from validation.battery.scores import share
from validation.control.loop import Course, held, run
from validation.control.trials import settling
from validation.excitation.sizes import Sizes

_DESCRIPTION = """\
Run commission on simulated joints, each with one effect of the catalogue that a joint with valves can show.

The effect has a size of the battery (4, 8 or 16 noises of a sample), in one muscle or one of its numbers by chance. The
joint's other parameters are 1 % off the rig file. commission --unattended --source rehearsal leads from the rig file to
a controlled joint. The command reports the effect that was named first, the time that the joint was driven, and whether
the measured pressures and angles kept the limits. It also reports whether the resulting controller settles: steps of 20
degrees on the same joint, by the estimate alone.

DIR keeps a folder for each joint. A joint that has a folder is not done again.
"""
_EXAMPLES = """\
examples:
  {run} rehearse --out rehearsed --effect leak
  {run} rehearse --out rehearsed --seeds 2
"""
_PAGE = """\
# Commissionings rehearsed

Whole commissionings of simulated joints that have one effect which their rig file does not declare. Made by

    {command}

Each joint has its effect in one muscle or one of its numbers, in a size of the battery where its bounds allow: 4, 8 or
16 noises of a sample, root mean square over a minute. Other parameters are 1 % off the rig file.
[`commission --unattended --source rehearsal`](how-to/commission.md) takes it from the rig file to control. The effects
are in the form of the catalogue, which is easier than another one. No real joint was commissioned yet.

*Settled after*: steps of the angle of 20° on the estimate, with the rig file and the gains that came out; the slower of
two, until within 5 % of the step. *Angle's error*: how far the joint itself is off at the end of a step. *Limits kept*:
no measured pressure or angle beyond the limits, but for three standard deviations of noise.

{summary}.

"""
MISMATCH = 0.01
"""Of the joint's parameters from the rig file."""
_HALF, _HOLD_S = math.radians(10.0), 6.0
"""Height of the controller's steps, from minus to plus [rad], and how long each is held [s]."""


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("rehearse", _DESCRIPTION, _EXAMPLES)
    out.add_argument(
        "--out",
        required=True,
        type=Path,
        metavar="DIR",
        help="folder of the results, one folder for each joint; may exist",
    )
    out.add_argument("--rig", default="shin2022", metavar="RIG", help="the rig file (default: shin2022)")
    out.add_argument(
        "--effect", action="append", metavar="NAME", help="test this effect only; may be given several times"
    )
    out.add_argument("--seeds", type=whole(1, 100), default=1, metavar="N", help="joints for each effect (default: 1)")
    out.add_argument("--docs", type=Path, metavar="FILE", help="write the table as Markdown; FILE is replaced")
    common.add_new_json(out, "the figures")
    return out


def main(argv: list[str] | None = None) -> int:
    """Run the command; the result is its exit status."""
    return common.run(parser, _main, argv)


def _main(arguments: argparse.Namespace) -> int:
    names = tried()
    if unknown := [name for name in arguments.effect or () if name not in names]:
        raise BadInput(f"--effect {unknown[0]}: expected one of {', '.join(names)}")
    rig, out = load_rig(arguments.rig), arguments.out
    out.mkdir(parents=True, exist_ok=True)
    found = []
    with common.json_alone(arguments.json):
        for seed in range(1, arguments.seeds + 1):
            for name in arguments.effect or names:
                folder = out / f"{name}_{seed}"
                if not (folder / "outcome.json").exists():
                    write_json(folder / "outcome.json", rehearsed(rig, arguments.rig, name, seed, folder))
                found.append(json.loads((folder / "outcome.json").read_text(encoding="utf-8")))
    if arguments.docs is not None:
        common.write_text(arguments.docs, "\n".join(page(found, arguments)) + "\n")
    common.show(f"{terminal.table(table(found), indent='')}\n{summary(found)}", found, arguments.json)
    return common.DONE


def tried() -> tuple[str, ...]:
    """Effects that the catalogue looks for in joints with valves, and that are no noise."""
    return tuple(name for name, effect in CATALOGUE.items() if effect.deterministic and "valve" in effect.tested_with)


def joint_with(rig: Rig, effect: str, seed: int) -> tuple[Rig, str, float]:
    """A rig with an effect of a size that the battery draws.

    Args:
        rig: without it.
        effect: its name.
        seed: of the number that is not zero, the size and the voltages by which it counts.

    Returns:
        The rig, the dotted path of that number, and the size: by how many noises of a sample the effect moves the
        channel that it moves most, root mean square over a minute of the free joint.
    """
    rng = np.random.default_rng([seed, list(CATALOGUE).index(effect)])
    chosen = Candidate(effect).sizes
    path = str(rng.choice([path for one in chosen for path in one.paths]))
    size = next(one for one in chosen if path in one.paths)
    wanted = float(rng.choice([level for level in LEVELS if level >= LARGE]))
    shapes = {one.path: one.item.neutral for one in Candidate(effect).shapes}
    if CATALOGUE[effect].form.shapes:
        shapes = {path: dict(Candidate(effect).grid()[0]).get(path, value) for path, value in shapes.items()}
    joint, reached = Sizes(rig, rng).reached(
        lambda factor: moved(rig, {**shapes, path: size.bounded(factor * size.item.scale)}), wanted
    )
    return joint, path, reached


def rehearsed(rig: Rig, name: str, effect: str, seed: int, folder: Path) -> dict[str, Any]:
    """Commission a joint, and what came of it.

    Args:
        rig: as declared.
        name: its name or file.
        effect: which the joint has.
        seed: of the joint.
        folder: of the commissioning; one that was begun is continued.
    """
    joint, path, size = joint_with(rig, effect, seed)
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / "truth.yaml").exists():
        write_rig(joint, folder / "truth.yaml")
    out = folder / "commissioned"
    given = ["--rig", name, "--plant", str(folder / "truth.yaml"), "--out", str(out), "--seed", str(seed)]
    status = commission.main([*given, "--mismatch", str(MISMATCH), "--source", "rehearsal", "--unattended"])
    steps = json.loads((out / "state.json").read_text(encoding="utf-8"))["steps"]
    last: dict[str, Any] = next(
        (steps[name] for name in ("apart", "close_loop") if "effects" in steps.get(name, {})), {}
    )
    outcome = {
        "effect": effect,
        "number": path,
        "noises": size,
        "seed": seed,
        "status": status,
        "said": next((step["said"] for step in steps.values() if not step["done"]), ""),
        "verdict": last.get("verdict", ""),
        "found": last.get("effects", []),
        "rivals": last.get("rivals", []),
        "apart": "folder" in steps.get("apart", {}),
        "rig_s": sum(step.get("rig_s", 0.0) for step in steps.values()),
        "took_s": sum(step["seconds"] for step in steps.values()),
        "beyond": beyond(out),
    }
    return {**outcome, **(controlled(joint, out, seed) if status == common.DONE else {})}


def beyond(out: Path) -> float:
    """By how much measurements left the limits of their plans, the worst of all, as a share of the limits' width.

    Noise counts: three standard deviations of a sample are allowed.

    Args:
        out: folder of a commissioning, beside the file of what the joint is.
    """
    worst, sensors = 0.0, load_rig(str(out.parent / "truth.yaml")).sensors
    for plan in out.glob("*/plan.json"):
        limits = json.loads(plan.read_text(encoding="utf-8"))["limits"]
        recording = read_bag(plan.parent / "bag", judge=False)
        low, high = limits["pressure_pa"]
        # A pressure below the least one is safe, and the vented joint of the first step is there.
        worst = max(worst, float(np.max(recording.pressure) - 3.0 * sensors.pressure_std - high) / (high - low))
        if recording.angle is not None:
            over = float(np.max(np.abs(recording.angle))) - 3.0 * sensors.angle_std - limits["angle_rad"]
            worst = max(worst, over / (2.0 * limits["angle_rad"]))
    return worst


def steps_of(joint: Rig, out: Path, seed: int) -> Course:
    """Steps of the angle with the controller of a commissioning, by the estimate of the rig that was found.

    Args:
        joint: what the joint is in truth.
        out: folder of the commissioning.
        seed: of the joint.
    """
    rig = load_rig(str(out / "rig.yaml"))
    given = yaml.safe_load((out / "parameters.yaml").read_text(encoding="utf-8"))["/**/controller"]["ros__parameters"]
    gains = {
        mode: Gains(given[f"{mode.name.lower()}_proportional"], given[f"{mode.name.lower()}_integral"], given["bias"])
        for mode in (Mode.ANGLE, Mode.TORQUE)
    }
    valves = VoltageLimits(rig.valves.voltage_min, rig.valves.voltage_max)
    laws = Laws(PiController(gains, sample_period=rig.sample_period, limits=valves), None, None)
    wanted = held(Mode.ANGLE, [(_HOLD_S, way * _HALF, math.nan) for way in (-1.0, 1.0, -1.0)], rig.sample_period)
    return run(rig, laws, wanted, seed=seed, mismatch=MISMATCH, truth=joint)


def controlled(joint: Rig, out: Path, seed: int) -> dict[str, Any]:
    """How the controller of a commissioning does on the joint.

    Args:
        joint: what the joint is in truth.
        out: folder of the commissioning.
        seed: of the joint.
    """
    course, period = steps_of(joint, out, seed), joint.sample_period
    count, settled, off = round(_HOLD_S / period), [], []
    for k, way in ((1, 1.0), (2, -1.0)):
        end = (k + 1) * count
        estimate = course.estimated_angle[k * count : end]
        settled.append(settling(estimate, way * _HALF, way * 2.0 * _HALF, period)[0])
        off.append(float(np.mean(course.angle[end - round(0.5 / period) : end])) - way * _HALF)
    slowest = max(settled)
    return {
        "settling_s": slowest if math.isfinite(slowest) else None,
        "angle_error_deg": math.degrees(max(map(abs, off))),
    }


def right(outcome: dict[str, Any]) -> bool:
    """Whether the effect that is there is named first."""
    return bool(outcome["found"][:1] == [outcome["effect"]])


def table(found: Sequence[dict[str, Any]]) -> Table:
    """A row a joint.

    Args:
        found: outcomes.
    """
    rows = []
    for one in found:
        named = " ".join(one["found"]) or one["verdict"] or "ended early"
        settles = one.get("settling_s")
        error = f"{one['angle_error_deg']:.1f}" if "angle_error_deg" in one else "-"
        rows.append(
            (
                one["number"].removeprefix("effects."), number(one["noises"], 2), "yes" if right(one) else "no", named,
                "yes" if one["apart"] else "", f"{one['rig_s']:.0f}", "no" if settles is None else f"{settles:.1f}",
                error, "yes" if one["beyond"] <= 0.0 else percent(one["beyond"]),
            )
        )  # fmt: skip
    header = (
        "effect", "noises", "right first", "named", "told apart", "rig time [s]", "settled after [s]",
        "angle's error [°]", "limits kept",
    )  # fmt: skip
    return Table(header, tuple(rows))


def summary(found: Sequence[dict[str, Any]]) -> str:
    """What counts, in a line.

    Args:
        found: outcomes.
    """
    return (
        f"right first: {sum(map(right, found))} ({interval_text(share([right(one) for one in found]).interval)}); "
        f"rig time at most {max(one['rig_s'] for one in found) / 60.0:.1f} min; "
        f"settled: {sum(one.get('settling_s') is not None for one in found)}; "
        f"limits kept: {sum(one['beyond'] <= 0.0 for one in found)}; of {len(found)} joints"
    )


def page(found: Sequence[dict[str, Any]], arguments: argparse.Namespace) -> list[str]:
    """Lines of the page in the docs.

    Args:
        found: outcomes.
        arguments: of the command.
    """
    effects = "".join(f" --effect {name}" for name in arguments.effect or ())
    command = f"./run rehearse --out DIR --seeds {arguments.seeds}{effects} --docs FILE"
    said = summary(found)
    return [*_PAGE.format(command=command, summary=said[0].upper() + said[1:]).splitlines(), *markdown(table(found))]
