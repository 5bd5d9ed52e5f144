"""Follow fresh virtual rigs over days in which friction and leaks drift: what is `adapt` worth?

The rigs are those of `rigs`, without undeclared effects; those with valves leak. Each is identified from 60 s. Each day
friction and leaks have changed, and the joint is recorded for half a minute. On another recording of that day, each
line has the filter's error with the rig file of the first day, with one that was adapted day by day, and with one that
was identified anew from that day's recording alone, each with its share of angles in the 95 % interval.
It takes five minutes for each rig.

examples:
  {run} days --out days.json --first 1400 --count 6
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pam_antagonist import adapt, identify, replay
from pam_antagonist.api.given import calibration
from pam_antagonist.cli import common
from pam_antagonist.cli.common import real, whole
from pam_antagonist.errors import BadInput
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.recording import Recording
from pam_antagonist.report.identify import IdentifyResult
from pam_antagonist.rig import Rig
from validation.rigs.fresh import Kind, described, drawn, record, with_encoder

_FRICTION = (
    "friction.shaft", "effects.friction.coulomb", "effects.friction_by_pressure.slope_1",
    "effects.friction_by_pressure.slope_2",
)  # fmt: skip
_LEAKS = ("effects.leak.area_1", "effects.leak.area_2")
_WALK = {"friction": 0.15, "leak": 0.3}
"""Change in a day, as a standard deviation of the logarithm."""
_LEAK = (0.005, 0.02)
"""Of the first day, as shares of a valve's area."""
_WAYS = ("kept", "adapted", "anew")


def followed(seed: int, days: int, seconds: float) -> dict[str, Any]:
    """Errors of one rig by day and way [deg], with their coverage."""
    rng = np.random.default_rng(seed)
    kind = replace(Kind.drawn(rng), hysteresis=0.0, trials=False)
    typed = described(kind, rng, f"days_{seed}")
    true, truth = drawn(typed, kind, rng)
    true = with_encoder(true, rng)
    leaks = _LEAKS if typed.drive == "valve" else ()
    true = moved(true, {path: typed.valve_1.inflow_area * float(rng.uniform(*_LEAK)) for path in leaks})
    if leaks:
        widths = dict.fromkeys(leaks, _LEAK[1] * typed.valve_1.inflow_area)
        typed = typed.replaced(priors={**typed.priors, **widths})

    def new(rig: Rig, length: float, number: int) -> Recording:
        return record(typed, rig, truth, kind, seed, length, number)

    def identified(recording: Recording) -> IdentifyResult:
        result = identify(recording, typed, free=leaks)
        assert isinstance(result, IdentifyResult)
        return result

    first = identified(new(true, 60.0, 0))
    if first.rejected:
        raise BadInput(f"{typed.name}: {first.rejected}")
    rigs = dict.fromkeys(_WAYS, first.rig)
    rows, said = [], list[str]()
    factor = dict.fromkeys((*_FRICTION, *leaks), 0.0)
    for day in range(1, days + 1):
        together = _WALK["friction"] * float(rng.standard_normal())
        for path in factor:
            factor[path] += _WALK["leak"] * float(rng.standard_normal()) if path in leaks else together
        today = moved(true, {path: true.value(path) * math.exp(change) for path, change in factor.items()})
        fit, held = new(today, seconds, 10 * day), new(today, 30.0, 10 * day + 1)
        try:
            found = adapt(fit, rigs["adapted"])
            rigs["adapted"] = rigs["adapted"] if found.rejected else found.rig
            said += [f"day {day}: {found.rejected}"] if found.rejected else []
        except BadInput as error:
            said.append(f"day {day}: {error}")
        rigs["anew"] = identified(fit).rig
        rows.append({name: _error(held, rig) for name, rig in rigs.items()})
    return {"name": f"{typed.name} ({kind.words})", "days": rows, "said": said}


def _error(recording: Recording, rig: Rig) -> tuple[float, float]:
    """Error of the filter's angle, RMS [deg], and the share of angles in their 95 % intervals."""
    angle = replay(calibration(rig).applied(recording), rig).report.ukf.angle
    assert angle is not None
    return angle.rmse, angle.coverage95 or math.nan


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("days", __doc__)
    out.add_argument("--out", type=Path, required=True, metavar="FILE", help="file of the results (JSON)")
    out.option("--first", "first seed (default: 1400)", whole(0, 10**9), 1400, "SEED")
    out.option("--count", "number of rigs (default: 6)", whole(1, 1000), 6, "N")
    out.option("--days", "days of each rig (default: 10)", whole(1, 100), 10, "N")
    out.option("--seconds", "recorded each day (default: 30)", real(10.0, 600.0, "a time"), 30.0, "S")
    return out


def _run(arguments: argparse.Namespace) -> int:
    results = []
    for seed in range(arguments.first, arguments.first + arguments.count):
        try:
            results.append(followed(seed, arguments.days, arguments.seconds))
        except BadInput as error:
            print(f"{seed}: refused: {error}", flush=True)
            continue
        print(_line(results[-1]), flush=True)
        arguments.out.write_text(json.dumps(results, indent=1))
    if results:
        print(_total(results))
    return common.DONE


def _pooled(one: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """Error over all days, RMS [deg], and coverage, by way."""
    rows = {name: np.array([day[name] for day in one["days"]]) for name in _WAYS}
    return {name: (float(np.sqrt(np.mean(r[:, 0] ** 2))), float(np.mean(r[:, 1]))) for name, r in rows.items()}


def _line(one: Mapping[str, Any]) -> str:
    each = ", ".join(f"{name} {error:.3f} deg ({share:.0%})" for name, (error, share) in _pooled(one).items())
    return "; ".join([f"{one['name']}: {each}", *one["said"]])


def _total(results: list[dict[str, Any]]) -> str:
    errors = pd.DataFrame([{name: error for name, (error, _) in _pooled(one).items()} for one in results])
    near = int((errors.adapted <= 1.2 * errors.anew).sum())
    worse = int((errors.adapted > errors.kept).sum())
    ratio = errors.div(errors.anew, axis=0).median()
    return (
        f"{len(results)} rigs: adapted {ratio.adapted:.2f} times the error of anew (median), kept {ratio.kept:.2f}; "
        f"adapted at most 1.2 times anew: {near}; worse than kept: {worse}"
    )


main = common.command(parser, _run)
