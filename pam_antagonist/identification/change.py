"""A rig with other values, by dotted path."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pam_antagonist.rig import Rig


def moved(rig: Rig, values: Mapping[str, float]) -> Rig:
    """A rig with other values.

    Args:
        rig: the rig.
        values: by dotted path.
    """
    result = rig
    for name, value in values.items():
        result = _put(result, name.split("."), float(value))
    return result


def _put(model: Any, path: list[str], value: float) -> Any:
    if isinstance(model, Mapping):
        key, *rest = path
        inner = _put(model.get(key, {}), rest, value) if rest else value
        return {**model, key: inner}
    if len(path) == 1:
        return model.replaced(**{path[0]: value})
    return model.replaced(**{path[0]: _put(getattr(model, path[0]), path[1:], value)})
