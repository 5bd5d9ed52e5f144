"""Imports go one way. The table below is the architecture."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

import pam_antagonist

API = set(pam_antagonist.__all__) - {"__version__"}
ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "pam_antagonist"

BASE = "base"  # errors, optional, blas, numbers, program, shown, start, _jit: what every module may use
FILES = "files"  # paths, strict_yaml, strict_json, report_keys: reading and writing files
PLACES = {
    "errors": BASE,
    "blas": BASE,
    "numbers": BASE,
    "start": BASE,
    "optional": BASE,
    "program": BASE,
    "shown": BASE,
    "_jit": BASE,
    "paths": FILES,
    "strict_yaml": FILES,
    "strict_json": FILES,
    "report_keys": FILES,
}
"""Layer of a module that lies in no folder. A folder is a layer of its own name."""

_PHYSICS = (BASE, "model", FILES, "rig")
_OFFLINE = (*_PHYSICS, "estimation", "recording")
_RESULTS = (*_OFFLINE, "replays", "inference", "identification", "diagnosis")
_ONLINE = ("simulation", "control", "safety", "hardware", "nodes")

MAY_IMPORT: dict[str, tuple[str, ...]] = {
    BASE: (),
    "model": (BASE,),
    FILES: (BASE,),
    "rig": (BASE, "model", FILES),
    "estimation": (BASE, "model", "rig"),
    "simulation": (*_PHYSICS, "estimation"),
    "control": (BASE, "model"),
    "safety": (BASE, "control", "estimation"),
    "hardware": (BASE, FILES, "simulation", "safety"),
    "recording": (BASE, FILES, "estimation"),
    "replays": _OFFLINE,
    "checks": _OFFLINE,
    "inference": _OFFLINE,
    "identification": (*_OFFLINE, "replays", "inference"),
    "diagnosis": (*_OFFLINE, "replays", "inference", "identification"),
    "design": (*_OFFLINE, "simulation", "inference", "identification", "diagnosis"),
    "report": (*_RESULTS, "design", "control"),
    "nodes": (*_OFFLINE, "diagnosis", "simulation", "control", "safety", "hardware"),
    "api": (*_RESULTS, "simulation", "checks", "design", "report"),
    "__init__": (BASE, "rig", "estimation", "recording", "api"),  # the names of the Python API
    "cli": (*_RESULTS, *_ONLINE, "design", "checks", "report", "api"),
    "__main__": (BASE,),  # it names the executables and imports the one that is asked for
}
"""Layer -> the layers that it may import. A layer imports only layers that stand before it."""

LIBRARIES: dict[str, tuple[str, ...]] = {
    BASE: ("numba", "threadpoolctl", "typing_extensions"),
    "model": ("numpy", "numba", "typing_extensions"),
    "control": ("numpy",),
    "safety": (),
    "estimation": ("numpy", "numba", "scipy", "typing_extensions"),
}
"""Layer -> the libraries that it may import. Layers that are not here may import any except ROS."""

ROS = re.compile(r"rclpy|rcl_interfaces|builtin_interfaces|rosgraph_msgs|std_srvs|launch|\w+_msgs")
LABORATORY = "validation"
"""Measures the product from a checkout, and is not installed: nothing in the package may import it."""


class Import(NamedTuple):
    """One import statement.

    Attributes:
        file: that it stands in, relative to the package.
        line: of the statement.
        layer: of the file.
        module: that it imports, with its package.
    """

    file: str
    line: int
    layer: str
    module: str


def layer_of(module: str) -> str:
    """The layer of a module of the package, such as ``rig`` for ``pam_antagonist.rig.file``."""
    first = module.split(".")[1] if "." in module else BASE
    return PLACES.get(first, first)


def imports(path: Path, package: Path) -> Iterator[Import]:
    """Every import of a file: at its top, in functions, for types, and modules that are named in a string."""
    file = path.relative_to(package).as_posix()
    parts = (package.name, *path.relative_to(package).with_suffix("").parts)
    layer = "__init__" if file == "__init__.py" else layer_of(".".join(part for part in parts if part != "__init__"))
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        modules: list[str] = []
        if isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(parts[: len(parts) - node.level]) if node.level else ""
            module = ".".join(part for part in (base, node.module) if part)
            # "from pam_antagonist import rig" imports a layer, "from pam_antagonist import __version__" does not.
            below = [alias.name for alias in node.names if (package / alias.name).exists() or alias.name in PLACES]
            below += ["__init__" for alias in node.names if alias.name in API]
            modules = [f"{module}.{name}" for name in below] if module == package.name else [module]
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and layer != "__main__":
            # What importlib or a process of its own starts.
            names = rf"({package.name}|{LABORATORY})\.\w+(\.\w+)+"
            modules = [node.value] if re.fullmatch(names, node.value) else []
        for module in modules:
            yield Import(file, getattr(node, "lineno", 0), layer, module)


def forbidden(package: Path) -> list[str]:
    """One line for each arrow that the tables do not allow."""
    found = []
    for path in sorted(package.rglob("*.py")):
        for item in imports(path, package):
            first = item.module.split(".")[0]
            where = f"{item.file}:{item.line}"
            if first == package.name:
                to = layer_of(item.module)
                if to not in (item.layer, *MAY_IMPORT.get(item.layer, ())):
                    found.append(f"{where}: {item.layer} -> {to} ({item.module})")
            elif first == LABORATORY:
                found.append(f"{where}: {item.layer} -> {LABORATORY} ({item.module})")
            elif ROS.fullmatch(first):
                if item.layer != "nodes":
                    found.append(f"{where}: {item.layer} -> ROS ({item.module})")
            elif item.layer in LIBRARIES and first not in (*sys.stdlib_module_names, *LIBRARIES[item.layer]):
                found.append(f"{where}: {item.layer} -> {first}, expected one of {LIBRARIES[item.layer]}")
    return found


def test_imports_go_one_way() -> None:
    arrows = forbidden(ROOT / PACKAGE)
    assert not arrows, "imports that the table does not allow:\n" + "\n".join(arrows)


def test_every_folder_is_a_layer() -> None:
    package = ROOT / PACKAGE
    folders = {path.parent.name for path in package.glob("*/__init__.py")}
    modules = {path.stem for path in package.glob("*.py")}
    assert folders | {PLACES.get(module, module) for module in modules} == set(MAY_IMPORT)


def test_the_table_has_no_circle() -> None:
    order = list(MAY_IMPORT)
    for layer, below in MAY_IMPORT.items():
        assert all(order.index(other) < order.index(layer) for other in below), f"{layer} imports a layer after it"


@pytest.mark.parametrize(
    ("file", "line", "arrow"),
    [
        ("model/law.py", "from pam_antagonist.rig import Rig", "model -> rig"),
        ("model/law.py", "def f():\n    import pam_antagonist.rig.file", "model -> rig"),
        ("model/law.py", "if TYPE_CHECKING:\n    from pam_antagonist import rig", "model -> rig"),
        ("model/effects/law.py", "from ...rig import load", "model -> rig"),
        ("model/law.py", "import scipy", "model -> scipy"),
        ("diagnosis/a.py", "from pam_antagonist.report.html import render", "diagnosis -> report"),
        ("cli/a.py", "from validation.paper import page", "cli -> validation"),
        ("nodes/a.py", "start('validation.faults.relay')", "nodes -> validation"),
        ("model/law.py", "from pam_antagonist import load_rig", "model -> __init__"),
        ("cli/a.py", "import rclpy.node", "cli -> ROS"),
        ("recording/a.py", "from sensor_msgs.msg import FluidPressure", "recording -> ROS"),
    ],
)
def test_a_forbidden_import_is_found(tmp_path: Path, file: str, line: str, arrow: str) -> None:
    path = tmp_path / PACKAGE / file
    path.parent.mkdir(parents=True)
    (tmp_path / PACKAGE / "rig").mkdir()
    path.write_text(line, encoding="utf-8")
    (message,) = forbidden(tmp_path / PACKAGE)
    assert arrow in message and message.startswith(f"{file}:{line.count(chr(10)) + 1}:")


@pytest.mark.parametrize(
    ("file", "line"),
    [
        ("nodes/a.py", "import rclpy"),
        ("rig/a.py", "from pam_antagonist.model import joint\nimport pydantic"),
        ("rig/a.py", "from .load import load_rig"),
        ("cli/a.py", "from pam_antagonist import __version__"),
    ],
)
def test_an_allowed_import_passes(tmp_path: Path, file: str, line: str) -> None:
    path = tmp_path / PACKAGE / file
    path.parent.mkdir(parents=True)
    path.write_text(line, encoding="utf-8")
    assert forbidden(tmp_path / PACKAGE) == []
