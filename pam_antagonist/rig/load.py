"""Reading a rig file, with an error message of one line."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pam_antagonist.errors import BadInput
from pam_antagonist.model import parameters as par
from pam_antagonist.paths import config_dir
from pam_antagonist.rig import learned
from pam_antagonist.rig.physical import unphysical
from pam_antagonist.rig.schema import Rig
from pam_antagonist.strict_yaml import names, read_mapping, unknown, validated

_LONGEST_CHAIN = 4
_SWITCHES = ("consider", "sealed")
_DOTTED = ("uncertainty", "priors", "bounds", "directions")
_OPEN = (*_DOTTED, "effects", "signals", "encoder")
"""Parts of a rig file to which keys may be added."""


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
    if path.suffix in (".yaml", ".yml"):
        return folder / path
    if name_or_path not in rig_names():
        close = difflib.get_close_matches(name_or_path, rig_names(), 1)
        hint = f" Did you mean {close[0]!r}?" if close else ""
        raise BadInput(f"unknown rig {name_or_path!r}: expected a .yaml file or one of {', '.join(rig_names())}.{hint}")
    return config_dir() / "rigs" / f"{name_or_path}.yaml"


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
