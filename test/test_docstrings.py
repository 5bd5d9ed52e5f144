"""Docstrings are complete where others rely on them: the Python API, and what a room's ``__init__`` exports.

Every public module, class, function and method has a docstring; a method that overrides another may have that one's.
A section names only arguments and fields that exist, and gives quantities their units. Inside a room a docstring needs
no sections: it says what name and type do not. For names in an ``__all__`` the rule is:

* A function with three or more arguments has a section ``Args`` that names all of them. With one or two arguments the
  sentence may say what they are. A section ``Args`` always names all of them. Arguments of a class stand in the
  docstring of the class or of its ``__init__``.
* A dataclass or NamedTuple with two or more public fields names all of them in a section ``Attributes`` or ``Args``.
* A function that raises ``BadInput`` itself says so in ``Raises``.
* A section that describes an array names its shape, as ``(N, 2)``.
* A section that describes a number whose name is a physical quantity names its unit, as ``[Pa]``, or where it stands.
  Kernels have no annotations; each of their arguments is a number.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "pam_antagonist"

LEAST = 3
"""From so many arguments on a section ``Args`` is needed."""

Function = ast.FunctionDef | ast.AsyncFunctionDef
ARRAYS = re.compile(r"\b(ndarray|NDArray|FloatArray|Floats|Array)\b")
QUANTITY = re.compile(
    r"(^|_)(angle|velocity|torque|pressure|voltage|force|stiffness|mass|length|volume|flow|temperature|duration|period|"
    r"time|dt)s?(_\d)?$"
)
NUMBER = re.compile(r"^$|^float\b|^NDArray|^Floats|^FloatArray")
UNIT = re.compile(r"\[[^\[\]]+\]|\bunits?\b|\bseconds\b|\blikewise\b|\bas (for|in|of|from)\b|\brelative\b")
SHAPE = re.compile(r"\([^()]*[A-Za-z0-9][^()]*,[^()]*\)|\bany shape\b|\bsame shape\b|\blikewise\b|\bas (for|in|from)\b")


def sections(docstring: str) -> dict[str, dict[str, str]]:
    """Sections of a Google docstring: name -> entry -> its text."""
    found: dict[str, dict[str, str]] = {}
    section, entry = "", ""
    for line in docstring.splitlines():
        if re.fullmatch(r"(Args|Attributes|Returns|Raises|Yields):", line):
            section, entry = line[:-1], ""
            found[section] = {}
        elif section and line and not line.startswith(" "):
            section = ""
        elif section:
            match = re.match(r"    (\*{0,2}[\w, *.]+): *(.*)", line) if not line.startswith("     ") else None
            if match:
                for entry in (name.strip().lstrip("*") for name in match[1].split(",")):
                    found[section][entry] = match[2]
            elif entry:
                found[section][entry] += " " + line.strip()
    return found


def arguments(function: Function, method: bool) -> list[ast.arg]:
    """Arguments of a function without ``self`` and ``cls``."""
    spec = function.args
    found = [*spec.posonlyargs, *spec.args, *spec.kwonlyargs, *(arg for arg in (spec.vararg, spec.kwarg) if arg)]
    static = any(isinstance(item, ast.Name) and item.id == "staticmethod" for item in function.decorator_list)
    return [arg for arg in found[1 if method and not static else 0 :] if not arg.arg.startswith("_")]


def raises_bad_input(function: Function) -> bool:
    """Whether a function raises ``BadInput`` itself, in no function inside of it."""
    waiting: list[ast.AST] = list(function.body)
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Raise) and node.exc is not None and "BadInput" in ast.unparse(node.exc):
            return True
        if not isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda, ast.ClassDef)):
            waiting += ast.iter_child_nodes(node)
    return False


def _decorated(node: ast.AST, *names: str) -> bool:
    return any(ast.unparse(item).split("(")[0].split(".")[-1] in names for item in getattr(node, "decorator_list", ()))


def of_arguments(needed: list[ast.arg], described: dict[str, str], least: int) -> Iterator[str]:
    """What a section leaves out: names where there are ``least`` or more, shapes, and units."""
    if len(needed) >= least or described:
        yield from (f"argument {arg.arg} is not described" for arg in needed if arg.arg not in described)
    for arg in needed:
        text = described.get(arg.arg)
        kind = ast.unparse(arg.annotation) if arg.annotation else ""
        if text is not None and ARRAYS.search(kind) and not SHAPE.search(text):
            yield f"array {arg.arg} has no shape"
        yield from of_unit(arg.arg, kind, text)


def of_unit(name: str, kind: str, text: str | None) -> Iterator[str]:
    """Whether the text on a number that is a physical quantity lacks its unit."""
    if text is not None and QUANTITY.search(name) and NUMBER.search(kind) and not UNIT.search(text):
        yield f"{name} has no unit"


def of_function(function: Function, method: bool) -> Iterator[str]:
    """What the docstring of a function leaves out."""
    text = ast.get_docstring(function)
    if text is None:
        yield from () if _decorated(function, "override") else ("no docstring",)
        return
    if _decorated(function, "property", "setter", "cached_property"):
        return
    found = sections(text)
    if text.startswith("As rclpy;"):  # the arguments are those of the method that is overridden
        return
    yield from of_arguments(arguments(function, method), found.get("Args", {}), LEAST)
    if raises_bad_input(function) and "BadInput" not in found.get("Raises", {}):
        yield "BadInput is not in Raises"


def of_class(cls: ast.ClassDef) -> Iterator[str]:
    """What the docstring of a class leaves out."""
    text = ast.get_docstring(cls)
    if text is None:
        yield "no docstring"
        return
    found = sections(text)
    described = {**found.get("Args", {}), **found.get("Attributes", {})}
    fields = {
        item.target.id: ast.unparse(item.annotation)
        for item in cls.body
        if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name) and "ClassVar" not in str(item)
    }
    public = [name for name in fields if not name.startswith("_")]
    for name in public:
        yield from of_unit(name, fields[name], described.get(name))
    plain = _decorated(cls, "dataclass") or any(ast.unparse(base) == "NamedTuple" for base in cls.bases)
    if plain and len(public) >= 2:
        yield from (f"field {name} is not described" for name in public if name not in described)
    for item in cls.body:
        if isinstance(item, ast.FunctionDef) and item.name == "__init__":
            own = sections(ast.get_docstring(item) or "").get("Args", {})
            yield from of_arguments(arguments(item, True), {**described, **own}, LEAST)
            if raises_bad_input(item) and "BadInput" not in found.get("Raises", {}):
                yield "BadInput of __init__ is not in Raises"


def exported(package: Path) -> dict[str, set[str]]:
    """Room -> names in the ``__all__`` of its ``__init__``; the package itself is the room without a name."""
    found: dict[str, set[str]] = {}
    for path in package.rglob("__init__.py"):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
                found["/".join(path.parent.relative_to(package).parts[:1])] = set(ast.literal_eval(node.value))
    return found


def of_inner(node: Function | ast.ClassDef, method: bool) -> Iterator[str]:
    """What is wrong with the docstring of a name that stays inside its room."""
    text = ast.get_docstring(node)
    if text is None:
        yield from () if _decorated(node, "override") else ("no docstring",)
        return
    found = sections(text)
    if isinstance(node, ast.ClassDef):
        known = {item.target.id: item.annotation for item in node.body
                 if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name)}  # fmt: skip
        for item in node.body:
            if isinstance(item, ast.FunctionDef) and item.name == "__init__":
                known |= {arg.arg: arg.annotation or ast.Constant("") for arg in arguments(item, True)}
        inherits = True  # attributes may be properties, or set by a method
    else:
        known = {arg.arg: arg.annotation or ast.Constant("") for arg in arguments(node, method)}
        inherits = False
    for name, described in {**found.get("Args", {}), **found.get("Attributes", {})}.items():
        if name in known:
            kind = ast.unparse(known[name])
            yield from of_unit(name, "" if kind == "''" else kind, described)
        elif not inherits:
            yield f"{name} is described and does not exist"


def missing(path: Path, full: set[str] | None = None) -> Iterator[tuple[int, str, str]]:
    """Line, name, and what the docstring there leaves out; names in ``full`` need all sections (None: each name)."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    if ast.get_docstring(tree) is None:
        yield 1, path.stem, "no docstring"

    def walk(body: list[ast.stmt], prefix: str) -> Iterator[tuple[int, str, str]]:
        for node in body:
            if not isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)) or node.name.startswith("_"):
                continue
            name = f"{prefix}{node.name}"
            inner = full is not None and name.split(".", maxsplit=1)[0] not in full
            if isinstance(node, ast.ClassDef):
                yield from ((node.lineno, name, what) for what in (of_inner(node, False) if inner else of_class(node)))
                yield from walk(node.body, f"{name}.")
            elif not _decorated(node, "overload", "setter"):
                judge = of_inner if inner else of_function
                yield from ((node.lineno, name, what) for what in judge(node, bool(prefix)))

    yield from walk(tree.body, "")


def incomplete(package: Path) -> list[str]:
    """One line for each thing that a docstring of the package leaves out."""
    names = exported(package)
    found = []
    for path in sorted(package.rglob("*.py")):
        inside = path.relative_to(package).parts
        full = names.get("", set()) | names.get(inside[0], set()) if names else None
        found += [f"{'/'.join(inside)}:{line}: {name}: {what}" for line, name, what in missing(path, full)]
    return found


def test_public_docstrings_are_complete() -> None:
    found = incomplete(ROOT / PACKAGE)
    assert not found, f"{len(found)} docstrings are incomplete:\n" + "\n".join(found)


@pytest.mark.parametrize(
    ("code", "what"),
    [
        ("def f(): ...", "f: no docstring"),
        ("class A: ...", "A: no docstring"),
        ('def f(a, b, c):\n    """F."""', "f: argument a is not described"),
        ('def f(a, b):\n    """F.\n\n    Args:\n        a: one.\n    """', "f: argument b is not described"),
        ('def f(a: np.ndarray):\n    """F.\n\n    Args:\n        a: values.\n    """', "f: array a has no shape"),
        ('def f(pressure):\n    """F.\n\n    Args:\n        pressure: of it.\n    """', "f: pressure has no unit"),
        ('class A:\n    """A.\n\n    Attributes:\n        dt: step.\n    """\n    dt: float', "A: dt has no unit"),
        ('def f(a):\n    """F."""\n    raise BadInput(a)', "f: BadInput is not in Raises"),
        ('@dataclass\nclass A:\n    """A."""\n    a: int\n    b: int', "A: field a is not described"),
        ('class A:\n    """A."""\n    def __init__(self, a, b, c): ...', "A: argument a is not described"),
        ('class A:\n    """A."""\n    def f(self): ...', "A.f: no docstring"),
    ],
)
def test_what_is_missing_is_found(tmp_path: Path, code: str, what: str) -> None:
    (tmp_path / "a.py").write_text(f'"""A module."""\n{code}\n', encoding="utf-8")
    assert any(line.endswith(what) for line in incomplete(tmp_path))


def test_names_that_a_room_exports_need_all_sections(tmp_path: Path) -> None:
    (tmp_path / "room").mkdir()
    (tmp_path / "room" / "__init__.py").write_text('"""R."""\n__all__ = ["f"]\n', encoding="utf-8")
    code = '"""M."""\ndef f(a, b, c):\n    """F."""\n\n\ndef g(a, b, c):\n    """G."""\n\n\ndef h(): ...\n'
    code += '\n\ndef k(a):\n    """K.\n\n    Args:\n        b: gone.\n    """\n'
    (tmp_path / "room" / "m.py").write_text(code, encoding="utf-8")
    found = [line.split(": ", 1)[1] for line in incomplete(tmp_path)]
    missing_of_f = [f"f: argument {name} is not described" for name in "abc"]
    assert found == [*missing_of_f, "h: no docstring", "k: b is described and does not exist"]


@pytest.mark.parametrize(
    "code",
    [
        'def f(a, b):\n    """F of one thing by another."""',
        'def f(a, b):\n    """F.\n\n    Args:\n        a, b: both.\n    """',
        'def f(a: np.ndarray):\n    """F.\n\n    Args:\n        a: values (N, 2) [Pa].\n    """',
        'def f(dt, length: int):\n    """F.\n\n    Args:\n        dt: step [s].\n        length: of a list.\n    """',
        "def _f(a, b): ...",
        'class A(B):\n    """A."""\n    @override\n    def f(self): ...',
        'class A:\n    """A."""\n    @property\n    def f(self):\n        """F."""\n        raise BadInput("x")',
    ],
)
def test_what_is_complete_passes(tmp_path: Path, code: str) -> None:
    (tmp_path / "a.py").write_text(f'"""A module."""\n{code}\n', encoding="utf-8")
    assert incomplete(tmp_path) == []
