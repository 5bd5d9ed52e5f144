"""``python -m validation.rigs.judge``: how ``identify`` does on fresh rigs."""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pam_antagonist import identify, replay
from pam_antagonist.api.given import calibration
from pam_antagonist.errors import BadInput
from pam_antagonist.identification.from_pressures import FromPressures
from pam_antagonist.identification.unknowns import Fit
from pam_antagonist.recording import Recording
from validation.rigs import fresh, unlike

_DETERMINED = 0.5
"""A value is determined where the data leave less than half of its prior's standard deviation."""


def judged(lab: fresh.Laboratory, jobs: int = 2) -> dict[str, Any]:
    """What ``identify`` makes of a laboratory's recordings, on those of another day.

    Args:
        lab: with its recordings.
        jobs: threads.
    """
    begin = time.monotonic()
    out: dict[str, Any] = {"name": lab.name}
    try:
        result = identify(lab.fit, lab.typed, jobs=jobs)
    except BadInput as error:
        return {**out, "refused": str(error)}
    found = result.found
    assert isinstance(found, FromPressures)
    out["seconds"] = time.monotonic() - begin
    out["rejected"] = found.rejected
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
            "coverage": now.ukf.angle.coverage95,
        }
        for name, value in parts.items():
            errors.setdefault(name, []).append((value, len(recording)))
    out["held"] = {name: _pooled(values, name == "coverage") for name, values in errors.items()}
    out["range_deg"] = math.degrees(max(float(np.ptp(one.angle)) for one in lab.held if one.angle is not None))
    out["values"] = {} if not lab.truth else {**compared(found.joint, lab.truth), **compared(found.air, lab.truth)}
    out["notes"] = list(found.notes)
    return out


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


def compared(fit: Fit | None, truth: dict[str, float]) -> dict[str, dict[str, float]]:
    """How far the determined values are from the true ones, in standard errors, by name."""
    out = {}
    for k, item in enumerate(fit.unknowns if fit else ()):
        assert fit is not None
        std = math.sqrt(fit.covariance[k, k])
        if std < _DETERMINED and item.name in truth:
            out[item.name] = {"z": float((item.amount(truth[item.name]) - fit.amounts[k]) / std), "std": std}
    return out


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="file of the results (JSON)")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--count", type=int, default=20, help="number of rigs")
    parser.add_argument("--unlike", action="store_true", help="rigs of a simulator with other laws")
    arguments = parser.parse_args()
    results = []
    for seed in range(arguments.first, arguments.first + arguments.count):
        results.append(judged((unlike if arguments.unlike else fresh).laboratory(seed)))
        print(_line(results[-1]), flush=True)
        arguments.out.write_text(json.dumps(results, indent=1))
    print(_total(results))


def _line(one: dict[str, Any]) -> str:
    if "refused" in one:
        return f"{one['name']}: refused: {one['refused']}"
    held, inside = one["held"], [abs(value["z"]) <= 1.96 for value in one["values"].values()]
    far = sorted(one["values"].items(), key=lambda item: -abs(item[1]["z"]))[:2]
    worst = ", ".join(f"{name} {value['z']:.1f}" for name, value in far)
    return (
        f"{one['name']}: {held['identified']:.3f} deg of {one['range_deg']:.0f} (before {held['as_configured']:.2f}, "
        f"alone {held['model_alone']:.2f}, linear {held['linear']:.2f}, pressures {one['own']['pressures_alone']:.3f}, "
        f"own {one['own']['identified']:.3f}) covered {held['coverage']:.2f}; true {sum(inside)}/{len(inside)} "
        f"{worst}; {one['seconds']:.0f} s"
        f"{' REJECTED ' + one['rejected'][:60] if one['rejected'] else ''}"
    )


def _total(results: Sequence[dict[str, Any]]) -> str:
    done = [one for one in results if "held" in one]
    held = [one["held"] for one in done]
    inside = [abs(value["z"]) <= 1.96 for one in done for value in one["values"].values()]
    counts = {
        "covered 85 to 99 %": sum(0.85 <= one["coverage"] <= 0.99 for one in held),
        "not worse than the linear map": sum(one["identified"] <= one["linear"] for one in held),
        "not worse than the model alone": sum(one["identified"] <= one["model_alone"] for one in held),
        "not worse than the file of new_rig": sum(one["identified"] <= one["as_configured"] for one in held),
        "rejected": sum(bool(one["rejected"]) for one in done),
    }
    median = np.median([one["identified"] / one["range_deg"] for one in [{**a, **a["held"]} for a in done]])
    return "\n".join(
        [
            f"{len(done)} rigs of {len(results)}; median error {100 * median:.2f} % of the range",
            *(f"{name}: {count}" for name, count in counts.items()),
            f"true values in their 95 % intervals: {sum(inside)} of {len(inside)}",
        ]
    )


if __name__ == "__main__":
    main()
