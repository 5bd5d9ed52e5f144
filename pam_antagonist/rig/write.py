"""A rig as YAML, with the unit and the paper's name beside every number."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel

from pam_antagonist.errors import BadInput
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.model.effects.learned import LAWS
from pam_antagonist.rig.learned import Law, law_of
from pam_antagonist.rig.load import load_rig
from pam_antagonist.rig.schema import Rig
from pam_antagonist.strict_yaml import described, fields_of

_COLUMN = 44


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
            for number in range(1, LAWS + 1):
                lines += _law(law_of(values, number, signals), number)
            continue
        known = {item.name: item for item in CATALOGUE[name].parameters}
        for key, value in values.items():
            lines += _entry(key, value, f"{known[key].meaning} [{known[key].unit}]", 2)
    return lines


def _law(law: Law | None, number: int) -> list[str]:
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
    return yaml.safe_dump(value, default_flow_style=True, width=10**6).strip().removesuffix("...").strip()
