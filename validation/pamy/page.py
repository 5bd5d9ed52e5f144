"""The page of the measured arm, ``docs/pamy.md``: sentences that hold for any result, and its tables."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from pam_antagonist.diagnosis.episodes import EpisodeDiagnosis, Row
from pam_antagonist.identification.regulators import RegulatorsFound
from pam_antagonist.inference.bootstrap import Interval
from pam_antagonist.inference.pressure_driven import PressureDriven
from pam_antagonist.optional import install
from pam_antagonist.report import episodes as report
from pam_antagonist.report.document import Table, number, percent
from pam_antagonist.report.history import HistoryResult
from pam_antagonist.report.identify_episodes import interval, regulators_sentences, regulators_table
from validation.pamy import network

_ADDRESS = "https://github.com/ALRhub/action-conditional-rkn"
_HEAD = """\
# The measured arm

This page is written by a command. Its data are third-party data (MIT licence; whether those who recorded them chose
that licence is not confirmed) and no part of this package: `data/PAMData/Data2` of
[ALRhub/action-conditional-rkn]({address}) at commit 7a8ae18, joint 0, as a CSV file with the columns of
[`pamy_joint0.yaml`](../config/maps/pamy_joint0.yaml). A real arm with eight muscles was recorded on 2019-08-07 while a
policy learnt table tennis. Each episode takes about a second and begins at rest. Pressures are normalised, no torque
and no valve signal were recorded, and the setpoints were rebuilt from the policy's actions.

```text
./run pamy pamy_joint0.csv --out result --docs docs/pamy.md
```

The same report by the commands that a laboratory would type:

```text
./run import_csv pamy_joint0.csv --map pamy_joint0 --out arm
./run close_loop arm --rig regulator_joint --also joint1_p1 --also joint1_p2 --out found
```
"""
_RULES = """\
## What was chosen with these data in view

The form of the model, the candidates, and that friction may go with signals come from a first look at these data.
Errors of later episodes were in view when the directions of the force map were chosen, when the smallest share of last
episodes (1/16) was added, and when it was decided that numbers along lines keep their last values. That laws
of damping, of lagging pressures and of the time since the start are offered, and at what shares laws are taken, comes
from a first look at these data too; which of them are taken was decided within the fitted episodes. The interval takes
residuals of fitted episodes from a fit without each of them, since it held 89.5 % of later episodes before. The rule
that an effect removes 5 % of what is left is that of joints with valves. The rule of 1 % of what there was comes from a
simulated joint.

## What is not shown

Torque in N m, areas and stiffness in N m/rad cannot be known without a torque or an inertia. That friction depends on
the other joint's pressures is a correlation in recordings of a policy, not an experiment: hold that joint at two
pressures to find out. What depends on the time since the start stands for what nobody measured: the policy moves the
other joints by time.
"""


@dataclass(frozen=True, eq=False)
class ArmResult:
    """All that the page shows.

    Attributes:
        found: the diagnosis.
        joint: the episodes.
        baselines: models without physics.
        trees: whether boosted trees are among them.
        commanded: error [deg] on later episodes of the extended model with the regulators' pressures in the place of
            the measured ones.
        regulators: fitted to the episodes that may be fitted.
        took: seconds.
        network: the recurrent network; None without torch.
        book: the log book of the parts of the day.
    """

    found: EpisodeDiagnosis
    joint: PressureDriven
    baselines: tuple[Row, ...]
    trees: bool
    commanded: Interval
    regulators: RegulatorsFound
    took: float
    network: Row | None = None
    book: HistoryResult | None = None


def markdown(result: ArmResult) -> str:
    """The page."""
    found = result.found
    notes = _list(item.text for item in report.findings(found, result.joint))
    beside = () if result.network is None else (result.network,)
    all_rows = [found.rows[0], *result.baselines, *beside, *found.rows[1:]]
    errors = report.errors_table(_with_rows(found, all_rows))
    trees = (
        ""
        if result.trees
        else f"Boosted trees are left out: scikit-learn is not installed; to get it: {install('compare')}.\n"
    )
    values = report.values_table(found, result.joint.rig)
    parts = [
        _HEAD.format(address=_ADDRESS), "## What the model lacks", report.verdict(found), notes, "## Errors",
        f"{errors.caption}. Every fit and every choice of the extended model saw the other episodes only. {trees}",
        _table(errors), _beside_the_network(result),
        "## Numbers, and their drift",
        "Torques are per inertia; a bar is one of the recording, a quarter of the normalised range.",
        f"{values.caption}.", _table(values),
        "Scores of all candidates, numbers and errors by part of the recording, and forecasts are in `report.html` and "
        "`report.json`.",
        *(() if result.book is None else ("## The day in eight parts", of_the_day(result.book))),
        "## The regulators", _regulators(result), _RULES,
        f"The command took {result.took:.0f} s.",
    ]  # fmt: skip
    return "\n\n".join(part.strip() for part in parts if part.strip()) + "\n"


def _beside_the_network(result: ArmResult) -> str:
    """How far the model is from the recurrent network, on later and on interleaved episodes."""
    found, own = result.found, result.network
    later, between = network.EARLIER if own is None else (own.later.value, (own.interleaved or own.later).value)
    whence = "" if own is not None else " in an earlier run; torch is not installed here"
    numbers = len(found.model.theta) + len(found.model.free)
    assert found.lines.interleaved is not None
    pairs = [
        (found.rows[-1].forecast.value, later, "later episodes"),
        (found.lines.interleaved.value, between, "interleaved episodes, along lines,"),
    ]
    sentences = [
        f"On {name} the model errs by {number(ours)}°, {number(abs(ours - theirs), 2)}° "
        f"{'more' if ours > theirs else 'less'} than the network."
        for ours, theirs, name in pairs
    ]
    return (
        f"A recurrent network (GRU, 2 × 64, {network.NUMBERS} numbers, fitted to the same episodes; four pressures and "
        f"the first angle in) errs by {number(later)}° on later and {number(between)}° on interleaved "
        f"episodes{whence}. The extended model has {numbers} numbers, along lines {found.points} times as many. "
        f"{' '.join(sentences)} The network gives no interval; the model's 95 % interval "
        f"holds {percent(found.coverage[0])} and {percent(found.coverage[1])} of the angles."
    )


def _with_rows(diagnosis: EpisodeDiagnosis, rows: Sequence[Row]) -> EpisodeDiagnosis:
    return replace(diagnosis, rows=tuple(rows))


def of_the_day(book: HistoryResult) -> str:
    """What the log book says."""
    said = " ".join(item.text for item in book.findings())
    table = book.values_table()
    return f"""\
`identify` of each eighth of the episodes, one after the other, with friction by pressure as the only effect: what
[`history`](how-to/history.md) says of the log book.

{_table(table)}
{table.caption}.

{said} The file has no times of day, so the episodes are taken to follow each other without a pause."""


def _regulators(result: ArmResult) -> str:
    table = regulators_table(result.regulators, result.joint.rig)
    recent = result.found.rows[-1].recent or result.found.rows[-1].later
    said = _list(regulators_sentences(result.regulators))
    return (
        f"{table.caption} ([`regulators.py`](../pam_antagonist/identification/regulators.py)). The command is `p_set`. "
        f"`identify` finds the same.\n\n{_table(table)}\n\n{said}\n\n"
        f"With these regulators' pressures in the place of the measured ones, the extended model errs by "
        f"{interval(result.commanded)}° on later episodes, with the measured ones by "
        f"{interval(recent)}°. So a filter gains {number(result.commanded.value - recent.value, 2)}° from "
        "measured pressures over commanded ones as its input, which is little."
    )


def _list(texts: Iterable[str]) -> str:
    """What was found; what was tried and left is in ``report.html``, numbers that change are in the table."""
    left = "is not needed|is left as configured|^These numbers change"
    return "\n".join(f"- {text}" for text in texts if not re.search(left, text))


def _table(table: Table) -> str:
    lines = ["| " + " | ".join(table.header) + " |", "|" + "---|" * len(table.header)]
    lines += ["| " + " | ".join(cells) + " |" for cells in table.rows]
    return "\n".join(lines)


def numbers(result: ArmResult, hashes: tuple[str, ...]) -> Mapping[str, object]:
    """What ``report.json`` holds.

    Args:
        result: the result.
        hashes: SHA-256 of the file.
    """
    return {
        **report.EpisodesDiagnoseResult(result.found, result.joint, hashes).to_json(),
        "baselines_deg": result.baselines,
        "commanded_deg": result.commanded,
        "regulators": result.regulators.to_json(),
        "took_s": result.took,
    }
