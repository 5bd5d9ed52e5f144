"""The JSON schema of rig files, with which an editor completes, explains and checks them."""

from __future__ import annotations

from typing import Any

from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.model.effects import learned as laws
from pam_antagonist.rig import learned
from pam_antagonist.rig.schema import Rig

_NUMBER, _NUMBERS = {"type": "number"}, {"type": "array", "items": {"type": "number"}, "maxItems": laws.NODES}
_LAW = {
    "type": "object",
    "description": "a learned law: docs/effects.md",
    "additionalProperties": False,
    "properties": {
        "place": {"enum": list(laws.PLACES), "description": "where it acts"},
        "muscle": {"enum": [1, 2, "both"], "description": "at a place of a muscle"},
        "argument": {
            "type": "string",
            "description": "what it depends on",
            "examples": [*learned.EVERYWHERE, *learned.OWN],
        },
        "operator": {"enum": list(learned.OPERATORS), "default": "none", "description": "with a memory"},
        "time": {**_NUMBER, "description": "of lag and high_pass [s]"},
        "width": {**_NUMBER, "description": "of play and stop, in the unit of the argument"},
        "nodes": {**_NUMBERS, "description": "of the argument, increasing [SI]"},
        "values": {**_NUMBERS, "description": "at the nodes, in the unit of the place"},
    },
}


def rig_json_schema() -> dict[str, Any]:
    """JSON schema (draft 2020-12) of a rig file; needs pydantic 2.

    A file that is ``based_on`` another one gives only what differs. So nothing is required below the top level, and
    nothing at all beside ``based_on``; :func:`pam_antagonist.rig.load_rig` checks that the result is complete.
    """
    schema: dict[str, Any] = Rig.model_json_schema()
    required = schema.pop("required")
    for definition in schema["$defs"].values():
        definition.pop("required", None)
    schema["properties"] = {
        "based_on": {"type": "string", "description": "name or file of the rig that this one differs from"},
        **schema["properties"],
    }
    schema["anyOf"] = [{"required": ["based_on"]}, {"required": required}]
    schema["$defs"]["Law"] = _LAW
    schema["properties"]["effects"] = {
        "type": "object",
        "default": {},
        "description": "what the paper's model lacks: docs/effects.md",
        "additionalProperties": False,
        "properties": {name: _effect(name) for name in CATALOGUE},
    }
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def _effect(name: str) -> dict[str, Any]:
    effect = CATALOGUE[name]
    if effect.of_tables:
        laws = dict.fromkeys(learned.LAWS, {"$ref": "#/$defs/Law"})
        return {"type": "object", "description": effect.meaning, "additionalProperties": False, "properties": laws}
    return {
        "type": "object",
        "description": effect.meaning,
        "additionalProperties": False,
        "properties": {
            item.name: {
                "type": "number",
                "minimum": item.low,
                "maximum": item.high,
                "default": item.neutral,
                "description": f"{item.meaning} [{item.unit}]",
            }
            for item in effect.parameters
        },
    }
