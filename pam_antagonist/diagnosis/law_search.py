"""The missing laws of a model: every table at every place, by derivatives of the model.

A law is first fitted to first order, beside the base parameters, and judged on stretches of the fitted part that its
values were not fitted to. The best laws of the best places are then fitted to the recordings. They are judged so again,
and on what was held out. Where the best one leaves a clear excess, two laws at once are asked in the same way: what is
missing beside a law bends its table, and hides it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis import law_forms, thresholds
from pam_antagonist.diagnosis.law_columns import FittedRecording, LawColumns, solved
from pam_antagonist.diagnosis.law_evidence import acting, evidence_held_out, is_better, parts, with_it
from pam_antagonist.diagnosis.law_forms import SMOOTH, LawForm, nodes_of
from pam_antagonist.diagnosis.models import Model, share_of_all, without
from pam_antagonist.model.effects.learned import LAWS
from pam_antagonist.model.effects.places import SENSORS, TABLE
from pam_antagonist.rig import Rig
from pam_antagonist.rig.learned import Law, laws_of, with_law

Floats = NDArray[np.float64]

_FINER = 8
"""So many of the best laws are tried with a finer table."""
_WITH_MEMORY = 5
"""At so many of the best places laws with memory are tried."""
_FINALISTS, _IN_REACH = 4, 0.3
"""Most places whose laws are fitted to the recordings, and their least evidence as a share of the best one's."""
_BY_ANOTHER = 2
"""At so many places a law by a second argument is fitted."""
_FIRST_OF_TWO, _PAIRS = 3, 3
"""Places whose best laws are asked with a second one, and most pairs that are fitted to the recordings."""
_MOST_KEPT = 1e8
"""Most values of columns that are kept, of 4 bytes each; those of further laws are worked out again for pairs."""
_STEPS, _STEP_LENGTHS = 3, (1.0, 0.3, 0.1)
"""Most steps of a finalist's fit, and shares of a step that are tried."""
_ENOUGH = 1.0
"""A step is the last one that lowers −2 log posterior by less."""
_MOST_ALTERNATIVES = 3
_FIRST = ("angle", "velocity", "speed", "length", "length_rate", "time")
"""Of arguments that move together, those that are named first."""


class LikelyPlace(NamedTuple):
    """A place, and the evidence for the best law there."""

    name: str
    gain: float


@dataclass(frozen=True, eq=False)
class FittedLaws:
    """One law, or two at once, with their evidence."""

    groups: tuple[LawForm, ...]
    laws: tuple[Law, ...]
    smooth: tuple[float, ...]  # of each table the precision of its second differences, of what the data know of them
    gain: float  # on stretches that they were not fitted to, twice the log likelihood ratio
    model: Model = field(default_factory=Model)  # with them; empty to first order
    held_out: float = 0.0  # evidence on what was held out; 0 to first order

    @property
    def group(self) -> LawForm:
        """The form of the first one."""
        return self.groups[0]

    @property
    def law(self) -> Law:
        """The first one."""
        return self.laws[0]

    @property
    def evidence(self) -> float:
        """All evidence."""
        return self.gain + self.held_out

    @property
    def reversed(self) -> FittedLaws:
        """Two laws in the other order: the first one is that which explains more."""
        return replace(self, groups=self.groups[::-1], laws=self.laws[::-1], smooth=self.smooth[::-1])

    @property
    def is_plain(self) -> bool:
        """Whether none has a memory."""
        return all(group.operator == "none" for group in self.groups)


@dataclass(frozen=True, eq=False)
class LawSearch:
    """What was found."""

    places: tuple[LikelyPlace, ...]  # the likeliest first
    found: FittedLaws | None = None  # None if none is taken
    alternatives: tuple[Law, ...] = ()  # laws that do as well as the first one
    single: FittedLaws | None = None  # the best law alone, where two are taken

    @property
    def choices(self) -> tuple[LawSearch, ...]:
        """What is worth a trial, one after the other: where two laws do not hold, one may."""
        return (self,) if self.single is None else (self, replace(self, found=self.single, single=None))

    @property
    def laws(self) -> tuple[Law, ...]:
        """The laws that are taken, with the standard deviations of their values."""
        return self.found.laws if self.found else ()

    @property
    def law(self) -> Law | None:
        """The first one."""
        return self.laws[0] if self.found else None

    def in_rig(self, rig: Rig) -> Rig:
        """A rig with the laws that it can hold: an error of readings is none."""
        for law in self.laws:
            rig = rig if law.is_of_readings else with_law(rig, law)
        return rig


class _ModelPart:
    """A part of a model, as laws are judged: about the model without a further law."""

    def __init__(self, model: Model) -> None:
        self.model = model
        taken = laws_of(model.experiments[0].rig)
        self.numbers = [number for number in range(1, LAWS + 1) if number not in taken]  # of further laws of the rig
        self.recordings = [FittedRecording.of(*pair) for pair in model.pairs]
        self._columns: dict[LawForm, tuple[Law, LawColumns]] = {}
        self._firsts: list[LawColumns] = []  # of laws that are asked with a second one
        self._room = _MOST_KEPT

    @cached_property
    def _misfit(self) -> float:
        """−2 log likelihood of what each recording's stretches leave without a law."""
        each = zip(self.recordings, solved(self.recordings, (), ()).squares, strict=True)
        return sum(one.misfit(squares) for one, squares in each)

    def gain(self, left: Sequence[Floats]) -> float:
        """Evidence of laws by what the stretches leave, of each recording the sums of squares (C,)."""
        each = zip(self.recordings, left, strict=True)
        return self._misfit - sum(one.misfit(squares) for one, squares in each)

    def span(self, group: LawForm) -> float:
        """Range of the argument of a law."""
        return float(max(np.ptp(one.argument_of(group, side)) for one in self.recordings for side in group.muscles))

    def columns(self, group: LawForm) -> tuple[Law, LawColumns] | None:
        """An empty law with its columns in each recording; None if its argument does not move, or it shows nowhere."""
        if group in self._columns:
            return self._columns[group]
        seen = np.concatenate([one.argument_of(group, side) for one in self.recordings for side in group.muscles])
        nodes = np.zeros(1) if group.argument == "none" else nodes_of(seen, group.number)
        if len(nodes) == 1 and group.argument != "none":
            return None
        empty = group.law(nodes, np.zeros(len(nodes)))
        if not empty.is_of_readings and replace(empty, values=tuple(np.ones(len(nodes)))).complaint():
            return None
        columns = self._made(group, empty)
        if not any(item.any() for item in columns):
            return None
        self._room -= sum(item.size for item in columns)
        self._columns[group] = empty, LawColumns.of(self.recordings, columns, self._room >= 0)
        return self._columns[group]

    def _made(self, group: LawForm, law: Law) -> list[Floats]:
        """The columns of a law in each recording (B, C, N)."""
        return [one.columns(group, law, self.numbers[0]) for one in self.recordings]

    def fitted(self, group: LawForm, beside: FittedLaws | None = None) -> FittedLaws | None:
        """A law to first order, alone or beside another one; None if it cannot be told."""
        groups = (*(beside.groups if beside else ()), group)
        known = [pair for each in groups if (pair := self.columns(each)) is not None]
        if len(known) < len(groups):
            return None
        empty, own = known[-1]
        own.meet(self._firsts, lambda: self._made(group, empty))
        found = []
        for share in SMOOTH if len(empty.nodes) > 1 else SMOOTH[:1]:
            smooth = (*(beside.smooth if beside else ()), share)
            step = solved(self.recordings, [columns for _, columns in known], smooth)
            if all(values.any() for values in step.steps):
                each = zip(groups, known, step.steps, step.covariances, strict=True)
                laws = tuple(_law_of(form, law.nodes, *of) for form, (law, _), *of in each)
                found.append(FittedLaws(groups, laws, smooth, self.gain(step.squares)))
        return max(found, key=lambda one: one.gain, default=None)

    def every_law(self, beside: FittedLaws | None = None) -> list[FittedLaws]:
        """All laws to first order, alone or beside another one, the best first; those with a memory at the best places.

        Beside another law, one of its own term is none: that would be another form of it.
        """
        places = self.model.experiments[0].law_places
        if beside is not None:
            places = tuple(at for at in places if not LawForm(at).is_of_term(beside.group))
        found = [one for group in law_forms.plain_groups(places) if (one := self.fitted(group, beside))]
        found.sort(key=lambda one: -one.gain)
        last = [one.groups[-1] for one in found]
        # What rubs or engages somewhere on the way does so within a short part of it.
        finer = [group for k, group in enumerate(last) if k < _FINER or group.argument == "angle"]
        groups = [replace(group, number=law_forms.FINE) for group in finer if group.argument != "none"]
        likely = list(dict.fromkeys(group.place for group in last))[:_WITH_MEMORY]
        # A sensor may be late and read right at rest; its columns need no simulation.
        likely += [place for place in places if TABLE[LawForm(place).kind].part == SENSORS and place not in likely]
        groups += law_forms.groups_with_memory(likely, self.span)
        found += [one for group in groups if (one := self.fitted(group, beside))]
        return sorted(found, key=lambda one: -one.gain)

    def every_pair(self, found: Sequence[FittedLaws]) -> list[FittedLaws]:
        """Two laws at once to first order, one of them the best law of a likely place; the best of two places first."""
        firsts = {one.group.place: one for one in reversed(found)}
        likely = list(dict.fromkeys(one.group.place for one in found))[:_FIRST_OF_TWO]
        for group in (firsts[at].group for at in likely):
            empty, known = self._columns[group]
            if not known.each:
                known = LawColumns.of(self.recordings, self._made(group, empty))
                self._columns[group] = empty, known
            self._firsts.append(known)
        pairs = sorted((pair for at in likely for pair in self.every_law(firsts[at])), key=lambda one: -one.gain)
        best = dict[frozenset[str], FittedLaws]()
        for one in pairs:
            best.setdefault(frozenset(group.place for group in one.groups), one)
        return list(best.values())

    def refined(self, one: FittedLaws) -> FittedLaws:
        """Laws fitted to the recordings, as far as that makes them likelier; they are judged about that fit."""
        begun: list[tuple[list[Law], Model]] = []
        for share in _STEP_LENGTHS:
            laws = _scaled(one.laws, share)
            begun.append((laws, with_it(self.model, *laws)))
            if _cost(begun[-1][1]) < _cost(self.model):
                break
        laws, model = min(begun, key=lambda pair: _cost(pair[1]))
        gained = math.inf
        for number in range(_STEPS + 1):
            here = [FittedRecording.of(*pair) for pair in model.pairs]
            columns = [
                LawColumns.of(here, [each.columns(group, law, number) for each in here])
                for group, law, number in zip(one.groups, laws, self.numbers, strict=False)
            ]
            step = solved(here, columns, one.smooth)
            if number == _STEPS or gained < _ENOUGH:
                break
            moved = next(
                ((there, after) for share in _STEP_LENGTHS
                 if _cost(after := with_it(self.model, *(there := _moved(one.groups, laws, step.steps, share))))
                 < _cost(model)), None,
            )  # fmt: skip
            if moved is None:
                break
            gained = _cost(model) - _cost(moved[1])
            laws, model = moved
        certain = tuple(
            law.measured(np.array(law.values), covariance * TABLE[law.place].step ** 2)
            for law, covariance in zip(laws, step.covariances, strict=True)
        )
        held_out = evidence_held_out(self.model, model)
        return replace(one, laws=certain, gain=self.gain(step.squares), model=model, held_out=held_out)

    def takes_two(self, found: Sequence[FittedLaws], best: FittedLaws) -> FittedLaws:
        """Two laws where each is a further effect beside the other; the best law alone where there are no such two."""
        if not leaves_more(self.model, best.model):
            return best
        two = [one for one in self.every_pair(found)[:_PAIRS] if one.gain - found[0].gain >= thresholds.STRONG]
        for one in sorted(map(self.refined, two), key=lambda one: -one.evidence):
            lacks_first, lacks_second = (with_it(self.model, law) for law in reversed(one.laws))
            each = zip((lacks_first, lacks_second), one.laws, strict=True)
            if all(is_better(self.model, before, one.model, law) for before, law in each):
                return one if _cost(lacks_first) >= _cost(lacks_second) else one.reversed
        return best


def leaves_more(base: Model, model: Model) -> bool:
    """Whether a model with a law leaves so much that there may be another one."""
    return 1.0 - share_of_all(base, model) >= thresholds.FURTHER_SHARE and model.has_significant_excess


def _law_of(group: LawForm, nodes: Sequence[float], values: Floats, covariance: Floats) -> Law:
    """A law by its values in units of its place (N,), and their covariance."""
    unit = TABLE[group.kind].step
    law = group.law(np.array(nodes), values * unit)
    return law.measured(np.array(law.values), covariance * unit**2)


def _scaled(laws: Sequence[Law], share: float) -> list[Law]:
    return [replace(law, values=tuple(share * value for value in law.values)) for law in laws]


def _moved(groups: Sequence[LawForm], laws: Sequence[Law], steps: Sequence[Floats], share: float) -> list[Law]:
    units = [TABLE[group.kind].step for group in groups]
    return [
        replace(law, values=tuple(map(float, np.array(law.values) + share * unit * step)))
        for law, step, unit in zip(laws, steps, units, strict=True)
    ]


def _cost(model: Model) -> float:
    return sum(fit.cost for fit in model.fits)


_LAST: dict[tuple[Any, ...], LawSearch] = {}
"""What was found last: a rule of the verdict asks for the law that the diagnosis tries afterwards."""
_REMEMBERED = 2
"""Searches that are remembered: in a free run, and along the motion."""


def search(model: Model, progress: Callable[[str], None]) -> LawSearch:
    """Look for laws that a model lacks.

    `model`: all parts of all recordings, with what was found so far. What was searched lately is not searched again.
    """
    asked = model.experiments, model.fits
    if asked not in _LAST:
        found = _searched(model, progress)
        while len(_LAST) >= _REMEMBERED:
            del _LAST[next(iter(_LAST))]
        _LAST[asked] = found
    return _LAST[asked]


def better(base: Model, before: Model, about: Model, progress: Callable[[str], None]) -> tuple[LawSearch, Model] | None:
    """Laws that do better where nothing was fitted, with the model that has them; None if there are none.

    `base`: without effects. `before`: what they have to do better than. `about`: what they are looked for beside.
    """
    learned = search(about, progress)
    if not learned.laws:
        return None
    model = with_it(about, *learned.laws)
    return (learned, model) if is_better(base, before, model, learned.laws[0]) else None


def _searched(model: Model, progress: Callable[[str], None]) -> LawSearch:
    progress("a law that nobody wrote: every place of the model")
    judged = [_ModelPart(part) for part in parts(model) if part.has_significant_excess]
    own = {part: part.every_law() for part in judged}
    every = sorted(((one, part) for part, laws in own.items() for one in laws), key=lambda pair: -pair[0].gain)
    places: dict[str, float] = {}
    for one, _ in every:
        places.setdefault(one.group.place, one.gain)
    found = LawSearch(tuple(LikelyPlace(*item) for item in places.items()))
    least = max(thresholds.STRONG, _IN_REACH * every[0][0].gain) if every else 0.0
    standing = [pair for pair in every if pair[0].gain >= least]
    if not standing:
        return found
    progress("a law that nobody wrote: the best of them, fitted to the recordings")
    kept_near = model.experiments[0].is_kept_near
    fitted = {part.refined(one): part for one, part in _finalists(standing, kept_near)}
    likeliest = max(fitted, key=lambda one: one.evidence)
    best = _as_good(list(fitted), likeliest, kept_near, lambda one: one.evidence)[0]
    part = fitted[best]
    progress("a law that nobody wrote: two at once")
    two = part.takes_two(own[part], best)
    if two.gain < thresholds.STRONG:
        return found
    # Those that were fitted to the recordings are compared by all evidence, the others to first order.
    near = _as_good(list(fitted), best, kept_near, lambda one: one.evidence)
    near += _as_good([one for one, _ in standing], best, kept_near)
    others = {(one.law.at, one.law.argument): one.law for one in reversed(near)}
    others.pop((best.law.at, best.law.argument), None)
    alternatives = tuple(list(others.values())[::-1][:_MOST_ALTERNATIVES])
    if two is not best:
        return replace(found, found=two, single=best)
    return replace(found, found=_with_friction(best, model), alternatives=alternatives)


def _finalists(
    standing: Sequence[tuple[FittedLaws, _ModelPart]], kept_near: bool
) -> list[tuple[FittedLaws, _ModelPart]]:
    """Of the best places the best law each, the simplest as good one, and the best one without a memory.

    What remembers imitates much. At the very best places the best one by another argument is tried as well: angle and
    pressures of a joint move together.
    """
    out: dict[FittedLaws, _ModelPart] = {}
    for number, place in enumerate(list(dict.fromkeys(one.group.place for one, _ in standing))[:_FINALISTS]):
        own = {one: part for one, part in standing if one.group.place == place}
        best = next(iter(own))
        plain = next((one for one in own if one.is_plain), best)
        tried = [best, _as_good(list(own), best, kept_near)[0], plain]
        if number < _BY_ANOTHER:
            others = (one for one in own if one.is_plain and one.group.argument != plain.group.argument)
            tried.append(next(others, best))
        for one in tried:
            out[one] = own[one]
    return list(out.items())


def _as_good(
    tried: Sequence[FittedLaws], best: FittedLaws, kept_near: bool,
    of: Callable[[FittedLaws], float] = lambda one: one.gain,
) -> list[FittedLaws]:  # fmt: skip
    """Laws that data cannot tell from one, none of them with more of a memory, the simplest first.

    `kept_near`: whether measured inputs keep the model near; then what the motion tells best comes first. `of`: the
    evidence that is compared.
    """

    def order(one: FittedLaws) -> tuple[bool, int, float]:
        argument = one.group.argument
        rank = _FIRST.index(argument) if kept_near and argument in _FIRST else len(_FIRST)
        return not one.is_plain, rank, -of(one)

    near = [one for one in tried if abs(of(best) - of(one)) < thresholds.STRONG]
    return sorted((one for one in near if one.is_plain or not best.is_plain), key=order)


def _with_friction(best: FittedLaws, model: Model) -> FittedLaws:
    """A law of friction with the constant friction that was found: a friction below zero would be none."""
    if best.law.place != "friction" or "friction" not in model.effects:
        return best
    return _ModelPart(acting(best.law, without(model, "effects.friction."))).fitted(best.group) or best
