"""The missing law: first its place, then what it depends on, then a table; a simulation decides."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis import law_regression
from pam_antagonist.diagnosis.law_regression import LawForm, LikelyPlace, Regression, Whitened, grams, regression
from pam_antagonist.diagnosis.law_simulation import Simulated, Simulation, Subject, misread, smoothed
from pam_antagonist.diagnosis.residual_equations import Equations, equations
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig
from pam_antagonist.rig.learned import Law, with_law

Floats = NDArray[np.float64]

LEAST_GAIN = 40.0
"""Least gain of a law on held-out blocks [nats]."""
LEAST_SHARE = 0.08
"""Least share of what the base leaves that a law removes in a simulation."""
_PLACES, _ARGUMENTS, _FINALISTS = 5, 2, 4
"""How many laws are simulated: so many places, arguments of each, and of these so many further."""
_ROUNDS, _LAST_ROUNDS = 4, 8
"""Steps of Gauss and Newton of a base without a law, and of the best law."""
_AS_GOOD = 0.1
"""A law without memory may leave so much more, on the logarithmic scale."""
_RATES = {"length": "length_rate", "angle": "velocity"}
_TIE = 0.03
"""Laws that remove so nearly as much cannot be told apart."""


@dataclass(frozen=True, eq=False)
class LawSearch:
    """What was found."""

    places: tuple[LikelyPlace, ...]  # by the likelihood of an unknown input there, the likeliest first
    without: Simulated  # the base model, recalibrated
    found: Simulated | None  # the law; None if none is taken
    alternatives: tuple[Simulated, ...]  # laws that simulate as well
    gain: float  # of the taken law, or of the best one, on held-out blocks [nats]
    share: float  # of what the base leaves that it removes in the simulation
    least_gain: float = LEAST_GAIN  # that says something

    @property
    def law(self) -> Law | None:
        """The law that is taken, with the standard deviations of its values."""
        if self.found is None or self.found.law is None:
            return None
        variances = np.maximum(np.diag(self.found.covariance), 0.0)
        return replace(self.found.law, std=tuple(map(float, np.sqrt(variances))))

    def in_rig(self, rig: Rig) -> Rig:
        """A rig with the law; as it is, where none was taken or it is an error of readings."""
        law = self.law
        if self.found is None or law is None or law.is_of_readings:
            return rig
        return with_law(rig, law, covariance=self.found.covariance)

    def corrected(self, recordings: Sequence[Recording]) -> list[Recording]:
        """Recordings without the error of readings that was found; as they are, if it is another law."""
        law, out = self.law, []
        for one in recordings if law is not None and law.is_of_readings else ():
            pressure, angle = (np.nan_to_num(values) for values in (one.pressure, one.angle))  # type: ignore[arg-type]
            seen = [smoothed(values, one.sample_period_s) for values in (pressure, angle)]
            raised, turned = misread(law, seen[0], seen[1], one.sample_period_s)
            out.append(replace(one, pressure=one.pressure - raised, angle=one.angle - turned))  # type: ignore[operator]
        return out or list(recordings)


def law_search(subjects: Sequence[Subject], rig: Rig, progress: Callable[[str], None], number: int = 1) -> LawSearch:
    """Look for one law that a rig lacks in recordings of it; it gets a number in the rig."""
    progress("recalibrating the base parameters")
    simulation = Simulation(rig, subjects, number)
    as_it_is = simulation.evaluated(None, [np.zeros(len(simulation.groups))] * len(subjects))
    without = simulation.fitted(as_it_is, _ROUNDS, anew=True)
    progress("residual equations")
    each = [
        equations(rig, simulation.point(r, None, own), one.stretches, one.period, one.locked, own)
        for r, (one, own) in enumerate(zip(subjects, without.amounts, strict=True))
    ]
    progress("place")
    places = law_regression.place_search(each)
    progress("what it depends on")
    ranked = _regressions(each, places)
    progress("simulation")
    tried = _simulated(simulation, ranked, without.amounts)
    if not tried:
        return LawSearch(tuple(places), without, None, (), 0.0, 0.0)
    best = tried[0]
    share = 1.0 - best.left / max(without.left, 1e-9)
    gain = max((gain for gain, one in ranked if best.regression and one.group == best.regression.group), default=0.0)
    if share < LEAST_SHARE or gain < LEAST_GAIN:
        return LawSearch(tuple(places), without, None, (), gain, share)
    others = tuple(
        one for one in tried[1:]
        if one.left - best.left < _TIE * without.left and one.law and best.law
        and (one.law.at, one.law.argument) != (best.law.at, best.law.argument)
    )  # fmt: skip
    return LawSearch(tuple(places), without, best, others, gain, share)


_Ranked = Sequence[tuple[float, Regression]]


def _regressions(each: Sequence[Equations], places: Sequence[LikelyPlace]) -> _Ranked:
    """Laws by their gain on held-out blocks, each with and without a random walk beside it."""
    recordings = [Whitened(one) for one in each]
    products = grams(recordings, None)
    assert products is not None
    without = {level: regression(products, level) for level in (False, True)}
    found: list[tuple[float, Regression]] = []

    def tried(group: LawForm) -> None:
        made = grams(recordings, group)
        for level, nothing in without.items() if made is not None else ():
            one = regression(made, level)  # type: ignore[arg-type]
            found.append((one.gain(nothing), one))

    def by_gain() -> list[LawForm]:
        found.sort(key=lambda item: -item[0])
        return [one.group for _, one in found if one.group is not None]

    for group in law_regression.plain_groups([place.name for place in places if place.gain > 0.0]):
        tried(group)
    for group in dict.fromkeys(by_gain()[: 2 * _PLACES]):
        if group.argument != "none":
            tried(replace(group, number=law_regression.FINE))
    # Memory is tried at the places of the best laws, and at the likeliest ones.
    pairs = zip(dict.fromkeys(group.place for group in by_gain()), (place.name for place in places), strict=False)
    leading = list(dict.fromkeys(name for pair in pairs for name in pair))[: _PLACES + 1]
    for group in law_regression.groups_with_memory(leading, lambda group: float(np.ptp(group.nodes(each)))):
        tried(group)
    by_gain()
    return found


def _simulated(simulation: Simulation, ranked: _Ranked, begin: Sequence[Floats]) -> list[Simulated]:
    """The best laws, simulated and fitted there, in rounds of fewer and fewer; what is left decides."""
    starts: dict[LawForm, Simulated] = {}
    for group in _chosen(ranked):
        for one in (one for _, one in ranked if one.group == group and one.law is not None):
            near = [a + b for a, b in zip(begin, one.base, strict=True)]
            made = simulation.evaluated(one.law, near, one)
            if group not in starts or made.left < starts[group].left:
                starts[group] = made
    standing = _best_of_places(list(starts.values()))
    for most, rounds in ((len(standing), 1), (_FINALISTS, 2), (1, _LAST_ROUNDS)):
        fitted = [simulation.fitted(one, rounds, anew=most == 1) for one in standing[:most]]
        standing = sorted([*fitted, *standing[most:]], key=lambda one: one.left)
    return _simplest(simulation, standing, ranked) if standing else standing


def _best_of_places(tried: Sequence[Simulated]) -> list[Simulated]:
    """Of each place the laws that leave least before they are fitted, one more than it has arguments."""
    by_place: dict[str, list[Simulated]] = {}
    for one in sorted(tried, key=lambda one: one.left):
        assert one.law is not None
        by_place.setdefault(one.law.at, []).append(one)
    return sorted((one for own in by_place.values() for one in own[: _ARGUMENTS + 1]), key=lambda one: one.left)


def _chosen(ranked: _Ranked) -> list[LawForm]:
    """Laws to simulate: of the places with the best ones, with and without a walk, those by the best arguments."""
    chosen: dict[LawForm, None] = {}
    for level in (False, True):
        by_place: dict[str, dict[tuple[str, bool], LawForm]] = {}
        for gain, one in ranked:
            law, group = one.law, one.group
            if gain < LEAST_GAIN or one.level is not level or law is None or group is None:
                continue
            if law.complaint() and not law.is_of_readings:
                continue
            if group.place in by_place or len(by_place) < _PLACES:
                own = by_place.setdefault(group.place, {})
                if len(own) < _ARGUMENTS:
                    own.setdefault((group.argument, group.operator == "none"), group)
        chosen.update(dict.fromkeys(group for own in by_place.values() for group in own.values()))
    return list(chosen)


def _simplest(simulation: Simulation, done: list[Simulated], ranked: _Ranked) -> list[Simulated]:
    """The same, and the best law without its memory where that simulates as well.

    What fades at once is a rate, and what fades within the recording's length is the argument itself.
    """
    best = done[0]
    assert best.regression is not None and best.regression.group is not None and best.law is not None
    if best.law.operator == "none" or best.law.argument == "draw":
        return done
    bare = [replace(best.regression.group, operator="none", amount=0.0)]
    if best.law.operator == "high_pass" and best.law.argument in _RATES:
        bare.append(replace(bare[0], argument=_RATES[best.law.argument]))
    laws = [(bare[0], best.law)] if best.law.operator in ("lag", "play") else []
    for group in bare:
        known = [one.law for _, one in ranked if one.group == group and one.law is not None]
        laws += [(group, law) for law in known[: 2 // len(bare)]]
    plain = [
        simulation.fitted(
            simulation.evaluated(
                replace(law, operator="none", time=0.0, width=0.0), best.amounts, replace(best.regression, group=group)
            ),
            _ROUNDS,
        )
        for group, law in laws[:2]
    ]
    first = min(plain, key=lambda one: one.left, default=best)
    return [first, *done[1:]] if first.left <= best.left + _AS_GOOD else done
