"""Reading a rig file, and saying in one line what is wrong with it."""

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from pam_antagonist.errors import BadInput
from pam_antagonist.paths import config_dir
from pam_antagonist.rig.physical import unphysical
from pam_antagonist.rig.schema import Rig

_LARGEST_FILE = 100_000
_LONGEST_CHAIN = 4
_DEEPEST = 5
_SWITCHES = ("consider",)


class _StrictLoader(yaml.SafeLoader):
    """YAML without code, and without keys that silently replace earlier ones."""


def _mapping_without_duplicates(loader: _StrictLoader, node: yaml.MappingNode) -> dict[Any, Any]:
    seen: set[Any] = set()
    for key_node, _ in node.value:
        key = loader.construct_object(key_node, deep=True)  # type: ignore[no-untyped-call]
        if key in seen:
            raise yaml.YAMLError(f"key {key!r} stands twice, again in line {key_node.start_mark.line + 1}")
        seen.add(key)
    return loader.construct_mapping(node, deep=True)


_StrictLoader.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, _mapping_without_duplicates)


def rig_names() -> list[str]:
    """Names of the rigs that come with the package."""
    return sorted(path.stem for path in (config_dir() / "rigs").glob("*.yaml"))


def load_rig(name_or_path: str | Path) -> Rig:
    """Read and check a rig.

    Args:
        name_or_path: a name from ``config/rigs`` (``shin2022``), or the path of a YAML file.

    Returns:
        The rig, immutable.

    Raises:
        BadInput: unknown name, unreadable file, unknown or missing key, a value that is not physical.
    """
    path = _locate(str(name_or_path), Path())
    content = _read_with_base(path)
    for name in _switches(content):
        if name.rsplit(".", 1)[-1] not in _SWITCHES:
            raise BadInput(f"{path}: {name} is yes or no: expected a number")
    try:
        rig = Rig(**content)
    except ValidationError as error:
        raise BadInput(f"{path}: {_first_complaint(error)}") from None
    except OverflowError as error:  # pydantic 1 meets an integer of hundreds of digits
        raise BadInput(f"{path}: a number is too large: {error}") from None
    complaint = unphysical(rig)
    if complaint:
        raise BadInput(f"{path}: {complaint}")
    return rig


def _switches(content: dict[str, Any], prefix: str = "", depth: int = 0) -> Iterator[str]:
    """Paths of all values that YAML reads as true or false; pydantic would take them for 1 and 0."""
    for key, value in content.items():
        if isinstance(value, bool):
            yield f"{prefix}{key}"
        elif isinstance(value, dict) and depth < _DEEPEST:
            yield from _switches(value, f"{prefix}{key}.", depth + 1)


def _locate(name_or_path: str, beside: Path) -> Path:
    path = Path(name_or_path)
    if path.suffix in (".yaml", ".yml"):
        return beside / path
    if name_or_path not in rig_names():
        close = difflib.get_close_matches(name_or_path, rig_names(), 1)
        hint = f" Did you mean {close[0]!r}?" if close else ""
        raise BadInput(f"unknown rig {name_or_path!r}: expected a .yaml file or one of {', '.join(rig_names())}.{hint}")
    return config_dir() / "rigs" / f"{name_or_path}.yaml"


def _read_with_base(path: Path, depth: int = 0) -> dict[str, Any]:
    """A rig file's content, laid over that of the rig it is ``based_on``, if it names one."""
    content = _read_yaml(path)
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
    return result


def _read_yaml(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > _LARGEST_FILE:
            raise BadInput(f"{path}: {path.stat().st_size} bytes, which is no rig file (a few kB expected)")
        content = yaml.load(path.read_text(encoding="utf-8"), Loader=_StrictLoader)
    except FileNotFoundError:
        raise BadInput(f"{path}: no such rig file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(f"{path}: cannot be read: {' '.join(str(error).split())}") from None
    except (yaml.YAMLError, RecursionError, ValueError, TypeError) as error:
        raise BadInput(f"{path}: not valid YAML: {' '.join(str(error).split())[:300]}") from None
    if not isinstance(content, dict) or not all(isinstance(key, str) for key in content):
        raise BadInput(f"{path}: expected a mapping of names to values, as in config/rigs/shin2022.yaml")
    return content


def _first_complaint(error: ValidationError) -> str:
    """One line for the first thing that pydantic found wrong, typos first: they explain missing keys."""
    complaints = sorted(error.errors(), key=lambda item: "extra" not in str(item["type"]))
    first = complaints[0]
    where = ".".join(str(part) for part in first["loc"])
    if "extra" in str(first["type"]):
        missing = [str(item["loc"][-1]) for item in complaints if "missing" in str(item["type"])]
        close = difflib.get_close_matches(str(first["loc"][-1]), missing, 1, cutoff=0.5)
        text = f"unknown key {where!r}" + (f" (did you mean {close[0]!r}?)" if close else "")
    elif "missing" in str(first["type"]):
        text = f"{where} is missing"
    else:
        value = f" (found {reprlib.repr(first['input'])[:80]})" if "input" in first else ""
        text = f"{where}: {str(first['msg'])[:1].lower()}{str(first['msg'])[1:]}{value}"
        description = _description(first["loc"])
        if description:
            text += f"; it is {description}"
    more = len(complaints) - 1
    return text + (f"; and {more} more" if more else "")


def _description(location: tuple[Any, ...]) -> str:
    """What the schema says about the value at a location."""
    node: Any = Rig
    text = ""
    for part in location:
        fields = getattr(node, "model_fields", None) or getattr(node, "__fields__", {})
        field = fields.get(part)
        if field is None:
            return ""
        info = getattr(field, "field_info", field)
        text = info.description or ""
        node = getattr(field, "annotation", None) or getattr(field, "outer_type_", None)
    return text
