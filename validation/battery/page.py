"""The tables of a battery, as text, as a page in Markdown with a figure, and as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pam_antagonist.report.figure import Axis, Band, Figure, Heatmap, Line, Panel
from pam_antagonist.report.style import DEEP, ESTIMATE, MODEL, PALE
from pam_antagonist.report.table import MISSING, Table, markdown, number, percent
from pam_antagonist.software import versions
from validation.battery.draw import LARGE, LEVELS
from validation.battery.forms import FORMS, SINGLE, UNCATALOGUED
from validation.battery.forms_uncatalogued import LEFT
from validation.battery.outcomes import Outcome
from validation.battery.plants import DURATION
from validation.battery.remainders import OTHER, VARIATION, Remainder, group_of, is_other
from validation.battery.scores import Share, confusion, detections, scores
from validation.pictures import picture

_MARK = {True: "yes", False: "NO", None: ""}
_BLUE, _RED = "rgba(0, 114, 178, 0.15)", "rgba(213, 94, 0, 0.15)"


@dataclass(frozen=True)
class Run:
    """A battery as it was asked for, and what is done of it.

    Attributes:
        seed: of the battery.
        count: how many cases.
        nothing: how many further ones with nothing wrong.
        calibrations: how many further ones whose only fault is a calibration.
        uncatalogued: how many further ones that are outside of every law.
        duration: of a recording [s].
        effect: that all cases are of; None for all kinds.
        done: outcomes of the cases that are finished.
        remainders: of the forms, by name.
    """

    seed: int
    count: int
    nothing: int
    calibrations: int
    uncatalogued: int
    duration: float
    effect: str | None
    done: Sequence[Outcome]
    remainders: Mapping[str, Remainder]

    @property
    def asked(self) -> int:
        """How many cases there are."""
        return self.count + self.nothing + self.calibrations + self.uncatalogued


def interval_text(interval: tuple[float, float] | None) -> str:
    """An interval of a share in per cent; a dash where there is none."""
    return MISSING if interval is None else f"{100.0 * interval[0]:.1f} to {100.0 * interval[1]:.1f} %"


def _share_text(found: Share) -> str:
    return f"{found.hits}/{found.count}" if found.count else "·"


def figures_table(run: Run) -> Table:
    """The figures, with their intervals and what is wanted."""
    rows = tuple(
        (score.what, percent(score.value), interval_text(score.interval), str(score.count), score.wanted,
         _MARK[score.holds])
        for score in scores(run.done)
    )  # fmt: skip
    return Table(("figure", "measured", "95 % interval", "cases", "wanted", "holds"), rows)


def detection_table(run: Run) -> Table:
    """Right one first, of how many, against the size in noises."""
    rows = tuple(
        (
            item.effect or "all",
            *(_share_text(found) for found in item.found),
            number(item.smallest, 2),
            number(item.confusion, 2),
        )
        for item in detections(run.done)
    )
    return Table(("effect", *(f"{one:g}" for one in LEVELS), "found from", "another one first up to"), rows)


def intervals_table(run: Run) -> Table:
    """The shares of all effects together against the size, with their intervals."""
    every = detections(run.done)[-1:]
    rows = tuple(
        (f"{one:g}", percent(found.value), interval_text(found.interval), percent(other.value),
         interval_text(other.interval), str(found.count))
        for item in every
        for one, found, other in zip(LEVELS, item.found, item.confused, strict=True)
    )  # fmt: skip
    return Table(("size", "right one first", "95 % interval", "another one first", "95 % interval", "cases"), rows)


def remainders_table(found: Mapping[str, Remainder]) -> Table:
    """Beside each form its remainder, and where its mechanism is described."""
    words = {"other": "other form", "near": "near", "variation": "variation", "no law": "no law"}
    rows = tuple(
        (
            form.effect,
            form.name,
            percent(found[form.name].base_share) if form.name in found else MISSING,
            percent(found[form.name].share) if form.name in found else MISSING,
            words[group_of([form.name])],
            form.source,
        )
        for form in SINGLE
    )
    return Table(("effect", "form", "base alone leaves", "remainder", "counts as", "mechanism"), rows)


def _left() -> str:
    least, most = (limit(law for _, law, _ in LEFT.values()) for limit in (min, max))
    return f"{100.0 * least:.0f} to {100.0 * most:.0f} %"


def _form_counts() -> str:
    groups = [group_of([form.name]) for form in SINGLE]
    return (
        f"Of the {len(groups)} forms {groups.count('variation')} are variations, {groups.count('other')} are other "
        f"forms, {groups.count('near')} lie between, and {groups.count('no law')} have no law."
    )


def misses_table(run: Run) -> Table:
    """What was not right, or had something beside it that was not there."""

    def words(effects: Sequence[tuple[str, int | None]]) -> str:
        return " + ".join(f"{name} {muscle}" if muscle else name for name, muscle in effects)

    def remainder(name: str) -> str:
        return percent(run.remainders[name].share) if name in run.remainders else MISSING

    rows = tuple(
        (
            item.name,
            " + ".join(item.form) or MISSING,
            " + ".join(map(remainder, item.form)) or MISSING,
            " + ".join(f"{size:.{1 if item.effects else 3}f}" for size in item.reached or item.sizes) or MISSING,
            ", ".join([words(item.found) if item.verdict == "effect" else item.verdict, *item.calibrations]),
        )
        for item in run.done
        if not item.right or item.superfluous
    )
    return Table(("case", "form", "remainder", "size", "said"), rows)


def tables(run: Run) -> tuple[Table, ...]:
    """What a terminal shows, in order."""
    header, rows = confusion(run.done)
    return figures_table(run), Table(header, rows), detection_table(run), intervals_table(run), misses_table(run)


def detection_figure(run: Run) -> Figure:
    """Detection against size: all effects together, and each by itself."""
    *each, every = detections(run.done)
    sizes = np.array(LEVELS)
    series: list[Band | Line] = []
    parts = (("right one first", every.found, MODEL, _BLUE), ("another one first", every.confused, ESTIMATE, _RED))
    for name, shares, color, shade in parts:
        ends = np.array([part.interval or (np.nan, np.nan) for part in shares])
        values = np.array([np.nan if part.value is None else part.value for part in shares])
        series.append(Band(f"{name}, 95 % interval", sizes, 100.0 * ends[:, 0], 100.0 * ends[:, 1], shade, quiet=True))
        series.append(Line(name, sizes, 100.0 * values, color))
    by_effect = np.array([[np.nan if p.value is None else 100.0 * p.value for p in item.found] for item in each])
    names = tuple(item.effect for item in each)
    heat = Heatmap(
        np.arange(len(LEVELS), dtype=float), by_effect, names, (PALE, DEEP), (0.0, 100.0),
        "{row}: {value:.0f} %", "{value:.0f}",
    )  # fmt: skip
    share_axis = Axis("Share of cases [%]", bounds=(0.0, 100.0))
    size_axis = Axis("Size [noises]", labels=tuple(f"{one:g}" for one in LEVELS))
    return Figure(
        "Detection against size",
        "Left: all effects together, with 95 % intervals. Right: right one first, in per cent, for each effect.",
        (
            Panel(Axis("Size [noises]", log=True), share_axis, tuple(series), 260),
            Panel(size_axis, Axis(labels=names), (heat,), 28 * max(len(names), 4), "Right one first [%]"),
        ),
        beside=True,
    )


def as_json(run: Run) -> dict[str, Any]:
    """All figures for programs."""
    return {
        "seed": run.seed,
        "count": run.count,
        "nothing": run.nothing,
        "calibrations": run.calibrations,
        "uncatalogued": run.uncatalogued,
        "duration": run.duration,
        "effect": run.effect,
        "finished": len(run.done),
        "code": codes(run),
        "scores": [
            {**asdict(score), "interval": list(score.interval) if score.interval else None, "holds": score.holds}
            for score in scores(run.done)
        ],
        "levels": list(LEVELS),
        "detection": [
            {
                "effect": item.effect or "all",
                "found": [_share_json(part) for part in item.found],
                "another_first": [_share_json(part) for part in item.confused],
                "found_from": item.smallest,
                "another_first_up_to": item.confusion,
            }
            for item in detections(run.done)
        ],
        "remainders": {name: {**asdict(item), "share": item.share} for name, item in run.remainders.items()},
        "software": versions(),
    }


def _share_json(part: Share) -> dict[str, Any]:
    ends = part.interval
    return {"hits": part.hits, "count": part.count, "value": part.value, "interval": list(ends) if ends else None}


def codes(run: Run) -> list[str]:
    """Fingerprints of the programs that made the diagnoses; one where nothing was changed in between."""
    return sorted({item.code for item in run.done})


def write_page(run: Run, path: Path) -> None:
    """Write the page, and its figure into a folder of the page's name beside it."""
    image = ""
    if detections(run.done):
        folder = path.with_suffix("")
        folder.mkdir(exist_ok=True)
        (folder / "detection.png").write_bytes(picture(detection_figure(run)))
        image = f"![Detection against size]({folder.name}/detection.png)"
    path.write_text("\n".join(_page(run, image)), encoding="utf-8")


def _page(run: Run, image: str) -> list[str]:
    seconds = sorted(item.seconds for item in run.done)
    with_law = [item for item in run.done if item.kind in ("single", "pair")]
    others = [item for item in with_law if any(is_other(FORMS[name]) for name in item.form)]
    lines = [
        "# The battery",
        "",
        "How often the diagnosis is right on simulated joints whose effects are known. Made by",
        "",
        f"    {_command(run)} --docs FILE",
        "",
        "Each case is a free and a locked recording. Base parameters are scattered by 1 %, anew in each recording;",
        "sensors are noisy and have 12 bits. It is this package's own simulator: being right here is less than being",
        "right on a real joint.",
        "",
        "A *size* is the root mean square, over a minute of the free joint, by which an effect alone moves the channel",
        "that it moves most, in noises of a sample. Sizes of single effects are drawn from "
        + ", ".join(f"{one:g}" for one in LEVELS) + ".",
        f"Unless a figure says otherwise it counts effects of {LARGE:g} noises or more, as do pairs and what is in no",
        "catalogue. Intervals are 95 % intervals by Clopper and Pearson. Calibrations are zeros of 0.2 to 2° and of",
        "0.05 to 0.3 N m, and stamps of one channel that are 5 to 50 ms off; their sizes are in SI units.",
        "",
        f"{len(run.done)} of {run.asked} cases. Of the {len(with_law)} with effects of the catalogue, "
        f"{len(others)} are in forms with a remainder above 10 %. A diagnosis took "
        f"{seconds[len(seconds) // 2]:.0f} s (median), {seconds[-1]:.0f} s at most, with {_threads(run.done)} "
        f"(`--jobs`). {_code_sentence(run)}",
        "",
        *markdown(figures_table(run)),
        "",
        *([image, ""] if image else []),
        "## Forms",
        "",
        "Each effect is written in forms of its own ([`forms.py`](../validation/battery/forms.py)). The",
        "*remainder* says how much of a form the catalogue's law cannot imitate. Law and base parameters are fitted to",
        "a recording of the form without noise, by the diagnosis's own code. What they leave is given as a share of",
        "what the form did (root mean squares over all channels). Below "
        f"{100.0 * VARIATION:.0f} % a form is a variation of",
        f"the law, reported apart; above {100.0 * OTHER:.0f} % it is truly another form. Pushes have no law.",
        f"{_form_counts()} `./run battery --out DIR --remainders` lists them, with sources.",
        "",
        f"`--uncatalogued` draws from {len(UNCATALOGUED)} effects of the literature that no law of the catalogue can",
        f"imitate: the best law leaves {_left()} of what they do. They were written by another hand than the search",
        "([`forms_uncatalogued.py`](../validation/battery/forms_uncatalogued.py)). Places and arguments, which are the",
        "truth for a search, stand in [`places.py`](../validation/battery/places.py).",
        "",
        "`DIR` has each case; the command prints the confusion matrix, detection against size, and what was not right.",
        "",
        "Software: " + ", ".join(f"{name} {version}" for name, version in versions().items()) + ".",
        "",
    ]  # fmt: skip
    return lines


def _command(run: Run) -> str:
    command = f"./run battery --out DIR --count {run.count} --seed {run.seed}"
    command += f" --nothing {run.nothing}" if run.nothing else ""
    command += f" --calibrations {run.calibrations}" if run.calibrations else ""
    command += f" --uncatalogued {run.uncatalogued}" if run.uncatalogued else ""
    command += f" --effect {run.effect}" if run.effect else ""
    return command + (f" --duration {run.duration:g}" if run.duration != DURATION else "")


def _code_sentence(run: Run) -> str:
    found = codes(run)
    if len(found) == 1:
        return f"All cases were diagnosed by the same code (fingerprint {found[0]})."
    return f"The code was changed in between: the cases were diagnosed by {len(found)} versions."


def _threads(done: Sequence[Outcome]) -> str:
    least, most = (limit(item.threads for item in done) for limit in (min, max))
    return f"{least} to {most} threads" if least < most else "one thread" if most == 1 else f"{most} threads"
