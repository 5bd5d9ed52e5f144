"""Files of users (rigs, maps of CSV columns): strict YAML, checked by a schema, with errors in one line.

Works with pydantic 1.10 and 2.
"""

from __future__ import annotations

import difflib
import math
import re
import reprlib
import stat
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar, get_args

import pydantic
import yaml
from pydantic import BaseModel, ValidationError
from typing_extensions import Self, override

from pam_antagonist.errors import BadInput

_LARGEST_FILE = 100_000
_DEEPEST = 5
_LONGEST_NUMBER = 1000  # characters; the largest float has 309 digits
_MOST_NODES = 100_000  # values of a file with its aliases expanded

_OLD = pydantic.VERSION.startswith("1.")


class Strict(BaseModel):
    """Values that cannot be changed, all of them finite, and no keys beside the declared ones."""

    if _OLD:

        class Config:
            """Settings of pydantic 1."""

            extra = "forbid"
            allow_mutation = False

        @pydantic.validator("*", allow_reuse=True)
        def _finite(cls, value: Any) -> Any:
            """What ``allow_inf_nan`` does in pydantic 2."""
            numbers = value if isinstance(value, tuple) else (value,)
            if not all(math.isfinite(number) for number in numbers if isinstance(number, float)):
                raise ValueError("expected finite numbers")
            return value

    else:
        model_config = pydantic.ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @override
    def __dir__(self) -> list[str]:
        """Fields, and what this package's classes add: not what pydantic does."""
        kinds = [kind for kind in type(self).__mro__ if issubclass(kind, Strict)]
        own = {name for kind in kinds for name in vars(kind) if not name.startswith(("_", "model_", "Config"))}
        return sorted({*fields_of(type(self)), *own})

    def unchecked(self, **fields: Any) -> Self:
        """A copy with some fields replaced, whose values are not checked: for trials of a fit."""
        return self.copy(update=fields) if _OLD else self.model_copy(update=fields)

    def replaced(self, **fields: Any) -> Self:
        """A copy with some fields replaced, each checked by its own bounds."""
        kind = type(self)
        where, known = f"{kind.__name__}.replaced", fields_of(kind)
        for name in fields:
            if name not in known:
                hint = unknown(name, [*known, *names(self.plain())])
                hint += "; Rig.with_value changes a value by its dotted name" if "." in hint else ""
                raise BadInput(f"{where}: {hint}; expected one of {', '.join(known)}")
        try:
            return kind(**{**{name: getattr(self, name) for name in known}, **fields})
        except ValidationError as error:
            raise BadInput(f"{where}: {_first_complaint(error, kind)}") from None

    def plain(self, **how: Any) -> dict[str, Any]:
        """The content as plain values, as a file has it. `how`: as of pydantic's ``model_dump``."""
        return self.dict(**how) if _OLD else self.model_dump(**how)


class JsonLine(Strict):
    """A line of JSON; keys of later versions are left out."""

    if _OLD:

        class Config:
            """Settings of pydantic 1."""

            extra = "ignore"

    else:
        model_config = pydantic.ConfigDict(extra="ignore")

    def text(self) -> str:
        """The line, without what has its default value."""
        return self.json(exclude_defaults=True) if _OLD else self.model_dump_json(exclude_defaults=True)

    @classmethod
    def read(cls, line: bytes) -> Self:
        """What a line holds; raises pydantic's ``ValidationError``."""
        return cls.parse_raw(line) if _OLD else cls.model_validate_json(line)


Schema = TypeVar("Schema", bound=BaseModel)


def fields_of(schema: Any) -> Mapping[str, Any]:
    """A schema's fields by name; none where it is no schema."""
    return getattr(schema, "model_fields", None) or getattr(schema, "__fields__", {})


def described(field: Any) -> str:
    """What the schema says of a field."""
    return getattr(getattr(field, "field_info", field), "description", None) or ""


def names(content: Mapping[str, Any], prefix: str = "") -> list[str]:
    """Dotted names of all values of a file."""
    inner = [(f"{prefix}{key}", value) for key, value in content.items()]
    return [
        name
        for key, value in inner
        for name in (names(value, f"{key}.") if isinstance(value, Mapping) and value else [key])
    ]


def unknown(name: str, known: Iterable[str]) -> str:
    """That a name is unknown, and the one that it may stand for."""
    choices = list(known)
    close = difflib.get_close_matches(name, choices, 1)
    # "inertia" stands for "joint.inertia".
    close = close or [other for other in choices if other.split(".")[-1] == name][:1]
    return f"unknown {name!r}" + (f" (did you mean {close[0]!r}?)" if close else "")


_SCALARS = {
    "null": ("~|null|Null|NULL|", ("~", "n", "N", "")),
    "bool": ("true|True|TRUE|false|False|FALSE", "tTfF"),
    "int": ("[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+", "-+0123456789"),
    "float": (
        r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
        "-+.0123456789",
    ),
    "merge": ("<<", "<"),
}
"""Tag -> how such a value is written, and its first characters: the core schema of YAML 1.2, and merge keys.

PyYAML follows YAML 1.1, where 0512 is 330, 12:30 is 750, no is false, and 1e5 is a text.
"""


class _StrictLoader(yaml.SafeLoader):
    """YAML 1.2 without code, and without keys that silently replace earlier ones."""

    yaml_implicit_resolvers = {}  # instead of those of YAML 1.1


class _Dumper(yaml.SafeDumper):
    """Quotes what YAML 1.1 or 1.2 would take for something else than a text."""


for _tag, (_pattern, _first) in _SCALARS.items():
    yaml.add_implicit_resolver(
        f"tag:yaml.org,2002:{_tag}", re.compile(rf"^(?:{_pattern})$"), list(_first), _StrictLoader, _Dumper
    )


def _mapping_without_duplicates(loader: _StrictLoader, node: yaml.MappingNode) -> dict[Any, Any]:
    seen: set[Any] = set()
    for key_node, _ in node.value:
        if key_node.tag == "tag:yaml.org,2002:merge":  # which does not replace what the mapping has itself
            continue
        key = loader.construct_object(key_node, deep=True)  # type: ignore[no-untyped-call]
        if key in seen:
            raise yaml.YAMLError(f"key {key!r} stands twice, again in line {key_node.start_mark.line + 1}")
        seen.add(key)
    return loader.construct_mapping(node, deep=True)


def _integer(_loader: _StrictLoader, node: yaml.ScalarNode) -> int:
    """An integer that can be printed; Python refuses to print thousands of digits."""
    if len(node.value) > _LONGEST_NUMBER:
        raise yaml.YAMLError(f"a number in line {node.start_mark.line + 1} is too large: {len(node.value)} characters")
    return int(node.value, {"0o": 8, "0x": 16}.get(node.value[:2], 10))


def _float(_loader: _StrictLoader, node: yaml.ScalarNode) -> float:
    return float(re.sub(r"\.(?=inf|nan)", "", node.value.lower()))


_StrictLoader.add_constructor("tag:yaml.org,2002:int", _integer)
_StrictLoader.add_constructor("tag:yaml.org,2002:float", _float)
_StrictLoader.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, _mapping_without_duplicates)


def dump(value: Any, **how: Any) -> str:
    """A value as YAML that :func:`load_bounded` reads as the same value. `how`: as of ``yaml.dump``."""
    return str(yaml.dump(value, Dumper=_Dumper, sort_keys=False, allow_unicode=True, **how))


def load_bounded(text: str, most: int = _MOST_NODES) -> Any:
    """Plain YAML values of an untrusted text.

    A few hundred bytes of aliases can expand to billions of values. The values are counted before any is made, so that
    copying, merging or printing the result is safe.
    """
    loader = _StrictLoader(text)
    try:
        root = loader.get_single_node()
        if root is None:
            return None
        if _expanded_size(root, {}) > most:
            raise yaml.YAMLError(f"its aliases stand for more than {most} values")
        return loader.construct_document(root)
    except (AttributeError, LookupError):  # errors of PyYAML for !!timestamp x, !!bool x and an empty !!int
        raise yaml.YAMLError("a value is not of the type that its tag names") from None
    finally:
        loader.dispose()  # type: ignore[no-untyped-call]


def leading_zeros(text: str) -> list[str]:
    """Numbers of a text such as 0512, which readers of YAML 1.1 take in base 8 without an error."""
    try:
        scalars = [token for token in yaml.scan(text, _StrictLoader) if isinstance(token, yaml.ScalarToken)]
    except yaml.YAMLError:
        return []
    return [token.value for token in scalars if token.plain and re.fullmatch("[-+]?0[0-7]+", token.value)]


def _expanded_size(node: yaml.Node, known: dict[int, int]) -> int:
    """Number of values in a node with its aliases expanded; an alias is the same node object again."""
    if isinstance(node, yaml.ScalarNode):
        return 1
    if id(node) in known:
        if known[id(node)] == 0:
            raise yaml.YAMLError(f"a value holds itself, in line {node.start_mark.line + 1}")
        return known[id(node)]
    known[id(node)] = 0
    pairs = isinstance(node, yaml.MappingNode)
    parts = (part for pair in node.value for part in pair) if pairs else iter(node.value)
    known[id(node)] = 1 + sum(_expanded_size(part, known) for part in parts)
    return known[id(node)]


def read_mapping(path: Path, what: str, example: str) -> dict[str, Any]:
    """Read a YAML file that maps names to values."""
    try:
        kind = path.stat()
        if not stat.S_ISREG(kind.st_mode):  # a device may never end, a pipe may never begin
            raise BadInput(f"{path}: cannot be read: it is no file, expected a {what} file")
        if kind.st_size > _LARGEST_FILE:
            raise BadInput(f"{path}: {kind.st_size} bytes, which is no {what} file (a few kB expected)")
        with path.open("rb") as stream:
            content = load_bounded(stream.read(_LARGEST_FILE + 1).decode("utf-8"))
    except FileNotFoundError:
        raise BadInput(f"{path}: no such {what} file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(f"{path}: cannot be read: {' '.join(str(error).split())}") from None
    except (yaml.YAMLError, RecursionError, ValueError, TypeError) as error:
        raise BadInput(f"{path}: not valid YAML: {' '.join(str(error).split())[:300]}") from None
    if not isinstance(content, dict) or not all(isinstance(key, str) for key in content):
        raise BadInput(f"{path}: expected a mapping of names to values, as in {example}")
    return content


def validated(schema: type[Schema], content: dict[str, Any], where: str, switches: Collection[str] = ()) -> Schema:
    """Check a file's content by its schema."""
    for name in _switches(content):
        if name.rsplit(".", 1)[-1] not in switches:
            raise BadInput(f"{where}: {name} is yes or no: expected a number")
    try:
        return schema(**content)
    except ValidationError as error:
        raise BadInput(f"{where}: {_first_complaint(error, schema)}") from None
    except OverflowError as error:  # pydantic 1 meets an integer of hundreds of digits
        raise BadInput(f"{where}: a number is too large: {error}") from None


def _switches(content: dict[str, Any], prefix: str = "", depth: int = 0) -> Iterator[str]:
    """Paths of all booleans; pydantic would accept them as the numbers 1 and 0."""
    for key, value in content.items():
        if isinstance(value, bool):
            yield f"{prefix}{key}"
        elif isinstance(value, dict) and depth < _DEEPEST:
            yield from _switches(value, f"{prefix}{key}.", depth + 1)


def _first_complaint(error: ValidationError, schema: type[BaseModel]) -> str:
    """One line for pydantic's first error; unknown keys first, because a typo explains a missing key."""
    complaints = sorted(error.errors(), key=lambda item: "extra" not in str(item["type"]))
    first = complaints[0]
    kind, loc = str(first["type"]), first["loc"]
    # pydantic 2 adds the member of a union to the location, and reports each member.
    tried = kind.split("_", maxsplit=1)[0]
    if len(loc) > 1 and str(loc[-1]) == {"string": "str"}.get(tried, tried):
        loc = loc[:-1]
        complaints = [item for item in complaints if item is first or item["loc"][: len(loc)] != loc]
    where = ".".join(str(part) for part in loc)
    description = _at(loc, schema)[1]
    if kind == "invalid_key" or ("extra" in kind and not isinstance(loc[-1], str)):
        text = f"{where}: expected a name and a value there; decimals are written after a point, as 1.5"
    elif "extra" in kind:
        missing = [str(item["loc"][-1]) for item in complaints if "missing" in str(item["type"])]
        close = difflib.get_close_matches(str(loc[-1]), missing, 1, cutoff=0.5)
        text = f"unknown key {where!r}" + (f" (did you mean {close[0]!r}?)" if close else "")
    elif "missing" in kind:
        text = f"{where} is missing" + (f": {description}" if description else "")
    else:
        value = f" (found {reprlib.repr(first['input'])[:80]})" if "input" in first else ""
        text = f"{where}: {_expected(first, loc, schema)}{value}"
        text += f"; it is {description}" if description else ""
    more = len(complaints) - 1
    return text + (f"; and {more} more" if more else "")


def _expected(complaint: Mapping[str, Any], location: tuple[Any, ...], schema: type[BaseModel]) -> str:
    """The value that pydantic expected, in words without its class names."""
    kind, message = str(complaint["type"]), str(complaint["msg"])
    if kind in ("model_type", "type_error.dict", "model_attributes_type"):
        return f"expected entries {', '.join(fields_of(_at(location, schema)[0]))}"
    text = f"{message[:1].lower()}{message[1:]}"
    # pydantic 1 does not report the input.
    if "float" in kind and re.fullmatch(r"[-+]?\d+,\d+", str(complaint.get("input", "0,0"))):
        text += "; decimals are written after a point"
    return text


def _at(location: tuple[Any, ...], schema: type[BaseModel]) -> tuple[Any, str]:
    """The part of a schema at a location, and its description; empty where the schema has no such part."""
    node: Any = schema
    text = ""
    for part in location:
        field = fields_of(node).get(part)
        if field is None:
            return None, ""
        text = described(field)
        node = getattr(field, "annotation", None) or getattr(field, "outer_type_", None)
        # An optional part of a file is a union of its schema and None.
        node = next((part for part in get_args(node) if isinstance(part, type) and issubclass(part, BaseModel)), node)
    return node, text
