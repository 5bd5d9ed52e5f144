"""Composition of the effects in the catalogue: one compiled function for each hook, which the equations call.

The equations (``dynamics``, ``flow``, ``equilibrium``, ``sensor``) must not name effects, and compiled code cannot go
through a list of functions. So a small module is generated as text when the package is imported. It has a function for
each hook, which calls the functions of the registered effects by name, one after another. There are three steps:

1. :func:`source_text` generates the module. Arguments are filled in by name
   (:mod:`pam_antagonist.model.effects.hooks`): a parameter becomes its place in the vector ``p``, a state its place in
   ``x``, a quantity an expression.
2. The text is kept in the folder of the compiled kernels. The name of the file contains a hash of the text, so that
   later processes find the module and its kernels.
3. The module is imported from there, as one below this module, whose names its functions become.

An absent effect costs one comparison: a function is called only if a size of its effect is not 0, or if its state is
present. A state is present if the rig has it *and* ``x`` holds it: ``x`` with four entries holds no added state. The
path without added states passes None for ``x``, and the compiler leaves these calls out.

Learned laws (an effect with ``of_tables``) are calls of separate functions, which the compiler does not inline, and
only where there is an ``x``: a rig that has none costs one comparison at each of their hooks.

To read the generated module: ``python -m pam_antagonist.model.composition``.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import inspect
import itertools
import os
from collections.abc import Callable, Mapping, Sequence
from types import ModuleType
from typing import Any

from pam_antagonist._jit import cache_dir
from pam_antagonist.errors import BadInput
from pam_antagonist.model import parameters as par
from pam_antagonist.model.effects import CATALOGUE, AddedState, Effect, EffectParameter, learned, parameter_path
from pam_antagonist.model.effects.base import COEFFICIENTS, SIGNALS
from pam_antagonist.model.effects.hooks import (
    EVERYWHERE,
    HOOKS,
    JOINT_RATE,
    JOINT_STEADY,
    MUSCLE_RATE,
    MUSCLE_STEADY,
    Hook,
)

__path__ = [str(cache_dir())]
"""Where generated modules are found: with their kernels, so that those of an earlier process find what they call."""

_EXPRESSIONS = {
    "atmosphere": "p[ATMOSPHERE]",
    "supply_pressure": "p[SUPPLY]",
    "quickest_lag": "quickest_lag(p)",
    "orifice_flow": "orifice_flow(chamber_pressure, p[ATMOSPHERE], p)",
    "passive_force": "static_map(i, muscle_length, p[ATMOSPHERE], p)",
    "now": "now(x, p)",
    **{f"signal{k + 1}": f"p[SIGNAL + {k}]" for k in range(SIGNALS)},
    **{f"coefficient{k + 1}": f"p[SIGNAL + {SIGNALS + k}]" for k in range(COEFFICIENTS)},
}
"""Quantities that are computed only where a function asks for them."""
_CHANGES = {"adds": "value + {}", "subtracts": "value - {}", "replaces": "{}"}
_OF_MUSCLE = "muscle_length, length_rate, wanted_open_rate, valve_flow"
_OWN = {
    "spool_voltage": f"({', '.join(5 * ['valve_voltage'])})",
    "mass_loss": f"({_OF_MUSCLE}, valve_flow)",
    **dict.fromkeys(("muscle_rates", "muscle_steady"), f"({_OF_MUSCLE}, valve_voltage)"),
    "open_rate": f"(muscle_length, {', '.join(['length_rate', *3 * ['wanted_open_rate']])})",
    **dict.fromkeys(("swelling", "contraction_force"), f"(muscle_length, {', '.join(4 * ['length_rate'])})"),
    **dict.fromkeys(("joint_rates", "joint_steady"), f"({', '.join(5 * ['drawn_flow'])})"),
}
"""Argument ``own`` of learned laws: what is known where; what is not repeats another one."""
_HEADER = '''"""Effects put together; written by pam_antagonist.model.composition, which explains it."""

import numpy as np

from pam_antagonist._jit import in_place, inlined
from pam_antagonist.model.joint import quickest_lag
from pam_antagonist.model.lane_values import shared
from pam_antagonist.model.muscle import force as static_map
from pam_antagonist.model.orifice import orifice_flow
from pam_antagonist.model.parameters import ATMOSPHERE, SIGNAL, STATELESS_EFFECTS, SUPPLY, VISCOUS
'''
_NOW = """FIRST, SECOND = np.int64(0), np.int64(1)


@in_place
def now(x, p):
    return x[0], x[1], chamber_pressure(x[2], FIRST, x, p), chamber_pressure(x[3], SECOND, x, p)
"""


class _Writer:
    """Collects the text of the module: its functions, and the constants and imports that they need."""

    def __init__(self, effects: Mapping[str, Effect]) -> None:
        self.effects = effects
        self.imports: dict[str, None] = {}
        self.constants: dict[str, int | str] = {}
        self.functions: list[str] = []

    def parameter(self, effect: Effect, item: EffectParameter, of_muscle: bool) -> str:
        """Expression that reads a parameter; of muscle ``i`` if each muscle has its own and the hook is of a muscle."""
        each = of_muscle and item.muscle is not None
        name = item.family if each else item.name
        first = f"{name}_1" if each else name
        constant = f"{effect.name}__{name}".upper()
        self.constants[constant] = par.INDEX[parameter_path(effect.name, first)]
        return f"p[{constant} + i]" if each else f"p[{constant}]"

    def slot(self, state: AddedState, of_muscle: bool) -> str:
        """Expression that reads the index of a state from ``p``."""
        each = of_muscle and state.muscle is not None
        name = state.family if each else state.name
        constant = f"AT_{name}".upper()
        self.constants[constant] = par.SLOT_OF[f"{name}_1" if each else name]
        return f"p[{constant} + i]" if each else f"p[{constant}]"

    def call(
        self, effect: Effect, function: Any, where: str, quantities: Sequence[str], of_muscle: bool,
        expressions: Mapping[str, str],
    ) -> tuple[str, list[EffectParameter], list[AddedState]]:  # fmt: skip
        """Expression that calls a function of an effect, with the parameters and states that it asks for."""
        plain = getattr(function, "py_func", None)
        if plain is None:
            raise BadInput(f"effect {effect.name!r}: {where}: expected a function with the decorator @inlined")
        alias = f"{effect.name}__{plain.__name__}"
        self.imports[f"from {plain.__module__} import {plain.__name__} as {alias}"] = None
        items = {(item.family if of_muscle else item.name): item for item in effect.parameters}
        states = {(state.family if of_muscle else state.name): state for state in effect.states}
        known = (*EVERYWHERE, *quantities, *expressions)
        arguments, used, held = [], [], []
        for name in inspect.signature(plain).parameters:
            if (name in items) + (name in states) + (name in known) > 1:
                raise BadInput(f"effect {effect.name!r}: {where}: {name!r} has two meanings; expected another name")
            if name in items:
                used.append(items[name])
                arguments.append(self.parameter(effect, items[name], of_muscle))
            elif name in states:
                held.append(states[name])
                arguments.append(f"{name}_")
            elif name in known:
                arguments.append({**_EXPRESSIONS, **expressions}.get(name, name))
            else:
                raise BadInput(
                    f"effect {effect.name!r}: {where}: {plain.__name__} asks for {name!r}, expected parameters "
                    f"({', '.join(items)}), states ({', '.join(states) or 'none'}) or quantities ({', '.join(known)})"
                )
        return f"{alias}({', '.join(arguments)})", used, held

    def tables(self, effect: Effect, where: str, quantities: Sequence[str], of_muscle: bool) -> tuple[str, str]:
        """Condition and call of the learned laws in a function."""
        known = {name: name for name in ("value", "p", "x", "dx")}
        known |= {"own": _OWN.get(where, ""), "viscous": "p[VISCOUS]"}
        indices = {"law": par.LAW, "muscle": learned.JOINT}
        indices["place"] = 1 + list(learned.PLACES).index(learned.IN_HOOKS.get(where, ("flow",))[0])
        for name, index in indices.items():
            known[name] = f"LAW_{name}_{index}".upper()
            # numba would compile a function anew for each literal.
            self.constants[known[name]] = f"np.int64({index})"
        known |= {"muscle": "i"} if of_muscle else {}
        self.constants[f"LAWS_IN_{where}".upper()] = par.LAWS_IN[where]
        text, _, _ = self.call(effect, effect.hooks[where], where, quantities, of_muscle, known)
        return f"    if shared(p[LAWS_IN_{where.upper()}]) != 0.0:", text

    def hook(self, hook: Hook, before: str = "") -> None:
        """Write the function of a hook. With ``before``, only the effects ahead of the named one act in it."""
        index = ["i"] if hook.of_muscle else []
        extra = [name for name in hook.quantities if name not in _EXPRESSIONS]
        within = ["x"] if hook.states != "none" else []
        title = f"{hook.name}_before_{before}" if before else hook.name
        lines = ["@inlined", f"def {title}({', '.join([hook.value, *index, *extra, *within, 'p'])}):"]
        lines.append(f"    value = {hook.value}")
        stateless_lines, state_lines, table_lines = [], [], []
        ahead = itertools.takewhile(lambda effect: effect.name != before, self.effects.values())
        acting = [effect for effect in ahead if hook.name in effect.hooks]
        for effect in reversed(acting) if hook.name == "sensor_inverse" else acting:
            if effect.of_tables:
                guard, text = self.tables(effect, hook.name, (hook.value, *hook.quantities), hook.of_muscle)
                change = _CHANGES[hook.way].format(text)
                table_lines = [guard, f"        value = {f'max({change}, 0.0)' if hook.floor else change}"]
                continue
            expressions = {hook.value: "value"} if hook.way == "replaces" else {}
            text, used, held = self.call(
                effect, effect.hooks[hook.name], hook.name, (hook.value, *hook.quantities), hook.of_muscle, expressions
            )
            if held and hook.states == "none":
                raise BadInput(f"effect {effect.name!r}: {hook.name}: a state, expected parameters and quantities only")
            if not effect.states and hook.states == "needed":
                raise BadInput(f"effect {effect.name!r}: {hook.name}: expected an effect that adds a state")
            change = _CHANGES[hook.way].format(text)
            change = f"max({change}, 0.0)" if hook.floor else change
            if effect.states and hook.states != "none":
                state_lines += self._with_states(effect, held, hook.of_muscle, f"value = {change}")
            else:
                sizes = [item for item in used if item.is_size] or [item for item in effect.parameters if item.is_size]
                guards = dict.fromkeys(f"{self.parameter(effect, item, hook.of_muscle)} != 0.0" for item in sizes)
                stateless_lines += [f"if {' or '.join(guards)}:", f"    value = {change}"]
        stateless = all(not effect.states or effect.of_tables for effect in acting)
        if stateless_lines:
            indent = "    "
            if stateless or hook.states != "none":
                lines.append("    if shared(p[STATELESS_EFFECTS]) != 0.0:")
                indent = "        "
            lines += [indent + line for line in stateless_lines]
        if state_lines:
            lines += [
                "    if x is not None:",
                "        if x.shape[0] > 4:",
                *(f"            {line}" for line in state_lines),
            ]
        if table_lines and within:
            table_lines = ["    if x is not None:", *(f"    {line}" for line in table_lines)]
        # Readings are corrected in the reverse order.
        lines[3 if hook.name == "sensor_inverse" else len(lines) : 0] = table_lines
        self.functions.append("\n".join([*lines, "    return value"]))

    def _with_states(self, effect: Effect, held: Sequence[AddedState], of_muscle: bool, then: str) -> list[str]:
        """Lines that run only if the states are present."""
        lines, indent = [], ""
        for state in held or effect.states[:1]:
            name = state.family if of_muscle else state.name
            lines += [
                f"{indent}{name}_at = shared({self.slot(state, of_muscle)})",
                # Most states are absent: their index is not converted. numba does not wrap around an unsigned index.
                f"{indent}if {name}_at > 0.0 and {name}_at < x.shape[0]:",
            ]
            indent += "    "
            if held:
                lines.append(f"{indent}{name}_ = x[np.uint64({name}_at)]")
        return [*lines, indent + then]

    def state_values(
        self, title: str, into: str, which: str, of_muscle: bool, quantities: Sequence[str],
        expressions: Mapping[str, str],
    ) -> None:  # fmt: skip
        """Write a function that fills in the derivative (``rate``) or the ``steady_value`` of each state."""
        arguments = [name for name in quantities if name not in _EXPRESSIONS and name not in expressions]
        index = ["i"] if of_muscle else []
        given = dict.fromkeys(["x", into])
        lines = ["@inlined", f"def {title}({', '.join([*index, *arguments, *given, 'p'])}):"]
        for effect in self.effects.values():
            if effect.of_tables:
                guard, text = self.tables(effect, title, quantities, of_muscle)
                lines += [guard, f"        {text}"]
                continue
            for state in effect.states:
                if (state.muscle is not None) != of_muscle or state.muscle == 2:
                    continue
                function, where = getattr(state, which), f"{which} of {state.name}"
                if function is None and into == "x":
                    continue
                text = "0.0"
                held: list[AddedState] = []
                if function is not None:
                    own = {key: text.format(effect=effect.name) for key, text in expressions.items()}
                    text, _, held = self.call(effect, function, where, quantities, of_muscle, own)
                name = state.family
                lines += [f"    {name}_at = shared({self.slot(state, of_muscle)})", f"    if {name}_at > 0.0:"]
                for other in held:
                    # The states of one effect are present or absent together.
                    lines.append(f"        {other.family}_ = x[int(shared({self.slot(other, of_muscle)}))]")
                lines.append(f"        {into}[int({name}_at)] = {text}")
        self.functions.append("\n".join([*lines, "    return"]))

    def lags(self) -> None:
        """Write the function of the states' time constants. It is called seldom, so it is not compiled."""
        lines = ["def small_signal_lags(p):", "    return np.array([0.0"]
        for effect in self.effects.values():
            for state in effect.states:
                if state.lag is not None:
                    items = {item.name: item for item in effect.parameters}
                    own = {item.family: item for item in effect.parameters if item.muscle in (None, state.muscle)}
                    plain = state.lag.py_func
                    alias = f"{effect.name}__{plain.__name__}"
                    self.imports[f"from {plain.__module__} import {plain.__name__} as {alias}"] = None
                    names = list(inspect.signature(plain).parameters)
                    if not set(names) <= set(own):
                        raise BadInput(f"effect {effect.name!r}: lag of {state.name}: expected {', '.join(own)} only")
                    arguments = [self.parameter(effect, items[own[name].name], False) for name in names]
                    lines[-1] += f", {alias}.py_func({', '.join(arguments)})"
        lines[-1] += "][1:])"
        self.functions.append("\n".join(lines))


def _asks(function: Any) -> bool:
    """Whether a function of a state has the argument ``asked_pressure``."""
    return "asked_pressure" in inspect.signature(getattr(function, "py_func", lambda: None)).parameters


def source_text(effects: Mapping[str, Effect]) -> str:
    """Source of the module that composes the effects.

    `effects`: by name; their parameters and states are in the parameter vector.
    """
    for effect in effects.values():
        for name in effect.hooks:
            if name not in HOOKS and not (effect.of_tables and name in par.LAWS_IN):
                raise BadInput(f"effect {effect.name!r}: unknown hook {name!r}, expected one of {', '.join(HOOKS)}")
        if ("sensor_reading" in effect.hooks) != ("sensor_inverse" in effect.hooks):
            raise BadInput(f"effect {effect.name!r}: expected sensor_reading and sensor_inverse together")
    writer = _Writer(effects)
    for hook in HOOKS.values():
        writer.hook(hook)
    for effect in effects.values():
        if any(_asks(state.rate) or _asks(state.steady_value) for state in effect.states):
            writer.hook(HOOKS["asked_pressure"], effect.name)
    asked = {"asked_pressure": "asked_pressure_before_{effect}(valve_voltage, i, x, p)"}
    static = {"static_force": "static_map(i, muscle_length, chamber_pressure, p)", **asked}
    writer.state_values("muscle_rates", "dx", "rate", True, MUSCLE_RATE, static)
    writer.state_values("joint_rates", "dx", "rate", False, JOINT_RATE, {})
    behind = "chamber_pressure(valve_pressure, i, x, p)"
    steady_value = {
        **asked,
        "chamber_pressure": behind,
        "static_force": f"static_map(i, muscle_length, {behind}, p)",
    }
    writer.state_values("muscle_steady", "x", "steady_value", True, MUSCLE_STEADY, steady_value)
    writer.state_values("joint_steady", "x", "steady_value", False, JOINT_STEADY, {})
    writer.lags()
    constants = "\n".join(f"{name} = {index}" for name, index in sorted(writer.constants.items()))
    imports = "\n".join(sorted(writer.imports))
    return f"{_HEADER}{imports}\n\n{constants}\n{_NOW}\n\n" + "\n\n\n".join(writer.functions) + "\n"


def remembered(what: str, generate: Callable[[], str]) -> str:
    """A text that depends on the code of the kernels only. It is generated once, then read from the kernels' folder."""
    file = cache_dir() / f"{what}.txt"
    with contextlib.suppress(OSError):
        return file.read_text(encoding="utf-8")
    text = generate()
    draft = file.with_name(f"{what}.{os.getpid()}.tmp")
    with contextlib.suppress(OSError):
        draft.write_text(text, encoding="utf-8")
        os.replace(draft, file)
    return text


def imported(text: str, what: str) -> ModuleType:
    """Import a text as a module. Its file is kept in the folder of the compiled kernels.

    `what`: first part of the module's name; the second is a hash of the text.
    """
    name = f"{what}_{hashlib.sha256(text.encode()).hexdigest()[:16]}"
    file = cache_dir() / f"{name}.py"
    if not file.exists():
        # Another process may write the same file now. A link makes it visible as a whole, and fails where it exists.
        draft = file.with_name(f"{name}.{os.getpid()}.tmp")
        draft.write_text(text, encoding="utf-8")
        try:
            os.link(draft, file)
        except FileExistsError:
            pass
        except OSError:  # a file system without links
            os.replace(draft, file)
        finally:
            draft.unlink(missing_ok=True)
        importlib.invalidate_caches()
    return importlib.import_module(f"pam_antagonist.model.composition.{name}")


_composed = imported(source_text(CATALOGUE), "effects")


def __getattr__(name: str) -> Any:
    """A function of the composed module."""
    return getattr(_composed, name)


if __name__ == "__main__":
    print(source_text(CATALOGUE))
