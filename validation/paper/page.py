"""The paper's experiments as a page in Markdown with pictures, and as JSON."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd

from pam_antagonist.program import versions
from pam_antagonist.report.document import MISSING, Table, markdown, number
from pam_antagonist.strict_json import write_json
from validation.paper.experiments import EXPERIMENTS, Done
from validation.paper.virtual import DECLARED, Mismatch, VirtualRig

SOURCE = (
    "T. Shin, T. Ibayashi, K. Kogiso, “Detailed Dynamic Model of Antagonistic PAM System and its Experimental "
    "Validation: Sensor-less Angle and Torque Control with UKF”, 2022"
)
CAUTION = (
    "Our numbers are of a virtual rig: the simulator of this package with declared mismatches, which model and "
    "estimator do not know. They show how models and estimators compare under these mismatches. They say nothing about "
    "a real joint. The paper's numbers are of its authors' real rig and stand beside ours for comparison only."
)
_HEADER = ("What", "Virtual rig (ours): median (range)", "Paper (real rig)", "On the difference")


def _scale(unit: str) -> tuple[float, str]:
    return (100.0 if unit == "%" else 1.0), "" if unit == "-" else unit if unit == "°" else f" {unit}"


def _ours(row: Any) -> str:
    scale, unit = _scale(row["unit"])
    middle, *ends = (number(scale * row[key]) for key in ("median", "min", "max"))
    return middle + (f" ({' … '.join(ends)})" if row["count"] > 1 else "") + unit


def _theirs(row: Any) -> str:
    scale, unit = _scale(row["unit"])
    return MISSING if pd.isna(row["paper"]) else f"{scale * row['paper']:.6g}{unit}"


def compared(done: Done, name: str) -> Table:
    """Numbers beside the paper's; 𝕀, 𝕄 and ℚ of one quantity share a row."""
    rows: list[tuple[str, ...]] = []
    for what, row in done.compared(name).astype(object).iterrows():
        before = rows[-1][0].partition(", 𝕀")[0] if rows else ""
        if str(what)[-1] in "𝕄ℚ" and rows and before == str(what)[:-3]:
            first, *cells, why = rows[-1]
            more = (_ours(row), _theirs(row))
            joined = (f"{a}, {b}" if b != MISSING else a for a, b in zip(cells, more, strict=True))
            rows[-1] = (f"{first}, {str(what)[-1]}", *joined, why)
        else:
            rows.append((str(what), _ours(row), _theirs(row), row["why"]))
    # A reason that was just given is not repeated.
    reasons = ["", *(row[-1] for row in rows)]
    rows = [(*row[:-1], "likewise" if row[-1] and row[-1] == before else row[-1])
            for row, before in zip(rows, reasons, strict=False)]  # fmt: skip
    return Table(_HEADER, tuple(rows))


def overview(done: Done) -> Table:
    """What the paper gives as a ratio or a time, in one table."""
    rows = tuple(
        (EXPERIMENTS[name].title, str(what), _ours(row), _theirs(row))
        for name in done.values
        for what, row in done.compared(name).astype(object).iterrows()
        if not pd.isna(row["paper"]) and row["unit"] in ("%", "ms")
    )
    return Table(("Experiment", *_HEADER[:3]), rows)


def write(done: Done, folder: Path, with_figures: bool) -> None:
    """Write ``paper.md``, its pictures in ``paper/``, and ``report.json`` into a folder."""
    size = Mismatch()
    seeds = f"{len(done.seeds)}, seeds {min(done.seeds)} to {max(done.seeds)}"
    about = Table(("Mismatch", "Size"), (
        ("declared rig", DECLARED),
        ("parameters", f"{100 * size.parameters:g} % standard deviation of each group (simulation/plant.py)"),
        ("valve curves", f"{100 * size.valve_curve:g} % standard deviation of each knot's open rate"),
        ("hysteresis of the force", f"{size.amplitude:g} N to either side, {100 * size.spread:g} % from muscle to "
                                    f"muscle; "
                                    "the declared rig has none"),
        ("sensors", "noise and steps of the declared rig"),
        ("virtual rigs", f"{seeds}; figures and live runs show seed {done.seeds[0]}"),
    ))  # fmt: skip
    lines = [
        "# Everything the paper shows, beside its numbers", "", f"After {SOURCE}.", "", f"**{CAUTION}**", "",
        "`./run paper --out DIR` makes all of it again: `DIR/paper.md` is this page, `DIR/report.json` has the values "
        "of",
        "every virtual rig. Median (least … largest) over the virtual rigs throughout.", "", *markdown(about), "",
    ]  # fmt: skip
    for name, values in done.values.items():
        one = EXPERIMENTS[name]
        lines += [f"## {one.title}", "", one.question, "", *markdown(compared(done, name)), ""]
        said = one.said(values)
        lines += [*(f"* {text}" for text in said), ""] if said else []
        if with_figures:
            drawn = one.figures(VirtualRig(done.seeds[0]), values)
            for label, figure in drawn.items():
                picture = folder / "paper" / f"{'_'.join(filter(None, (name, label)))}.png"
                picture.parent.mkdir(exist_ok=True)
                figure.savefig(picture, dpi=110)
                lines += [f"![{one.title}](paper/{picture.name})", ""]
    (folder / "paper.md").write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")
    content = {
        name: {
            "title": EXPERIMENTS[name].title,
            "beside_the_paper": done.compared(name).reset_index(names="what").astype(object).where(pd.notna, None)
            .to_dict("records"),
            "of_seed": values.astype(object).where(pd.notna, None).to_dict("index"),
        }
        for name, values in done.values.items()
    }  # fmt: skip
    for entry in content.values():
        entry["of_seed"] = {str(seed): values for seed, values in entry["of_seed"].items()}
    seeds_and_time = {"seeds": list(done.seeds), "seconds": done.seconds, "software": versions()}
    write_json(folder / "report.json", {"source": SOURCE, "caution": CAUTION, "experiments": content, **seeds_and_time})
