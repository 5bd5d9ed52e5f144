"""Strict JSON, which every reader accepts: no NaN, no infinity, no numpy types; missing values are null."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np


def plain(value: Any) -> Any:
    """A value converted to Python's own types, with None for every number that is not finite.

    A dataclass becomes an object with its fields as keys, unless it has a method ``to_json``.
    """
    if hasattr(value, "to_json"):
        return plain(value.to_json())
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | str | int):
        return value
    raise TypeError(f"{type(value).__name__} has no form in JSON")


def picked(of: Any, *names: str) -> dict[str, Any]:
    """Attributes by their names, as ``report.json`` has them."""
    return {name: getattr(of, name) for name in names}


def dumps(value: Any, indent: int | None = 2) -> str:
    """Strict JSON text of a value."""
    return json.dumps(plain(value), indent=indent, allow_nan=False, ensure_ascii=False)


def write_json(path: Path, value: Any) -> None:
    """Write a value as strict JSON, UTF-8, with a final newline."""
    path.write_text(dumps(value) + "\n", encoding="utf-8")
