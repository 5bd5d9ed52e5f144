"""``rigs``: how ``identify`` does on fresh rigs: errors, coverage, and true values within their intervals."""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pam_antagonist import identify, replay
from pam_antagonist.api.given import calibration
from pam_antagonist.cli import common
from pam_antagonist.errors import BadInput
from pam_antagonist.identification.from_pressures import FromPressures
from pam_antagonist.inference.unknowns import Fit
from pam_antagonist.recording import Recording
from validation.battery.scores import interval
from validation.rigs import fresh

_DESCRIPTION = """\
Identify fresh virtual rigs from a few minutes of recordings, and judge the result on recordings of another day.

The rigs are of this package's own model, with values drawn from the priors of identify. Each line has the filter's
error, those of the rig file, the model alone and a linear map of the two pressures, the share of angles in their 95 %
intervals, and how many values that identify calls determined have their true value in their 95 % interval. Half of the
rigs have hysteresis that nobody declared (--declared: none).
It takes half a minute for each rig.
"""
_EXAMPLES = """\
examples:
  {run} rigs --out fresh.json --declared
"""


def judged(lab: fresh.Laboratory, jobs: int = 2) -> dict[str, Any]:
    """What ``identify`` makes of a laboratory's recordings, on those of another day."""
    try:
        return {"name": lab.name, **_judged(lab, jobs)}
    except BadInput as error:
        return {"name": lab.name, "refused": str(error)}


def _judged(lab: fresh.Laboratory, jobs: int) -> dict[str, Any]:
    begin = time.monotonic()
    result = identify(lab.fit, lab.typed, jobs=jobs)
    found = result.found
    assert isinstance(found, FromPressures)
    if found.rejected:
        return {"refused": found.rejected}
    out: dict[str, Any] = {"seconds": time.monotonic() - begin}
    out["own"] = {name: found.pooled(name) for name in _COLUMNS} | {"coverage": found.coverage}
    errors: dict[str, list[tuple[float, int]]] = {}
    for recording in lab.held:
        now, before = (replay(calibration(rig).applied(recording), rig).report for rig in (result.rig, lab.typed))
        assert now.ukf.angle is not None and before.ukf.angle is not None and now.model_alone.angle is not None
        parts = {
            "identified": now.ukf.angle.rmse,
            "as_configured": before.ukf.angle.rmse,
            "model_alone": now.model_alone.angle.rmse,
            "linear": linear(lab.fit, recording),
            "coverage": now.ukf.angle.coverage95 or math.nan,
        }
        for name, value in parts.items():
            errors.setdefault(name, []).append((value, len(recording)))
    out["held"] = {name: _pooled(values, name == "coverage") for name, values in errors.items()}
    out["range_deg"] = math.degrees(max(float(np.ptp(one.angle)) for one in lab.held if one.angle is not None))
    out["values"] = {name: z for fit in found.fits for name, z in compared(fit, lab.truth).items()}
    out["notes"] = list(found.notes)
    return out


_NORMAL = 1.96
_COLUMNS = ("identified", "as_configured", "model_alone", "pressures_alone", "linear")


def _pooled(values: Sequence[tuple[float, int]], mean: bool) -> float:
    numbers, weights = np.array(values).T
    return float(np.average(numbers, weights=weights) if mean else np.sqrt(np.average(numbers**2, weights=weights)))


def linear(fit: Sequence[Recording], held: Recording) -> float:
    """Error of a linear map of the two pressures, RMS [deg]."""
    pressure, angle = (np.concatenate([getattr(one, name) for one in fit]) for name in ("pressure", "angle"))
    found, *_ = np.linalg.lstsq(np.column_stack([pressure, np.ones(len(angle))]), angle, rcond=None)
    left = np.column_stack([held.pressure, np.ones(len(held))]) @ found - held.angle
    return math.degrees(math.sqrt(float(np.mean(left**2))))


def compared(fit: Fit, truth: dict[str, float]) -> dict[str, float]:
    """How far the determined values are from the true ones, in standard errors, by name."""
    stds, reasons = np.sqrt(np.diag(fit.covariance)), fit.reasons
    return {
        item.name: float((item.amount(truth[item.name]) - amount) / std)
        for item, amount, std in zip(fit.unknowns, fit.amounts, stds, strict=True)
        if item.name in truth and not reasons[item.name]
    }


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("rigs", _DESCRIPTION, _EXAMPLES)
    out.add_argument("--out", type=Path, required=True, metavar="FILE", help="file of the results (JSON)")
    out.add_argument("--first", type=int, default=0, metavar="SEED", help="first seed (default: 0)")
    out.add_argument("--count", type=int, default=20, metavar="N", help="number of rigs (default: 20)")
    out.flag("--declared", "rigs without effects that nobody declared")
    return out


def _run(arguments: argparse.Namespace) -> int:
    results = []
    for seed in range(arguments.first, arguments.first + arguments.count):
        results.append(judged(fresh.laboratory(seed, arguments.declared)))
        print(_line(results[-1]), flush=True)
        arguments.out.write_text(json.dumps(results, indent=1))
    print(_total(results))
    return common.DONE


def _line(one: dict[str, Any]) -> str:
    if "refused" in one:
        return f"{one['name']}: refused: {one['refused']}"
    held, inside = one["held"], [abs(z) <= _NORMAL for z in one["values"].values()]
    far = sorted(one["values"].items(), key=lambda item: -abs(item[1]))[:2]
    worst = ", ".join(f"{name} {z:.1f}" for name, z in far)
    return (
        f"{one['name']}: {held['identified']:.3f} deg of {one['range_deg']:.0f} (before {held['as_configured']:.2f}, "
        f"alone {held['model_alone']:.2f}, linear {held['linear']:.2f}, pressures {one['own']['pressures_alone']:.3f}, "
        f"own {one['own']['identified']:.3f}) covered {held['coverage']:.2f}; true {sum(inside)}/{len(inside)} "
        f"{worst}; {one['seconds']:.0f} s"
    )


def _total(results: Sequence[dict[str, Any]]) -> str:
    done = [one for one in results if "held" in one]
    if not done:
        return f"0 rigs of {len(results)}"
    held = pd.DataFrame([one["held"] for one in done]).assign(range_deg=[one["range_deg"] for one in done])
    inside = [abs(z) <= _NORMAL for one in done for z in one["values"].values()]
    low, high = interval(sum(inside), len(inside)) or (0.0, 1.0)
    counts = {"covered 85 to 99 %": held.coverage.between(0.85, 0.99)}
    others = {"linear": "linear map", "model_alone": "model alone", "as_configured": "file of new_rig"}
    for other, words in others.items():
        counts[f"not worse than the {words}"] = held.identified <= held[other]
    median = (held.identified / held.range_deg).median()
    return "\n".join(
        [
            f"{len(done)} rigs of {len(results)}; median error {100 * median:.2f} % of the range",
            *(f"{name}: {int(count.sum())}" for name, count in counts.items()),
            f"true values in their 95 % intervals: {sum(inside)} of {len(inside)} "
            f"(share {sum(inside) / max(len(inside), 1):.3f}, {low:.3f} to {high:.3f})",
        ]
    )


main = common.command(parser, _run)
