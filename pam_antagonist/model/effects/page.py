"""The sections of the page of the effects, ``docs/effects.md``, from the catalogue. ``./run docs`` puts them there.

python -m pam_antagonist.model.effects.page NAME ...     prints the sections of these effects
python -m pam_antagonist.model.effects.page --hooks      prints where an effect may act, and on what it may depend
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Sequence

from pam_antagonist.model.effects.base import AddedState, Effect, EffectParameter
from pam_antagonist.model.effects.hooks import HOOKS, QUANTITIES, Hook
from pam_antagonist.model.effects.registry import CATALOGUE

_OWN = __package__ or ""
_AT = {"possible": "may", "needed": "must", "none": "cannot"}


def section(effect: Effect) -> str:
    """The section of an effect, in Markdown."""
    where = f"`{effect.module}`"
    if effect.module.startswith(f"{_OWN}."):
        where = f"[`effects/{effect.name}.py`](../{effect.module.replace('.', '/')}.py)"
    law = "" if "```math" in effect.notes else f"*Law* {effect.law}.\n\n"
    rows = () if effect.of_tables else _merged(map(_parameter, effect.parameters))
    parameters = "".join(f"* {name} {symbol} ({numbers}): {meaning}\n" for name, symbol, numbers, meaning in rows)
    # Laws of a table are alike: the first one stands for all.
    shown = [state for state in effect.states if not effect.of_tables or state.name.startswith("law1_")]
    likewise = ", and so for each law" if effect.of_tables else ""
    states = [f"*State* {line}{likewise}.\n\n" for line in map(_line, _merged(map(_state, shown)))]
    return (
        f"## `{effect.name}`\n\n{effect.meaning} {where}\n\n{effect.notes}\n\n{law}{parameters}\n"
        + "".join(states)
        + f"*Signature* {effect.signature}\n\n"
        f"*Recording* {effect.experiment}.\n"
    )


def sections(effects: Iterable[Effect]) -> str:
    """The sections of several effects, in Markdown."""
    return "\n".join(section(effect) for effect in effects)


def own_sections() -> str:
    """The sections of the effects of this package, in Markdown."""
    return sections(effect for effect in CATALOGUE.values() if effect.module.startswith(f"{_OWN}."))


def hooks() -> str:
    """Where an effect may act, and on what it may depend, in Markdown."""
    titles = ("hook", "at each", "the function returns", "unit", "which the model", "states of the effect")
    known = ((f"`{name}`", unit, what) for name, (unit, what) in QUANTITIES.items())
    return _table(titles, map(_hook, HOOKS.values())) + "\n" + _table(("quantity", "unit", ""), known)


def _table(titles: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    def line(cells: Sequence[str]) -> str:
        return f"|{'|'.join(f' {cell} ' if cell else ' ' for cell in cells)}|\n"

    return line(titles) + f"|{'|'.join('---' for _ in titles)}|\n" + "".join(map(line, _merged(rows)))


def _merged(rows: Iterable[Sequence[str]]) -> Iterable[Sequence[str]]:
    """Rows that differ by a number only (of the muscle, of the signal) as one, with an ``i`` for the number."""
    kept: dict[tuple[str, ...], list[Sequence[str]]] = {}
    for row in rows:
        number = re.search(r"\d(?=`)", row[0])
        own = rf"((?<=[_,])|(?<=slope)|(?<=muscle |signal )){number[0]}" if number else r"(?!)"
        key = tuple(re.sub(own, "i", cell) for cell in row)
        kept.setdefault(key, []).append(row)
    for key, same in kept.items():
        yield same[0] if len(same) == 1 else (", ".join(row[0] for row in same), *key[1:])


def _symbol(symbol: str) -> str:
    return f"${symbol}$" if symbol else ""


def _parameter(item: EffectParameter) -> tuple[str, ...]:
    allowed = f"{item.low:g} to {item.high:g} {item.unit.replace('-', '')}".rstrip()
    return (f"`{item.name}`", _symbol(item.symbol), f"{item.neutral:g}; {allowed}", item.meaning)


def _state(state: AddedState) -> tuple[str, ...]:
    noise = f"`{state.noise}`" if isinstance(state.noise, str) else f"{state.noise:g}"
    switches = " or ".join(f"`{name}`" for name in (state.switch, *state.further))
    return (f"`{state.name}`", _symbol(state.symbol), state.unit, switches, f"{state.initial_std:g}", noise)


def _line(row: Sequence[str]) -> str:
    name, symbol, unit, switches, std, noise = row
    return f"{name} {symbol} [{unit}], with {switches}: initial std {std}, noise {noise} a √s"


def _hook(hook: Hook) -> tuple[str, ...]:
    known = ", ".join(f"`{name}`" for name in (hook.value, *hook.quantities))
    floor = " (not below 0)" if hook.floor else ""
    way = {"adds": "adds to", "subtracts": "subtracts from", "replaces": "puts in the place of"}[hook.way]
    change = f"{way} `{hook.value}`{floor}; known: {known}"
    at = "muscle" if hook.of_muscle else "joint"
    return (f"`{hook.name}`", at, hook.meaning, hook.unit, change, _AT[hook.states])


def main(arguments: Sequence[str]) -> int:
    """Print sections."""
    if arguments == ["--hooks"]:
        print(hooks(), end="")
        return 0
    unknown = [name for name in arguments if name not in CATALOGUE]
    if unknown:
        print(f"error: unknown effect {unknown[0]!r}: expected one of {', '.join(CATALOGUE)}", file=sys.stderr)
        return 2
    print(sections(CATALOGUE[name] for name in arguments or CATALOGUE), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
