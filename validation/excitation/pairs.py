"""``tell_apart``: whether a designed experiment tells effects apart that the catalogue lists as hard to tell."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from pam_antagonist.api.diagnose import DiagnoseResult, diagnose
from pam_antagonist.api.simulate import simulate
from pam_antagonist.cli import common
from pam_antagonist.cli.numbers import whole
from pam_antagonist.design import Limits
from pam_antagonist.design.apart import LIKELY, imitation, instead_of, told_apart
from pam_antagonist.errors import BadInput
from pam_antagonist.inference.free_parameters import Candidate, moved
from pam_antagonist.inference.trial import CHANNELS
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.report import terminal
from pam_antagonist.report.table import Table, percent
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.simulation import excitation
from validation.battery.draw import LARGE
from validation.excitation.sizes import Sizes

_DESCRIPTION = """\
Test whether designed experiments distinguish the pairs of effects that the catalogue lists as easy to confuse.

In each pair, a simulated joint has the first effect at its usual size, or the second one at the size at which it
imitates the first. A usual size below four noises of a sample is enlarged to these, since close_loop finds no smaller
effects. If the second effect hardly imitates the first, the joint has the second one at its own usual size. The joint's
parameters differ from the rig file by 1 %. An experiment is designed under which both effects differ most. close_loop
gets its recording, and one of steps (20 s). A verdict is right if it names the true effect first.
"""
_EXAMPLES = """\
examples:
  {run} tell_apart --pair hysteresis:friction --seeds 2
"""
_FIRST_S = 20.0
_MISMATCH = 0.01


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("tell_apart", _DESCRIPTION, _EXAMPLES)
    out.add_argument("--rig", default="shin2022", metavar="RIG", help="the rig file (default: shin2022)")
    out.add_argument(
        "--pair", action="append", metavar="A:B", help="test this pair of effects only; may be given several times"
    )
    out.add_argument("--seeds", type=whole(1, 100), default=10, metavar="N", help="joints for each pair (default: 10)")
    out.add_argument(
        "--without", action="append", default=[], choices=("angle", "torque"),
        help="design without this sensor, and name a sensor that would decide if no experiment can; with --plan-only",
    )  # fmt: skip
    out.add_argument(
        "--plan-only", action="store_true", help="only print what the designs promise; do not run close_loop"
    )
    common.add_new_json(out, "the figures")
    return out


def listed() -> list[tuple[str, str]]:
    """Pairs of which an entry of the catalogue says what distinguishes them, each once."""
    found = {
        tuple(sorted((name, other)))
        for name, effect in CATALOGUE.items()
        for other in effect.distinguished_by
        if other in CATALOGUE and _tested(name) and _tested(other)
    }
    return sorted((one, other) for one, other in found)


def _tested(name: str) -> bool:
    return CATALOGUE[name].deterministic and "valve" in CATALOGUE[name].tested_with


def usual(rig: Rig, effect: str) -> Rig:
    """A rig with an effect at its usual size, or as large as ``close_loop`` finds it: four noises of a sample.

    Args:
        rig: without it.
        effect: its name.
    """
    free = Candidate(effect).free

    def joint_with(factor: float) -> Rig:
        sizes = {p: f.bounded(factor * f.item.scale) for f in free if f.item.is_size for p in f.paths}
        return moved(rig, {**{p: f.item.neutral for f in free if not f.item.is_size for p in f.paths}, **sizes})

    sizes = Sizes(rig, np.random.default_rng(0))
    joint = joint_with(1.0)
    return joint if sizes.of(joint) >= LARGE else sizes.reached(joint_with, LARGE)[0]


def main(argv: list[str] | None = None) -> int:
    """Run the command; the result is its exit status."""
    return common.run(parser, _main, argv)


def _main(arguments: argparse.Namespace) -> int:
    if arguments.without and not arguments.plan_only:
        raise BadInput("--without: expected --plan-only as well")
    rig = load_rig(arguments.rig)
    pairs = listed() if arguments.pair is None else [_pair(text) for text in arguments.pair]
    found = []
    for pair in pairs:
        each = (
            iter([designed_only(rig, pair, arguments.without)])
            if arguments.plan_only
            else tried(rig, pair, arguments.seeds)
        )
        for one in each:
            found.append(one)
            print(_line(one), file=sys.stderr, flush=True)
    common.show("" if arguments.plan_only else terminal.table(_table(found), indent=""), found, arguments.json)
    return common.DONE


def _pair(text: str) -> tuple[str, str]:
    one, _, other = text.partition(":")
    for name in (one, other):
        if name not in CATALOGUE or not _tested(name):
            known = ", ".join(name for name in CATALOGUE if _tested(name))
            raise BadInput(f"--pair {text!r}: expected two of {known}, such as hysteresis:friction")
    return one, other


def designed_only(rig: Rig, pair: tuple[str, str], without: Sequence[str]) -> dict[str, Any]:
    """What the design for a pair promises, and what else would tell where it does not.

    Args:
        rig: the rig file.
        pair: names of both.
        without: channels that are not measured.
    """
    first, second = pair
    supposed, channels = usual(rig, first), [k for k, name in enumerate(CHANNELS) if name not in without]
    verdict = told_apart(supposed, first, [second], Limits.of(rig), channels=channels)
    instead = () if verdict.chance >= LIKELY else instead_of(supposed, first, [second], verdict, channels)
    return {
        "pair": [first, second],
        "chance": verdict.chance,
        "seconds": verdict.plan.duration,
        "instead": list(instead),
    }


def tried(rig: Rig, pair: tuple[str, str], seeds: int) -> Iterator[dict[str, Any]]:
    """One design for a pair, and what close_loop says of joints that have one of both.

    Args:
        rig: the rig file.
        pair: names of both.
        seeds: joints; every other one has the second effect.
    """
    first, second = pair
    supposed = usual(rig, first)
    rival = imitation(supposed, first, second)
    if Sizes(rig, np.random.default_rng(0)).of(rival) < LARGE:
        rival = usual(rig, second)
    verdict = told_apart(supposed, first, [second], Limits.of(rig))
    plan = verdict.plan
    promise = {"pair": [first, second], "chance": verdict.chance, "seconds": plan.duration}
    for seed in range(1, seeds + 1):
        truth = first if seed % 2 else second
        joint = supposed if truth == first else rival
        steps = excitation.profile("steps", _FIRST_S, rig.sample_period, seed)
        recordings = [
            simulate(joint, voltage, seed=seed, mismatch=_MISMATCH, path=name)
            for name, voltage in (("steps", steps), ("designed", plan.voltage))
        ]
        found = diagnose(recordings, rig, profiles=False, estimator=False)
        assert isinstance(found, DiagnoseResult)
        yield {
            **promise,
            "seed": seed,
            "truth": truth,
            "found": [effect.name for effect in found.effects],
            "ambiguous": list(found.ambiguous_with),
        }


def _line(one: dict[str, Any]) -> str:
    first, second = one["pair"]
    text = f"{first} or {second}: {percent(one['chance'])} in {one['seconds']:.0f} s"
    if one.get("instead"):
        text += f"; this would decide: {'; '.join(one['instead'])}"
    if "truth" in one:
        text += f"; seed {one['seed']}: {one['truth']} is there, found {' '.join(one['found']) or 'none'}"
    return text


def _table(found: Sequence[dict[str, Any]]) -> Table:
    rows = []
    for pair in dict.fromkeys(tuple(one["pair"]) for one in found):
        here = [one for one in found if tuple(one["pair"]) == pair]
        right = sum(one["found"][:1] == [one["truth"]] for one in here)
        promised = float(np.mean([one["chance"] for one in here]))
        cells = (percent(promised), f"{here[0]['seconds']:.0f}", f"{right} of {len(here)}")
        rows.append((" or ".join(pair), *cells))
    return Table(("effects", "promised", "length [s]", "right first"), tuple(rows))
