"""The page of the effects, ``docs/effects.md``: a section for each, generated from the catalogue.

    python -m pam_antagonist.model.effects.page NAME ...     prints the sections of these effects
    python -m pam_antagonist.model.effects.page --write docs/effects.md

The text between a pair of marks ``<!-- begin X -->`` and ``<!-- end X -->`` is generated; the rest is written by hand.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from pam_antagonist.errors import BadInput
from pam_antagonist.model.effects.base import AddedState, Effect, EffectParameter
from pam_antagonist.model.effects.hooks import HOOKS, QUANTITIES, Hook
from pam_antagonist.model.effects.registry import CATALOGUE

_OWN = __package__ or ""
_NO_STATE = "No added state.\n"
_AT = {"possible": "may", "needed": "must", "none": "cannot"}
_PARTS = {"air": "the pressures", "balance": "the torque that the motion needs"}


def section(effect: Effect) -> str:
    """The section of an effect, in Markdown."""
    where = f"`{effect.module}`"
    if effect.module.startswith(f"{_OWN}."):
        where = f"[`effects/{effect.name}.py`](../{effect.module.replace('.', '/')}.py)"
    law = "" if "```math" in effect.notes else f"*Law* {effect.law}.\n\n"
    states = _table(("added state", "", "unit", "comes with", "initial std", "noise a √s"), map(_state, effect.states))
    sealed = effect.sealed
    usual = {item.name: item.scale for item in effect.parameters}
    shown = f"shows it in {_PARTS[sealed.part]}" if sealed.part else f"does not show it: {sealed.reason}"
    numbers = ("parameter", "", "unit", "neutral", "from", "to", "meaning")
    parameters = "" if effect.of_tables else _table(numbers, map(_parameter, effect.parameters)) + "\n"
    return (
        f"## `{effect.name}`\n\n{effect.meaning} {where}\n\n{effect.notes}\n\n{law}"
        + f"{parameters}{states if effect.states else _NO_STATE}\n"
        f"*Source* {effect.source}.\n\n*Signature* {effect.signature}\n\n"
        f"*In a report* {effect.in_words(None, usual)}.\n\n*Which recording shows it* {effect.experiment}.\n\n"
        f"*A sealed joint* {shown}.\n"
    )


def sections(effects: Iterable[Effect]) -> str:
    """The sections of several effects, in Markdown."""
    return "\n".join(section(effect) for effect in effects)


def page(text: str, catalogue: Mapping[str, Effect]) -> str:
    """A page with its marked parts generated anew."""
    own = [effect for effect in catalogue.values() if effect.module.startswith(f"{_OWN}.")]
    titles = ("hook", "at each", "the function returns", "unit", "which the model", "states of the effect")
    hooks = _table(titles, map(_hook, HOOKS.values()))
    quantities = _table(("quantity", "unit", ""), ((f"`{n}`", unit, what) for n, (unit, what) in QUANTITIES.items()))
    for name, content in (("effects", sections(own)), ("hooks", hooks), ("quantities", quantities)):
        begin, end = f"<!-- begin {name} -->\n", f"<!-- end {name} -->"
        if text.count(begin) != 1 or text.count(end) != 1:
            raise BadInput(f"page of the effects: expected one part between {begin.strip()} and {end}")
        before, rest = text.split(begin)
        text = f"{before}{begin}\n{content}\n{end}{rest.split(end)[1]}"
    return text


def _table(titles: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    def line(cells: Sequence[str]) -> str:
        return f"|{'|'.join(f' {cell} ' if cell else ' ' for cell in cells)}|\n"

    return line(titles) + f"|{'|'.join('---' for _ in titles)}|\n" + "".join(map(line, rows))


def _symbol(symbol: str) -> str:
    return f"${symbol}$" if symbol else ""


def _parameter(item: EffectParameter) -> tuple[str, ...]:
    numbers = (f"{value:g}" for value in (item.neutral, item.low, item.high))
    return (f"`{item.name}`", _symbol(item.symbol), item.unit, *numbers, item.meaning)


def _state(state: AddedState) -> tuple[str, ...]:
    noise = f"`{state.noise}`" if isinstance(state.noise, str) else f"{state.noise:g}"
    switches = " or ".join(f"`{name}`" for name in (state.switch, *state.further))
    return (f"`{state.name}`", _symbol(state.symbol), state.unit, switches, f"{state.initial_std:g}", noise)


def _hook(hook: Hook) -> tuple[str, ...]:
    known = ", ".join(f"`{name}`" for name in (hook.value, *hook.quantities))
    floor = " (not below 0)" if hook.floor else ""
    way = {"adds": "adds to", "subtracts": "subtracts from", "replaces": "puts in the place of"}[hook.way]
    change = f"{way} `{hook.value}`{floor}; known: {known}"
    at = "muscle" if hook.of_muscle else "joint"
    return (f"`{hook.name}`", at, hook.meaning, hook.unit, change, _AT[hook.states])


def main(arguments: Sequence[str]) -> int:
    """Print sections, or write the page."""
    if arguments[:1] == ["--write"] and len(arguments) == 2:
        file = Path(arguments[1])
        file.write_text(page(file.read_text(encoding="utf-8"), CATALOGUE), encoding="utf-8")
        return 0
    unknown = [name for name in arguments if name not in CATALOGUE]
    if unknown:
        print(f"error: unknown effect {unknown[0]!r}: expected one of {', '.join(CATALOGUE)}", file=sys.stderr)
        return 2
    print(sections(CATALOGUE[name] for name in arguments or CATALOGUE), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
