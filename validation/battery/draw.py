"""Which joints a battery holds: kinds, forms and sizes, drawn so that all come up before any comes up again."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from pam_antagonist.errors import BadInput
from validation.battery.form import Form
from validation.battery.forms import FOREIGN, SINGLE, UNCATALOGUED, is_other
from validation.battery.plants import Case

LEVELS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
"""Sizes of single effects: multiples of the noise of a sample (root mean square over a minute)."""
LARGE = 4.0
"""Sizes from which on the figures of a battery count; pairs and what is in no catalogue have no smaller ones."""
NOTHING_FROM = 1000
"""Number of the first of the further cases with nothing wrong."""
CALIBRATIONS_FROM = 3000
"""Number of the first of the cases whose only fault is a calibration."""
UNCATALOGUED_FROM = 5000
"""Number of the first of the cases that are outside of every law."""
CALIBRATIONS = {
    "encoder_zero": tuple(float(np.radians(size)) for size in (0.2, 0.5, 1.0, 2.0)),
    "torque_zero": (0.05, 0.1, 0.3),
    **{f"delay_{clock}": (0.005, 0.01, 0.02, 0.05) for clock in ("voltage", "pressure", "angle", "torque")},
}
"""Calibrations and their sizes in SI units. A torque meter's scale is left out: it looks like other muscles."""
EFFECTS = tuple(dict.fromkeys(form.effect for form in SINGLE))
"""Effects of the catalogue that have forms here; one that a package adds has none."""
_KIND_SHARES = (("single", 0.5), ("pair", 0.2), ("none", 0.15), ("foreign", 0.15))
_OTHER_OF = 4
"""Of so many singles of an effect, all but one are drawn from forms that are truly other ones."""

Item = TypeVar("Item")


def cases(
    seed: int, count: int, nothing: int = 0, calibrations: int = 0, effect: str | None = None, uncatalogued: int = 0
) -> list[tuple[int, Case]]:
    """A battery: half of it single effects, the rest pairs, nothing at all, and what is in no catalogue.

    Three quarters of the single effects and both of every pair are in forms that the catalogue's law cannot imitate
    (:func:`~validation.battery.forms.is_other`), where the effect has such a form.

    A longer battery of the same seed begins with the shorter one. With `effect`, the cases are all of this effect, in
    all its forms in turn and in sizes that count. Returns each case with its number.
    """
    if effect is not None and effect not in EFFECTS:
        raise BadInput(f"battery: the effect {effect!r} has no forms here; expected one of {', '.join(EFFECTS)}")
    numbers = count, nothing, calibrations, uncatalogued
    if seed < 0 or min(numbers) < 0 or count > NOTHING_FROM or sum(numbers) < 1:
        raise BadInput(
            f"battery: seed {seed}, {count} cases, {nothing} with nothing wrong and {calibrations} with a calibration, "
            f"expected a seed of 0 or more and one case or more, up to {NOTHING_FROM}"
        )
    draw = _Draw(np.random.default_rng(seed))
    done = {kind: 0 for kind, _ in _KIND_SHARES}
    out = []
    for number in range(count):
        if effect is not None:
            form = draw.next((effect, "form"), [form for form in SINGLE if form.effect == effect])
            out.append((number, _case(number, "single", [form], seed, draw, LARGE)))
            continue
        # The kind that is furthest behind its share.
        kind = max(_KIND_SHARES, key=lambda item: item[1] * (number + 1) - done[item[0]])[0]
        done[kind] += 1
        out.append((number, _case(number, kind, draw.forms(kind), seed, draw)))
    further = range(NOTHING_FROM, NOTHING_FROM + nothing)
    out += [(number, _case(number, "none", [], seed, draw)) for number in further]
    # Drawn by themselves, so that they do not depend on how many others there are.
    draw = _Draw(np.random.default_rng([seed, CALIBRATIONS_FROM]))
    read = range(CALIBRATIONS_FROM, CALIBRATIONS_FROM + calibrations)
    out += [(number, _misread(_case(number, "calibration", [], seed, draw), draw)) for number in read]
    draw = _Draw(np.random.default_rng([seed, UNCATALOGUED_FROM]))
    outside = range(UNCATALOGUED_FROM, UNCATALOGUED_FROM + uncatalogued)
    out += [(k, _case(k, "foreign", [draw.next("outside", UNCATALOGUED)], seed, draw)) for k in outside]
    return out


def _misread(case: Case, draw: _Draw) -> Case:
    """A joint with nothing wrong, whose recordings need a calibration."""
    name, size = draw.calibration()
    return replace(
        case, name=case.name.replace("none", name), form=(name,), sizes=(abs(size),), calibration=(name, size)
    )


def _case(number: int, kind: str, forms: Sequence[Form], seed: int, draw: _Draw, least: float = 0.0) -> Case:
    effects = [(form.effect, int(draw.rng.integers(1, 3)) if form.by_muscle else None) for form in forms]
    words = " + ".join(f"{effect} {muscle}" if muscle else effect for effect, muscle in effects) or "none"
    return Case(
        name=f"{number:03d} {words}",
        kind=kind,
        effects=tuple(effects),
        form=tuple(form.name for form in forms),
        seed=int(np.random.SeedSequence([seed, number]).generate_state(1)[0]),
        sizes=tuple(draw.size(kind, form, least) for form in forms),
        exact=True,
    )


class _Draw:
    """What has come up, and what has not yet: items of a deck in random order, shuffled again when all have come up."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self._count: dict[str, int] = defaultdict(int)
        self._left: dict[object, list[Any]] = defaultdict(list)

    def forms(self, kind: str) -> list[Form]:
        """The forms of the next case of a kind."""
        if kind == "none":
            return []
        if kind == "foreign":
            return [self.next("foreign", FOREIGN)]
        effect = self.next((kind, "effect"), EFFECTS)
        if kind == "single":
            return [self._form(effect)]
        rest = tuple(name for name in EFFECTS if name != effect)
        return [self._form(effect, always=True), self._form(str(self.rng.choice(rest)), always=True)]

    def size(self, kind: str, form: Form, least: float) -> float:
        """The size of a form in the next case of a kind."""
        least = least if kind == "single" else LARGE
        deck = form.effect if kind == "single" else "size"
        return self.next((kind, deck, "size"), tuple(level for level in LEVELS if level >= least))

    def calibration(self) -> tuple[str, float]:
        """Name and value of the next calibration."""
        name = self.next("calibration", tuple(CALIBRATIONS))
        return name, self.next((name, "size"), CALIBRATIONS[name]) * float(self.rng.choice((-1.0, 1.0)))

    def _form(self, effect: str, always: bool = False) -> Form:
        mine = [form for form in SINGLE if form.effect == effect]
        others, close = ([form for form in mine if is_other(form) is wanted] for wanted in (True, False))
        other = always
        if not always:
            self._count[effect] += 1
            other = self._count[effect] % _OTHER_OF != 0
        chosen = (others if other else close) or others or close
        return self.next((effect, chosen is others), tuple(chosen))

    def next(self, deck: object, items: Sequence[Item]) -> Item:
        """The next item of a deck."""
        if not self._left[deck]:
            self._left[deck] = [items[k] for k in self.rng.permutation(len(items))]
        item: Item = self._left[deck].pop()
        return item
