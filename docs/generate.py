"""The parts of the reference pages that the code knows; the site has them, the committed pages do not.

A page marks such a part by ``<!-- generated: NAME -->`` and ``<!-- end -->``; NAME is a function of this module.
``./run python docs/generate.py`` writes the JSON schema of rig files, which editors read in a checkout.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import json
import os
import re
from pathlib import Path
from typing import Any
from unittest import mock

from rig_schema import rig_json_schema

import pam_antagonist
from pam_antagonist.__main__ import COMMANDS
from pam_antagonist.model.effects.page import own_sections
from pam_antagonist.nodes import bridge, controller, estimator, joints, plant
from pam_antagonist.nodes.parameters import AUTOSTART, DIAGNOSTICS_PERIOD, Parameter
from pam_antagonist.program import VARIABLE
from pam_antagonist.recording.topics import TOPICS
from validation.__main__ import COMMANDS as MEASUREMENTS

ROOT = Path(__file__).resolve().parents[1]
SCHEMA = ROOT / "config" / "rig.schema.json"
MARKED = re.compile(r"(<!-- generated: (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)
_ELSEWHERE = ("muscle_2", "valve_2", "effects")
"""Entries of a rig file that are like others, or on the page of the effects."""
NODES = {"plant": plant, "bridge": bridge, "estimator": estimator, "controller": controller, "joints": joints}
MESSAGES = ROOT / "pam_antagonist_msgs"


def help_text(name: str) -> str:
    """What ``./run NAME --help`` prints."""
    module, function = {**COMMANDS, **MEASUREMENTS}[name].target.split(":")
    out = io.StringIO()
    as_typed = mock.patch.dict(os.environ, {"COLUMNS": "100", VARIABLE: "./run"})
    with as_typed, contextlib.redirect_stdout(out), contextlib.suppress(SystemExit):
        getattr(importlib.import_module(module), function)(["--help"])
    return out.getvalue().strip()


def commands() -> str:
    """A section a command, with its help."""
    parts = []
    for name, command in {**COMMANDS, **MEASUREMENTS}.items():
        summary = f"{command.summary[0].upper()}{command.summary[1:]}".removesuffix("?") + (
            "?" if command.summary.endswith("?") else "."
        )
        parts.append(f"## {name}\n\n{summary}\n\n```text\n{help_text(name)}\n```\n")
    return "\n".join(parts)


def api() -> str:
    """A section a name of the Python API: functions first, then classes."""
    kinds = {name: getattr(pam_antagonist, name) for name in pam_antagonist.__all__ if name != "__version__"}
    order = sorted(kinds, key=lambda name: (isinstance(kinds[name], type), list(kinds).index(name)))
    parts = []
    for name in order:
        # A rig's fields stand on a page of their own.
        members = "value, with_value, parameters, tuning" if name == "Rig" else ""
        item, inherited = kinds[name], "" if name in ("Rig", "BadInput") else "   :inherited-members:\n"
        if isinstance(item, type):
            kind = "autoexception" if issubclass(item, Exception) else "autoclass"
            options = f"   :members: {members}\n" + inherited if kind == "autoclass" else ""
            # Its docstring has the attribute that the base class has as a property.
            options += "   :exclude-members: report\n" if name == "ReplayResult" else ""
        else:
            kind, options = "autofunction", ""
        parts.append(f"### {name}\n\n```{{eval-rst}}\n.. {kind}:: pam_antagonist.{name}\n{options}```\n")
    return "\n".join(parts)


def topics() -> str:
    """Name, type and meaning of each topic."""
    rows = [f"| `{topic.relative}` | `{topic.type}` | {topic.meaning} |" for topic in TOPICS.values()]
    return "\n".join(["| topic | type | content |", "|---|---|---|", *rows, ""])


def messages() -> str:
    """Each message and service: its file, and the first sentence of it."""
    rows = []
    for file in [*sorted((MESSAGES / "msg").glob("*.msg")), *sorted((MESSAGES / "srv").glob("*.srv"))]:
        comment = file.read_text(encoding="utf-8").split("\n\n")[0].replace("\n#", "")
        first = re.split(r"(?<=\.) ", comment.removeprefix("# "))[0]
        rows.append(f"* [`{file.name}`](../../{file.relative_to(ROOT)}): {first[0].lower()}{first[1:]}")
    return "\n".join(rows) + "\n"


def parameters() -> str:
    """The parameters that the same nodes have, with default and allowed values."""
    tables = {name: (*module.PARAMETERS, AUTOSTART, DIAGNOSTICS_PERIOD) for name, module in NODES.items()}
    shared: dict[tuple[str, ...], list[Parameter]] = {}
    for entry in (entry for table in tables.values() for entry in table):
        names = tuple(name for name, table in tables.items() if entry in table)
        if entry not in shared.setdefault(names, []):
            shared[names].append(entry)

    def row(entry: Parameter) -> str:
        text = entry.description.replace("|", "/") + ("" if entry.read_only else "; *live*")
        allowed = re.sub(r"^(a number from|an integer from|one of) ", "", entry.expected)
        return f"* `{entry.name}` (`{entry.default}`; {allowed}): {text}"

    parts = []
    for names, entries in sorted(shared.items(), key=lambda item: -len(item[0])):
        rows = "\n".join(map(row, entries))
        parts.append(f"### {', '.join(names)}\n\n{rows}")
    return "\n\n".join(parts) + "\n"


def rig_fields() -> str:
    """Every entry of a rig file by its dotted path; those of effects have a page of their own."""
    schema = rig_json_schema()
    rows: list[str] = []
    _walk("", schema, schema["$defs"], rows)
    return "\n".join([*rows, ""])


def _walk(prefix: str, node: dict[str, Any], defs: dict[str, Any], rows: list[str]) -> None:
    for key, entry in node.get("properties", {}).items():
        inner = entry
        for reference in (entry, *entry.get("allOf", []), *entry.get("anyOf", [])):
            if "$ref" in reference:
                inner = defs[reference["$ref"].rsplit("/", 1)[1]]
        path = f"{prefix}{key}"
        if path in _ELSEWHERE:
            continue
        if inner.get("properties"):
            _walk(f"{path}.", inner, defs, rows)
        else:
            default = "" if "default" not in entry else f"; `{json.dumps(entry['default'])}`"
            meaning = (entry.get("description") or inner.get("description") or "").strip()
            rows.append(f"* `{path}` ({_allowed(entry)}{default}){': ' if meaning else ''}{meaning}")


def _allowed(entry: dict[str, Any]) -> str:
    if "enum" in entry:
        return ", ".join(str(item) for item in entry["enum"])
    number = next((item for item in entry.get("anyOf", []) if item.get("type") != "null"), entry)
    low = number.get("minimum", number.get("exclusiveMinimum"))
    high = number.get("maximum", number.get("exclusiveMaximum"))
    text = {"number": "number", "string": "text", "boolean": "true, false", "array": "list", "object": "mapping"}.get(
        number.get("type", ""), ""
    )
    if low is not None and high is not None:
        text = f"{low:g} to {high:g}"
    elif low is not None:
        text = f"from {low:g}" if "minimum" in number else f"above {low:g}"
    return text + (", null" if number is not entry else "")


def effects() -> str:
    """A section for each effect of this package."""
    return own_sections()


def whole(text: str) -> str:
    """A page with its generated parts."""
    return MARKED.sub(lambda part: f"{part[1]}\n{globals()[part[2]]()}\n{part[3]}", text)


if __name__ == "__main__":
    SCHEMA.write_text(json.dumps(rig_json_schema(), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
