"""When the evidence of a monitor starts a search, and what is said after it."""

from __future__ import annotations

import datetime
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pam_antagonist.diagnosis.monitor import THRESHOLD
from pam_antagonist.diagnosis.monitor_blocks import Finding, alike
from pam_antagonist.model.effects import CATALOGUE

_SINCE = 30.0
"""[s] that a joint has to be another one before it is searched."""
_REST = (120.0, 3600.0)
"""[s] without a search after one, at first and at most; doubled where it names nothing."""
_STRONGER = 2.0
"""A search that named nothing does not hold up one with so many times its evidence."""


@dataclass(frozen=True)
class Conclusion:
    """What is said of a joint."""

    finding: Finding
    size: float
    std: float
    ambiguous_with: tuple[str, ...] = ()
    doubt: str = ""  # why it is no more than suspected; empty: the search found it

    @property
    def confirmed(self) -> bool:
        """Whether the search found it."""
        return not self.doubt

    @property
    def sentence(self) -> str:
        """It in words."""
        item, size, std, unit = self.finding.watched, self.size, self.std, self.finding.watched.unit
        since = datetime.datetime.fromtimestamp(self.finding.onset_ns * 1e-9).strftime("%H:%M:%S")
        what = "the encoder's zero is wrong"
        if item.name in CATALOGUE:
            what = CATALOGUE[item.name].in_words(item.muscle, {item.parameter: self.finding.size})
        if unit == "m2":
            size, std, unit = size * 1e6, std * 1e6, "mm2"
        text = f"{what} since {since} ± {self.finding.onset_std:.0f} s, {size:.2g} ± {std:.1g} {unit}"
        text += f"; it cannot be told from {', '.join(self.ambiguous_with)}" if self.ambiguous_with else ""
        return f"{text}; only a suspicion: {self.doubt}" if self.doubt else text


class Alarms:
    """Decides when to search, and what is said. Times are those of one clock [s], which may be any.

    `encoder`: whether the angle is measured.
    """

    def __init__(self, encoder: bool = False) -> None:
        self._encoder = encoder
        self._rest, self._in_vain = _REST[0], 0.0
        self._none_until = self._few_until = -math.inf

    def due(self, findings: Sequence[Finding], newest_ns: int, now: float) -> bool:
        """Whether a search begins.

        `newest_ns`: stamp of the newest sample.
        """
        if not findings or findings[0].evidence < THRESHOLD or now < self._none_until:
            return False
        if now < self._few_until and findings[0].evidence < _STRONGER * self._in_vain:
            return False
        return newest_ns - findings[0].onset_ns >= _SINCE * 1e9

    def concluded(self, suspect: Sequence[Finding], found: Mapping[str, Any] | None, now: float) -> Conclusion | None:
        """What is said after a search; None where it found nothing.

        `suspect`: the hypotheses when it began. `found`: parts of report.json; None: it could not be searched for.
        """
        said = None if found is None else _named(suspect, found)
        if found is None:
            said = _suspected(suspect, "no search was possible")
        elif said is not None and not self._encoder and not _is_likely(said.finding, suspect):
            # From pressures alone the search gave a leak another name; none that it gave so was right.
            said = _suspected(suspect, f"the search says {said.finding.watched.name}, the evidence does not")
        elif said is None and found["verdict"] != "none":
            said = _suspected(suspect, f"the search says {found['verdict']}")
        in_vain = found is not None and (said is None or not said.confirmed)
        self._rest = min(2.0 * self._rest, _REST[1]) if in_vain else _REST[0]
        self._in_vain = suspect[0].evidence if in_vain else 0.0
        self._none_until, self._few_until = now + _REST[0], now + self._rest
        return said


def _named(suspect: Sequence[Finding], found: Mapping[str, Any]) -> Conclusion | None:
    for effect in found["effects"] or ():
        of_it = [one for one in suspect if one.watched.name == effect["name"]]
        same = [one for one in of_it if effect["muscle"] in (None, one.watched.muscle)] or of_it
        if not same:
            continue
        item, size, std = same[0].watched, same[0].size, same[0].std
        for name, value in effect["parameters"].items():
            if name in (item.parameter, f"{item.parameter}_{item.muscle}"):
                size, std = value["value"], value["std"] or std
        return Conclusion(same[0], float(size), float(std), tuple(found["ambiguous_with"] or ()))
    first = suspect[0]
    for zero in found["calibration"] or ():
        if zero["name"] == first.watched.name:
            return Conclusion(first, float(zero["value"]), float(zero["std"] or first.std), tuple(alike(suspect)))
    return None


def _is_likely(finding: Finding, suspect: Sequence[Finding]) -> bool:
    """Whether a finding is the hypothesis with the most evidence, or cannot be told from it."""
    item, likely = finding.watched, [suspect[0].watched.name, *alike(suspect)]
    return item.name in likely or f"{item.name} {item.muscle}" in likely


def _suspected(suspect: Sequence[Finding], doubt: str) -> Conclusion:
    first = suspect[0]
    return Conclusion(first, first.size, first.std, tuple(alike(suspect)), doubt)
