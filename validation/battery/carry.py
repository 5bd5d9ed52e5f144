"""Let close_loop meet effects that nobody has declared, and try what it proposes on a recording that it never saw.

Each case is a simulated joint that differs from the rig file by a percent, with one form of the literature, with two of
different kinds, or with none; then half of the joints are up to four percent off. A free and a locked minute are
diagnosed, in some cases a free one without a torque meter alone. A third one, free and under other voltages, is kept
from the diagnosis. On it the model alone runs with the rig as configured, recalibrated, as proposed for all recordings,
and with the free recording's own values. The excess is the square of an error over the sensor's noise, less one, as a
mean over the channels: 0 for a model that is right. It is this package's own simulator: being right here is less than
being right on a real joint.

The folder --out gets a JSON file for each finished case. The same command again continues an interrupted run. Shards
may run at the same time into one folder; the tables are of the cases that are finished.
Status: 0 whether or not the diagnosis was right, 2 bad input.

examples:
  {run} forms --out result --count 28
  {run} forms --out result --count 28 --pairs 12 --free-only 12 --nothing 12 --docs figures.md
  {run} forms --out result --shard 1/2 --jobs 1 &   {run} forms --out result --shard 2/2 --jobs 1
"""

from __future__ import annotations

import argparse
import json
import math
import os
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from typing_extensions import override

from pam_antagonist.cli import common
from pam_antagonist.cli.common import JOBS, SEED, whole
from pam_antagonist.cli.progress import counted
from pam_antagonist.diagnosis.thresholds import SHORTEST
from pam_antagonist.errors import BadInput
from pam_antagonist.recording import Recording
from pam_antagonist.report.document import MISSING, Table, Text, number, percent
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.simulation.plant import scattered
from validation import frame
from validation.battery.command import shard
from validation.battery.form import Form
from validation.battery.forms_literature import FORMS, KIND, KINDS
from validation.battery.outcomes import HOLDOUT, path_of
from validation.battery.places import LEARNED, LITERATURE, Found, found, is_place
from validation.battery.plants import DURATION, JOINTS, RIG, SPREAD, Case
from validation.battery.scores import interval

LATER = "later"
"""The third recording: the free joint under other voltages."""
SINGLE, PAIR, FREE_ONLY, NOTHING = "single", "pair", "free only", "nothing"
KINDS_OF_CASES = (SINGLE, PAIR, FREE_ONLY, NOTHING)
_FIRST = {kind: 1000 * k for k, kind in enumerate(KINDS_OF_CASES)}
_SIZES = 4.5, 14.0
_FAR = 0.04
"""Largest distance of a joint's parameters from the rig file [-], in half of the cases with nothing."""
_RIGS = ("configured", "recalibrated", "proposed", "own")
"""Rigs that are tried on the third recording. The last one has the free recording's own values."""
_ERRORS = ("as_configured", "recalibrated", "extended")
_CASES = whole(0, 1000)
_LEFT, _SEEN = 0.2, 0.5
"""An effect carries over if no more than this share of the excess is left; of an excess that is at least the other."""


@dataclass(frozen=True)
class Joint(Case):
    """One joint, whose parameters are the same in all its recordings."""

    far: bool = False  # whether its parameters are up to four percent off

    @override
    def parameters(self, joint: str) -> np.ndarray:
        declared = load_rig(RIG).parameters("locked" if joint == "locked" else "free")
        rng = super()._random("free", "base")
        # The largest of fifteen normal factors is about two standard deviations from 1.
        return scattered(declared, _FAR / 2.0 if self.far else SPREAD, rng)

    @override
    def _random(self, joint: str, what: str) -> np.random.Generator:
        if joint in JOINTS:
            return super()._random(joint, what)
        return np.random.default_rng([self.seed, len(JOINTS), ("base", "voltage", "noise").index(what), 7])

    @property
    def given(self) -> tuple[str, ...]:
        """The recordings that are diagnosed."""
        return JOINTS[:1] if self.kind == FREE_ONLY else JOINTS

    @override
    def recording(self, joint: str, duration: float = DURATION) -> Recording:
        made = super().recording(joint, duration)
        return replace(made, torque=None) if self.kind == FREE_ONLY else made


def cases(seed: int, count: int, pairs: int, free_only: int, nothing: int) -> list[tuple[int, Joint]]:
    """The joints with their numbers. More cases of a kind begin with those of fewer, and every form comes in turn."""
    wanted = dict(zip(KINDS_OF_CASES, (count, pairs, free_only, nothing), strict=True))
    if max(wanted.values()) > min(filter(None, _FIRST.values())) or not any(wanted.values()):
        raise BadInput(f"forms: {', '.join(f'{n} {kind}' for kind, n in wanted.items())}: expected 1 to 1000 of a kind")
    out = []
    for kind, many in wanted.items():
        rng, deck = np.random.default_rng([seed, _FIRST[kind]]), list[Form]()
        for k in range(many):
            chosen: list[Form] = []
            if kind != NOTHING:
                # Without a torque meter, nothing shows its errors.
                every = [form for form in FORMS if kind != FREE_ONLY or "meter" not in LITERATURE[form.effect].places]
                deck = deck or [every[i] for i in rng.permutation(len(every))]
                chosen.append(deck.pop())
            if kind == PAIR:
                others = [form for form in FORMS if KIND[form.name] != KIND[chosen[0].name]]
                chosen.append(others[int(rng.integers(len(others)))])
            out.append((_FIRST[kind] + k, _joint(_FIRST[kind] + k, kind, chosen, seed, rng)))
    return out


def _joint(index: int, kind: str, forms: Sequence[Form], seed: int, rng: np.random.Generator) -> Joint:
    effects = tuple((form.effect, int(rng.integers(1, 3)) if form.by_muscle else None) for form in forms)
    sizes = tuple(float(np.exp(rng.uniform(*np.log(_SIZES)))) for _ in forms)
    words = " + ".join(f"{name} {muscle}" if muscle else name for name, muscle in effects) or "nothing"
    own = int(np.random.SeedSequence([seed, index]).generate_state(1)[0])
    names = tuple(form.name for form in forms)
    far = kind == NOTHING and index % 2 == 1
    return Joint(f"{index:04d} {words}", kind, effects, names, own, sizes, exact=True, far=far)


def judge(joint: Joint, duration: float, jobs: int) -> dict[str, Any]:
    """What a diagnosis says of a joint, beside what is so, and what its rig is worth on the third recording."""
    from pam_antagonist import diagnose

    recordings = [joint.recording(name, duration) for name in joint.given]
    options: dict[str, Any] = {"holdout": HOLDOUT, "profiles": False}
    configured, begin = load_rig(RIG), time.monotonic()
    rigs, sentence = dict.fromkeys(_RIGS, configured), ""
    said: Any = None
    try:
        said = diagnose(recordings, RIG, jobs=jobs, seed=joint.seed % 2**31, **options)
    except BadInput as error:
        sentence = str(error)
    out = {**_truth(joint, duration), "code": frame.commit(), "seconds": time.monotonic() - begin}
    out |= {"verdict": "refused", "sentence": sentence, "found": [], "where": [], "calibrations": [], "held_out": {}}
    if said is not None:
        named = said.effects if said.verdict == "effect" else ()
        out |= {
            "verdict": str(said.verdict), "sentence": said.sentence, "next_rig": said.next_rig,
            "found": [(str(one.name), one.muscle) for one in named], "where": [found(one) for one in named],
            "calibrations": [str(item.name) for item in said.calibrations],
            "held_out": {key: _held_out(getattr(said.errors, key)) for key in _ERRORS},
        }  # fmt: skip
        rigs |= {"recalibrated": said.rig_recalibrated, "proposed": proposed(said, configured)}
        rigs["own"] = said.own[0][1] if said.own else rigs["proposed"]
    later = joint.recording(LATER, duration)
    return {**out, **{name: carried(later, rig) for name, rig in rigs.items()}}


def _truth(joint: Joint, duration: float) -> dict[str, Any]:
    return {
        "name": joint.name, "seed": joint.seed, "duration": duration, "kind": joint.kind, "far": joint.far,
        "forms": joint.form, "effects": joint.effects, "sizes": joint.sizes, "reached": joint.reached,
    }  # fmt: skip


def proposed(said: Any, configured: Rig) -> Rig:
    """The rig of the file that a diagnosis says to use next; the configured one where it says to keep that."""
    if said.next_rig is None:
        return configured
    with tempfile.TemporaryDirectory() as folder:
        said.write_rigs(Path(folder))
        return load_rig(Path(folder) / said.next_rig, regulators=True)


def _held_out(errors: Any) -> dict[str, float | None]:
    """Errors of the model alone on held-out data, by channel [deg, N m, Pa]."""
    out = {name: None if (one := getattr(errors, name)) is None else float(one.rmse) for name in ("angle", "torque")}
    return {**out, "pressure_1": float(errors.rmse_pa[0]), "pressure_2": float(errors.rmse_pa[1])}


def carried(recording: Recording, rig: Rig) -> dict[str, Any]:
    """What a rig is worth on a recording: the excess of the model alone, by channel, and the filter's coverage.

    A rig with which nothing can be computed has an infinite excess, which is written as None.
    """
    from pam_antagonist import replay

    try:
        report = replay(recording, rig).report
    except BadInput as error:
        return {"excess": None, "by_channel": {}, "coverage": None, "refused": str(error)}
    sensors, squares = load_rig(RIG).sensors, dict[str, float]()
    for name, rmse in _held_out(_Alone(report.model_alone)).items():
        if rmse is not None:
            reading = sensors.reading(name.partition("_")[0])
            noise = math.hypot(reading.std, reading.step / math.sqrt(12.0))
            squares[name] = max(((math.radians(rmse) if name == "angle" else rmse) / noise) ** 2 - 1.0, 0.0)
    angle, mean = report.ukf.angle, float(np.mean(list(squares.values())))
    coverage = None if angle is None else angle.coverage95
    return {"excess": mean if math.isfinite(mean) else None, "by_channel": squares, "coverage": coverage}


class _Alone:
    """Errors of the model alone in a replay, as those of a diagnosis have them."""

    def __init__(self, errors: Any) -> None:
        self.angle, self.torque, self.rmse_pa = errors.angle, errors.torque, errors.pressure.rmse_pa


def _is_there(name: str, one: Found, effect: tuple[str, int | None]) -> bool:
    """Whether something named may be an effect: in its place; one of the catalogue also has an argument of it."""
    known = LITERATURE[effect[0]].arguments
    return is_place(one, effect) and (name == LEARNED or not known.isdisjoint(one.arguments))


def judged(outcome: dict[str, Any]) -> dict[str, Any]:
    """A row of the tables: whether the places are right, what was named that is not there, and the excesses."""
    where = [Found(tuple(a), muscle, tuple(b)) for a, muscle, b in outcome["where"]]
    effects = [(str(name), muscle) for name, muscle in outcome["effects"]]
    false = [name for (name, _), one in zip(outcome["found"], where, strict=True)
             if not any(_is_there(name, one, effect) for effect in effects)]  # fmt: skip
    first = where if outcome["kind"] == PAIR else where[:1]
    each = (zip(some, effects, strict=True) for some in permutations(first, len(effects)))
    right = any(all(is_place(*pair) for pair in pairs) for pairs in each)
    if not effects:
        right = outcome["verdict"] == "none"
    excess = {name: math.inf if (one := outcome[name]["excess"]) is None else one for name in _RIGS}
    enough = max(_LEFT * excess["configured"], _SEEN)
    forms = outcome["forms"]
    kind = outcome["kind"] if outcome["kind"] != NOTHING else f"nothing, {100.0 * _FAR:g} % off" * outcome["far"]
    return {
        "name": outcome["name"], "forms": " + ".join(forms) or MISSING,
        "group": KIND[forms[0]] if outcome["kind"] == SINGLE else kind or NOTHING, "case": outcome["kind"],
        "sizes": " + ".join(f"{size:.1f}" for size in outcome["reached"]) or MISSING, "right": right,
        "false": bool(false), "said": _said(outcome), "coverage": outcome["proposed"]["coverage"], **excess,
        "seen": excess["configured"] >= _SEEN,
        "carries": excess["proposed"] <= enough, "own_carries": excess["own"] <= enough,
        "worse": excess["proposed"] > 1.1 * excess["configured"] + 0.1, "seconds": outcome["seconds"],
    }  # fmt: skip


def _said(outcome: dict[str, Any]) -> str:
    """What a diagnosis said, in short."""
    each = []
    for (name, muscle), (place, _, arguments) in zip(outcome["found"], outcome["where"], strict=True):
        law = f"{place[0]} by {arguments[0] if arguments else 'nothing'}" if name == "learned" else name
        each.append(f"{law} {muscle}" if muscle else law)
    return ", ".join([" + ".join(each) or outcome["verdict"], *outcome["calibrations"]])


def _share(values: pd.Series) -> str:
    """A share of cases with its 95 % interval."""
    hits, count = int(values.sum()), len(values)
    limits = interval(hits, count)
    if limits is None:
        return MISSING
    return f"{hits}/{count} ({100.0 * limits[0]:.0f} to {100.0 * limits[1]:.0f} %)"


def tables(outcomes: Sequence[dict[str, Any]]) -> list[Table]:
    """What was said by kind, what it is worth on the third recording, and the misses."""
    rows = pd.DataFrame([judged(one) for one in outcomes])
    groups = {kind: rows[rows.group == kind] for kind in dict.fromkeys([*KINDS, *rows.group])}
    groups = {kind: some for kind, some in groups.items() if len(some)}
    singles = rows[rows.case == SINGLE]
    if len(singles):
        groups = {"all singles": singles, **groups}
    said = [(kind, str(len(some)), _share(some.right), _share(some.false), number(some.seconds.median(), 2))
            for kind, some in groups.items()]  # fmt: skip
    worth = [
        (kind, *(number(some[name].median()) for name in _RIGS), _share(some.carries[some.seen]),
         _share(some.own_carries[some.seen]), _share(some.worse),
         percent(None if some.coverage.isna().all() else float(some.coverage.median())))
        for kind, some in groups.items()
    ]  # fmt: skip
    missed = rows[~rows.right | rows.false | rows.worse | (rows.seen & ~rows.carries)]
    misses = [
        (one.name, one.forms, one.sizes, one.said, "yes" if one.right else "NO",
         " → ".join(number(getattr(one, name)) for name in _RIGS))
        for one in missed.itertuples()
    ]  # fmt: skip
    legend = (
        f"Excess of the model alone on the third recording, as a median. It carries over where at most {_LEFT:.0%} of "
        f"the configured rig's is left, or {_SEEN:g}; cases with less than {_SEEN:g} as configured do not count. "
        "Worse: than as configured, by a tenth."
    )
    return [
        Table(("kind", "cases", "right place", "something false named", "seconds"), tuple(said), "What was said"),
        Table(("kind", *_RIGS, "carries over", "own carries over", "worse", "angle in 95 %"), tuple(worth),
              "What it is worth", legend=legend),
        Table(("case", "form", "size", "said", "place", " → ".join(_RIGS)), tuple(misses), "Misses", prose=True),
    ]  # fmt: skip


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("forms", __doc__)
    out.option("--out", "folder of the outcomes; may exist", Path, metavar="DIR", required=True)
    out.option("--seed", "seed of the cases (default: 1)", SEED, 1, "S")
    out.option("--count", f"cases with one form (default: {len(FORMS)}, each form once)", _CASES, len(FORMS), "N")
    out.option("--pairs", "cases with two forms of different kinds (default: 0)", _CASES, 0, "N")
    out.option("--free-only", "cases with one form and a free recording without torque alone (default: 0)", _CASES, 0,
               "N")  # fmt: skip
    out.option("--nothing", f"cases with nothing wrong, half of them up to {100.0 * _FAR:g} %% off (default: 0)",
               _CASES, 0, "N")  # fmt: skip
    out.option("--shard", "run only every K-th case, from the I-th on (default: 1/1)", shard, (1, 1), "I/K")
    out.option("--duration", f"length of a recording [s] (default: {DURATION:g})", float, DURATION, "S")
    out.option("--jobs", "threads (default: all cores)", JOBS, os.cpu_count() or 1, "N")
    frame.add_docs(out)
    return out


def _main(arguments: argparse.Namespace) -> int:
    if not SHORTEST < arguments.duration <= 3600.0:
        raise BadInput(f"--duration {arguments.duration:g}: expected more than {SHORTEST:g} s, up to 3600")
    every = cases(arguments.seed, arguments.count, arguments.pairs, arguments.free_only, arguments.nothing)
    first, shards = arguments.shard
    folder = frame.made(arguments.out)
    waiting = [one for one in every[first - 1 :: shards] if _load(folder, *one, arguments.duration) is None]
    with counted(len(waiting), "forms") as advance:
        for index, joint in waiting:
            frame.kept(path_of(folder, index), partial(judge, joint, arguments.duration, arguments.jobs))
            advance(1)
    done = [one for item in every if (one := _load(folder, *item, arguments.duration)) is not None]
    about = Text(f"{len(done)} of {len(every)} cases are finished; seed {arguments.seed}, "
                 f"commit {', '.join(sorted({one['code'] for one in done}))}.")  # fmt: skip
    frame.show([about, *(tables(done) if done else ())], arguments)
    return common.DONE


def _load(folder: Path, index: int, joint: Joint, duration: float) -> dict[str, Any] | None:
    """The outcome of a case that is done, None of one that is not; one of other cases is refused."""
    path = path_of(folder, index)
    if not path.exists():
        return None
    try:
        one: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        same = (one["name"], one["seed"], one["duration"]) == (joint.name, joint.seed, duration)
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise BadInput(f"{path}: no outcome of forms ({error}); expected one, or no such file") from None
    if not same:
        raise BadInput(
            f"{path}: is of other cases ({one['name']}, seed {one['seed']}, {one['duration']:g} s); expected "
            f"{joint.name}, seed {joint.seed}, {duration:g} s: choose a new --out"
        )
    return one


main = common.command(parser, _main)
