"""Rig files: read with an error message of one line, written with the unit and the paper's name beside every number."""

from __future__ import annotations

import contextlib
import difflib
import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from pam_antagonist.errors import BadInput
from pam_antagonist.model import parameters as par
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.paths import config_dir
from pam_antagonist.rig import learned
from pam_antagonist.rig.physical import unphysical
from pam_antagonist.rig.schema import Rig
from pam_antagonist.strict_yaml import described, dump, fields_of, names, read_mapping, unknown, validated

_LONGEST_CHAIN = 4
_LISTED = 50
"""Files of a folder that are looked at for a rig."""
_SWITCHES = ("consider", "sealed")
_DOTTED = ("uncertainty", "priors", "bounds", "directions")
_OPEN = (*_DOTTED, "effects", "signals", "encoder", "weak_laws")
"""Parts of a rig file to which keys may be added."""
_COLUMN = 44
"""Column of the comments in a file."""


def rig_names() -> list[str]:
    """Names of the rigs that come with the package."""
    return sorted(path.stem for path in (config_dir() / "rigs").glob("*.yaml"))


def load_rig(name_or_path: str | Path, regulators: bool = False) -> Rig:
    """Read and check a rig.

    Args:
        name_or_path: a name from ``config/rigs`` (``shin2022``), or the path of a YAML file.
        regulators: whether a rig with pressure regulators is accepted. Callers that can only use voltages must not get
            such a rig.

    Returns:
        The rig, immutable.

    Raises:
        BadInput: unknown name, unreadable file, unknown or missing key, a value that is not physical.

    Example:
        >>> from pam_antagonist import load_rig
        >>> rig = load_rig("shin2022")
        >>> rig.sample_period, rig.value("joint.inertia")
        (0.001, 0.0004263)
    """
    if not isinstance(name_or_path, (str, Path)):
        kind = type(name_or_path).__name__
        raise BadInput(f"rig: found a value of type {kind}, expected a rig, its name, or the path of its file")
    path = _locate(str(name_or_path), Path())
    rig = checked(_read_with_base(path), str(path))
    if rig.drive == "regulator" and not regulators:
        raise BadInput(
            f"{path}: a rig with pressure regulators (drive: regulator), expected one with valves; "
            "the nodes, simulate, check, replay, identify, close_loop and static take such a rig"
        )
    return rig


def as_rig(rig: Rig | str | Path, regulators: bool = False) -> Rig:
    """The rig itself. One that was made in Python is checked as a file is.

    Args:
        rig: a rig, its name, or its file.
        regulators: as for :func:`load_rig`.

    Raises:
        BadInput: as :func:`load_rig`.
    """
    return checked(rig.plain(), f"rig {rig.name}") if isinstance(rig, Rig) else load_rig(rig, regulators)


def checked(content: dict[str, Any], where: str) -> Rig:
    """The rig with a content, which is checked."""
    rig = validated(Rig, _with_numbers(content, where), where, _SWITCHES)
    complaint = _half_linear(content, rig) or unphysical(rig)
    if complaint:
        raise BadInput(f"{where}: {complaint}")
    return rig


def _with_numbers(content: dict[str, Any], where: str) -> dict[str, Any]:
    """The content with its learned laws as numbers."""
    effects, signals = content.get("effects"), content.get("signals")
    if not isinstance(effects, dict) or not isinstance(effects.get("learned"), dict):
        return content
    try:
        numbers = learned.as_numbers(effects["learned"], list(signals) if isinstance(signals, dict) else [])
    except BadInput as error:
        raise BadInput(f"{where}: {error}") from None
    return {**content, "effects": {**effects, "learned": numbers}}


def with_value(rig: Rig, name: str, value: Any) -> Rig:
    """A rig with another value, see :meth:`Rig.with_value`."""
    content, (head, *rest) = rig.plain(), name.split(".")
    known = [*names(content), *map(str, par.INDEX)]
    if name not in known and head not in _OPEN:
        raise BadInput(f"rig {rig.name}: {unknown(name, known)}; expected the dotted name of a value in its file")
    if head in _DOTTED:  # their keys are dotted names themselves
        inner = 1 if head == "directions" else 0
        rest = [*rest[:inner], ".".join(rest[inner:])]
    change = value
    for key in reversed([head, *rest]):
        change = {key: change}
    return checked(_overlaid(content, change), f"rig {rig.name}")


def _half_linear(content: Mapping[str, Any], rig: Rig) -> str:
    """Which coefficient of the paper's force map is left out; the other forms do not need them. Empty: none."""
    for name in ("muscle_1", "muscle_2") if rig.model.force == "linear" else ():
        for key in ("v1", "v2", "w1", "w2"):
            if key not in content[name]["force"]:
                return f"{name}.force.{key} is missing: the linear force map needs it"
    return ""


def _locate(name_or_path: str, folder: Path) -> Path:
    path = Path(name_or_path)
    if os.path.isdir(folder / path):  # False for a name that is none
        raise BadInput(f"{path}: a folder, expected a rig file{_offered(folder / path)}")
    if path.suffix in (".yaml", ".yml"):
        return folder / path
    if name_or_path not in rig_names():
        close = difflib.get_close_matches(name_or_path, rig_names(), 1)
        hint = f" Did you mean {close[0]!r}?" if close else ""
        raise BadInput(f"unknown rig {name_or_path!r}: expected a .yaml file or one of {', '.join(rig_names())}.{hint}")
    return config_dir() / "rigs" / f"{name_or_path}.yaml"


def _offered(folder: Path) -> str:
    """The rig files in a folder, for a message."""
    found = []
    for path in sorted(folder.glob("*.y*ml"))[:_LISTED]:
        with contextlib.suppress(BadInput):
            if {"geometry", "based_on"} & read_mapping(path, "rig", "a rig file").keys():
                found.append(str(path))
    return f" such as {' or '.join(found)}" if found else ", and there is none in it"


def _read_with_base(path: Path, depth: int = 0) -> dict[str, Any]:
    """Content of a rig file, merged over the content of the rig that it is ``based_on``, if any."""
    content = read_mapping(path, "rig", "config/rigs/shin2022.yaml")
    base = content.pop("based_on", None)
    if base is None:
        return content
    if not isinstance(base, str) or depth >= _LONGEST_CHAIN:
        raise BadInput(f"{path}: based_on: expected the name or file of another rig, in at most {_LONGEST_CHAIN} steps")
    return _overlaid(_read_with_base(_locate(base, path.parent), depth + 1), content)


def _overlaid(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    result = dict(base)
    for key, value in changes.items():
        known = result.get(key)
        result[key] = _overlaid(known, value) if isinstance(known, dict) and isinstance(value, dict) else value
        if value is None and "." in key:
            # For a dotted path, as in uncertainty, null removes the entry of the base.
            del result[key]
    return result


class RefusedRig(BadInput):
    """A rig that no command would read, so that its file was not written; the message says what is wrong with it."""


def write_rig(rig: Rig, path: Path, remarks: Sequence[str] = ()) -> None:
    """Write a rig file, and read it again: what stands there is what every command accepts.

    All rig files that this package makes are written here.
    """
    write_unread(rig, path, remarks)
    try:
        again = load_rig(path, regulators=True)
    except BadInput as error:
        path.unlink()
        raise RefusedRig(str(error).removeprefix(f"{path}: ")) from None
    if _model(again, 0) != _model(rig, 0):
        path.unlink()
        raise RefusedRig(f"rig {rig.name}: its file would not hold the same numbers")


def refusal(rig: Rig) -> str:
    """Why :func:`write_rig` would refuse a rig; empty if it would not."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            write_rig(rig, Path(folder) / "rig.yaml")
        except RefusedRig as error:
            return str(error)
    return ""


def write_unread(rig: Rig, path: Path, remarks: Sequence[str] = ()) -> None:
    """Write a rig file that nobody is asked to use, such as a rejected result."""
    lines = [f"# {remark}" if remark else "#" for remark in remarks]
    lines += ["# SI units; every pressure is absolute; angles in rad."]
    lines += _model(rig, 0)
    with path.open("x", encoding="utf-8") as file:
        file.write("\n".join(lines) + "\n")


def _model(model: BaseModel, depth: int) -> list[str]:
    lines = []
    for name, field in fields_of(type(model)).items():
        description = described(field)
        if name == "effects" and depth == 0:
            lines += _effects(model.effects, description, list(model.signals))  # type: ignore[attr-defined]
            continue
        lines += _entry(name, getattr(model, name), description, depth)
    return lines


def _effects(effects: Mapping[str, Mapping[str, float]], description: str, signals: Sequence[str]) -> list[str]:
    """The effects of a rig, each number with its meaning and unit from the catalogue; learned laws in words."""
    if not effects:
        return _entry("effects", effects, description, 0)
    lines = ["", _line("effects:", f"# {description}")]
    for name, values in effects.items():
        lines.append(_line(f"  {name}:", f"# {CATALOGUE[name].meaning}"))
        if CATALOGUE[name].of_tables:
            for number in range(1, len(learned.LAWS) + 1):
                lines += _law(learned.law_of(values, number, signals), number)
            continue
        known = {item.name: item for item in CATALOGUE[name].parameters}
        for key, value in values.items():
            lines += _entry(key, value, f"{known[key].meaning} [{known[key].unit}]", 2)
    return lines


def _law(law: learned.Law | None, number: int) -> list[str]:
    """A learned law of a rig, with units."""
    if law is None:
        return []
    unit = law.argument_unit
    units = {"time": "[s]", "width": f"[{unit}]", "nodes": f"[{unit}]; constant outside", "values": f"[{law.unit}]"}
    lines = [_line(f"    law{number}:", f"# {law.in_words()}")]
    for key, value in law.content().items():
        lines += _entry(key, value, units.get(key, ""), 3)
    return lines


def _entry(name: str, value: Any, description: str, depth: int) -> list[str]:
    indent = "  " * depth
    comment = f"# {description}" if description else ""
    if isinstance(value, BaseModel):
        return ["", f"{indent}{name}:", *_model(value, depth + 1)] if depth == 0 else [
            f"{indent}{name}:", *_model(value, depth + 1)]  # fmt: skip
    if isinstance(value, Mapping):
        if not value:
            return [_line(f"{indent}{name}: {{}}", comment)]
        lines = ["", _line(f"{indent}{name}:", comment)]
        for key, item in value.items():
            lines += _entry(str(key), item, "", depth + 1)
        return lines
    return [_line(f"{indent}{name}: {_scalar(value)}", comment)]


def _line(text: str, comment: str) -> str:
    return f"{text.ljust(_COLUMN)}  {comment}".rstrip()


def _scalar(value: Any) -> str:
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        text = repr(float(value))
        # YAML 1.1 reads 1e-05 as a text: a number needs a point and a sign.
        mantissa, exponent, power = text.partition("e")
        if exponent:
            mantissa = mantissa if "." in mantissa else f"{mantissa}.0"
            text = f"{mantissa}e{power if power[0] in '+-' else '+' + power}"
        return text
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_scalar(item) for item in value) + "]"
    return dump(value, default_flow_style=True, width=10**6).strip().removesuffix("...").strip()
