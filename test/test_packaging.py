"""What is in the packages agrees with itself, and ends up where pip, colcon and ROS look for it."""

from __future__ import annotations

import ast
import importlib
import json
import os
import re
import shutil
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest
import yaml

import pam_antagonist
from pam_antagonist.__main__ import COMMANDS
from pam_antagonist._jit import cache_dir
from pam_antagonist.nodes import bridge, controller, estimator, plant
from pam_antagonist.nodes.parameters import DIAGNOSTICS_PERIOD, Parameter
from pam_antagonist.paths import config_dir

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = {"pam_antagonist", "pam_antagonist_msgs"}
LAUNCH_FILE = ROOT / "launch" / "pipeline.launch.py"
TABLES = {node.__name__.rsplit(".", 1)[1]: node.PARAMETERS for node in (plant, bridge, estimator, controller)}

# import name -> rosdep key; None: rosdep has no key, and the nodes do without.
ROSDEP = {
    "jinja2": "python3-jinja2",
    "joblib": "python3-joblib",
    "markupsafe": "python3-jinja2",  # comes with it
    "matplotlib": "python3-matplotlib",
    "numba": "python3-numba",
    "numpy": "python3-numpy",
    "PIL": "python3-pil",
    "plotly": None,
    "pydantic": "python3-pydantic",
    "rosbags": "python3-rosbags-pip",
    "scipy": "python3-scipy",
    "serial": "python3-serial",
    "tornado": "python3-tornado",
    "tqdm": "python3-tqdm",
    "yaml": "python3-yaml",
    "filterpy": "python3-filterpy-pip",
    # Extras that no node needs.
    "distributed": None,
    "h5py": None,
    "pandas": None,
    "pyarrow": None,
    "shtab": None,
    "sklearn": None,
    # Without it a fit takes longer.
    "threadpoolctl": None,
    # These come with rosbags.
    "backports": "python3-rosbags-pip",
    "lz4": "python3-rosbags-pip",
    "typing_extensions": "python3-rosbags-pip",
}
# distribution -> import name, where that is another one
IMPORTED_AS = {"pillow": "PIL", "pyserial": "serial", "pyyaml": "yaml", "scikit-learn": "sklearn"}


def run(*command: object, cwd: Path = ROOT, env: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(part) for part in command], cwd=cwd, env=env, capture_output=True, text=True, check=False, timeout=300
    )


def succeeds(*command: object, cwd: Path = ROOT, env: dict[str, str] | None = None) -> str:
    done = run(*command, cwd=cwd, env=env)
    assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def clone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sources as a fresh clone has them, in a folder of their own."""
    target = tmp_path_factory.mktemp("clone")
    leave = shutil.ignore_patterns("__pycache__", "*.egg-info")
    for name in ("config", "launch", "pam_antagonist", "pam_antagonist_msgs", "resource"):
        shutil.copytree(ROOT / name, target / name, ignore=leave)
    for path in ROOT.iterdir():
        if path.is_file():
            shutil.copy2(path, target)
    return target


# ------------------------------------------------------------------------------------------------ what is declared


def test_versions_agree() -> None:
    for manifest in (ROOT / "package.xml", ROOT / "pam_antagonist_msgs" / "package.xml"):
        assert f"<version>{pam_antagonist.__version__}</version>" in manifest.read_text(encoding="utf-8")
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == pam_antagonist.__version__
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert "## [Unreleased]" in changes
    assert f"## [{pam_antagonist.__version__}] - {citation['date-released']}" in changes


def test_hosted_ci_runs_the_command_of_a_clean_clone() -> None:
    workflow = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text(encoding="utf-8"))
    (job,) = workflow["jobs"].values()
    assert [step["run"] for step in job["steps"] if step.get("run", "").startswith(".ci/")] == [".ci/run"]
    assert os.access(ROOT / ".ci/run", os.X_OK)


def test_the_container_is_made_of_what_is_there() -> None:
    text = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    stages = re.findall(r"^FROM (\S+)(?: AS (\w+))?", text, re.MULTILINE)
    assert stages == [("ros:jazzy-ros-base", "tools"), ("tools", "")]
    folder = re.search(r"^WORKDIR (\S+)", text, re.MULTILINE)
    assert folder is not None and f'ENTRYPOINT ["{folder[1]}/run"]' in text
    for name, *arguments in (words.split() for words in re.findall(r"\./run (.*?)(?: \\)?\n", text)):
        module = importlib.import_module(COMMANDS[name].target.split(":")[0])
        module.parser().parse_args([word for word in arguments if word != "\\"])
    ignored = (ROOT / ".dockerignore").read_text(encoding="utf-8").split()
    assert {".venv", ".git"} <= set(ignored) and not {"config", "pam_antagonist", "pam_antagonist_msgs"} & set(ignored)
    content = json.loads((ROOT / ".devcontainer/devcontainer.json").read_text(encoding="utf-8"))
    assert (ROOT / ".devcontainer" / content["build"]["dockerfile"]).samefile(ROOT / "Dockerfile")
    assert content["build"]["target"] in {name for _, name in stages}
    assert not re.search(
        r"^(Dockerfile|\.devcontainer)", (ROOT / ".gitignore").read_text(encoding="utf-8"), re.MULTILINE
    )


def test_manifests_are_valid() -> None:
    catkin_pkg = pytest.importorskip("catkin_pkg.package", reason="catkin_pkg comes with colcon")
    for folder in (ROOT, ROOT / "pam_antagonist_msgs"):
        warnings: list[str] = []
        package = catkin_pkg.parse_package(str(folder / "package.xml"), warnings=warnings)
        assert package.package_format == 3
        assert warnings == []


def imported(*files: Path) -> set[str]:
    """Top-level names of all imports in some files, without the standard library."""
    names: set[str] = set()
    for file in files:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                names.add(node.module.split(".")[0])
    # compression is standard from Python 3.14 on.
    return names - set(sys.stdlib_module_names) - {"pam_antagonist", "compression"}


def test_package_xml_names_every_import() -> None:
    manifest = (ROOT / "package.xml").read_text(encoding="utf-8")
    declared = set(re.findall(r"<(?:exec|test)_depend>([^<]+)<", manifest))
    names = imported(*(ROOT / "pam_antagonist").rglob("*.py"), LAUNCH_FILE)
    needed = {ROSDEP.get(name, name) for name in names} - {None}
    assert needed <= declared


def test_setup_py_names_every_import_that_is_not_ros() -> None:
    requirements = metadata.requires("pam_antagonist")
    assert requirements is not None
    declared = {
        IMPORTED_AS.get(name, name) for name in (re.split(r"[^A-Za-z0-9_-]", text)[0].lower() for text in requirements)
    }
    assert imported(*(ROOT / "pam_antagonist").rglob("*.py")) & set(ROSDEP) <= declared


def test_installed_versions_are_within_the_declared_ranges() -> None:
    requirements = pytest.importorskip("packaging.requirements")
    for text in metadata.requires("pam_antagonist") or []:
        requirement = requirements.Requirement(text)
        if requirement.marker is not None and re.search(r'extra == "(compare|docs|peers)"', str(requirement.marker)):
            continue  # options that ./run does not install
        assert metadata.version(requirement.name) in requirement.specifier, text


def test_parameter_file_fits_the_nodes() -> None:
    content = yaml.safe_load((config_dir() / "pipeline.yaml").read_text(encoding="utf-8"))
    assert set(content) == {"/**"} | {f"/**/{name}" for name in TABLES}
    for key, section in content.items():
        nodes = list(TABLES) if key == "/**" else [key.rsplit("/", 1)[1]]
        for name, value in section["ros__parameters"].items():
            known = [entry for node in nodes for entry in _table(node) if entry.name == name]
            assert known, f"{key}: no node has a parameter {name}"
            for entry in known:
                entry.check(value)


def _table(node: str) -> tuple[Parameter, ...]:
    return (*TABLES[node], DIAGNOSTICS_PERIOD)


@pytest.fixture(scope="module")
def workspace(clone: Path) -> Path:
    """The clone after a ``colcon build`` of the package; ``./run`` has built the messages in the same way."""
    if shutil.which("colcon") is None:
        pytest.skip("colcon is not installed")
    environment = {**os.environ, "COLCON_HOME": str(clone / ".colcon")}
    assert set(succeeds("colcon", "list", "--names-only", cwd=clone, env=environment).split()) == PACKAGES
    succeeds("colcon", "build", "--packages-select", "pam_antagonist", cwd=clone, env=environment)
    return clone


@pytest.mark.thorough(5)
def test_colcon_puts_files_where_ros_looks(workspace: Path) -> None:
    install = workspace / "install"
    scripts = sorted(path.name for path in (install / "pam_antagonist/lib/pam_antagonist").iterdir())
    assert scripts == sorted([*COMMANDS, "pam"])
    share = install / "pam_antagonist/share"
    assert (share / "ament_index/resource_index/packages/pam_antagonist").is_file()
    assert (share / "pam_antagonist/package.xml").is_file()
    for file in (LAUNCH_FILE, *(path for path in (ROOT / "config").rglob("*") if path.is_file())):
        assert (share / "pam_antagonist" / file.relative_to(ROOT)).read_bytes() == file.read_bytes()
    built = [Path(prefix) / "share/pam_antagonist_msgs" for prefix in os.environ["AMENT_PREFIX_PATH"].split(":")]
    messages = next(folder for folder in built if folder.is_dir())
    for folder in (share / "pam_antagonist", messages):
        assert (folder / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()
    assert {path.name for path in (messages / "msg").glob("*.msg")} == {
        path.name for path in (ROOT / "pam_antagonist_msgs/msg").iterdir()
    }


@pytest.mark.thorough(4)
def test_built_executables_run_and_find_their_rigs(workspace: Path, tmp_path: Path) -> None:
    sourced = "source install/local_setup.bash && "
    script = "install/pam_antagonist/lib/pam_antagonist"
    # The built package; the rest from the environment that runs this test.
    path = [folder for folder in os.environ.get("PYTHONPATH", "").split(":") if folder != str(ROOT)]
    environment = {**os.environ, "PYTHONPATH": ":".join(path)}
    text = succeeds("bash", "-c", f"{sourced}{script}/estimator --help", cwd=workspace, env=environment)
    assert "pairing_timeout" in text
    code = "from pam_antagonist.paths import config_dir; from pam_antagonist_msgs import msg; print(config_dir())"
    (tmp_path / "where.py").write_text(code, encoding="utf-8")
    folder = succeeds("bash", "-c", f"{sourced}{sys.executable} {tmp_path}/where.py", cwd=workspace, env=environment)
    assert Path(folder.strip()) == workspace / "install/pam_antagonist/share/pam_antagonist/config"


# ------------------------------------------------------------------------------------------------ pip, without ROS


@pytest.fixture(scope="module")
def plain_python(clone: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The Python of an environment that holds the package's wheel and what it requires: no ROS, no extras."""
    folder = tmp_path_factory.mktemp("plain")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
    succeeds(*pip, "wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", folder, clone)
    succeeds(sys.executable, "-m", "venv", "--without-pip", folder / "venv")
    python = folder / "venv/bin/python"
    (wheel,) = folder.glob("*.whl")
    # With nothing on the path that could pass for the package.
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    succeeds(*pip, "--python", python, "install", "--no-deps", "--no-index", wheel, env=clean)
    _give(python, "")
    return python


def _give(python: Path, extra: str) -> None:
    """Have an environment find what the package requires with an extra; "" for none."""
    site = Path(succeeds(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))").strip())
    for path in _files_of_requirements("pam_antagonist", extra):
        if not (site / path.name).exists():
            (site / path.name).symlink_to(path)


def _files_of_requirements(name: str, extra: str) -> set[Path]:
    """Top-level files and folders of everything that a distribution requires with an extra."""
    requirements = pytest.importorskip("packaging.requirements")
    todo, seen, paths = [name], {name}, set()
    while todo:
        for text in metadata.requires(todo.pop()) or []:
            requirement = requirements.Requirement(text)
            if requirement.name in seen or (requirement.marker and not requirement.marker.evaluate({"extra": extra})):
                continue
            seen.add(requirement.name)
            todo.append(requirement.name)
            distribution = metadata.distribution(requirement.name)
            base = Path(str(distribution.locate_file("")))
            tops = {file.parts[0] for file in distribution.files or []} - {"..", "__pycache__"}
            paths |= {base / top for top in tops}
    return paths


@pytest.mark.thorough(9)
def test_pip_installation_replays_without_ros(plain_python: Path, tmp_path: Path) -> None:
    environment = {"PATH": os.defpath, "HOME": str(tmp_path)}
    # Machine code is kept by what it is made of, wherever the package lies: here it need not be compiled once more.
    (tmp_path / ".cache").mkdir()
    (tmp_path / ".cache" / "pam_antagonist").symlink_to(cache_dir().parent)
    pam = plain_python.parent / "pam"
    for absent in ("rclpy", "pam_antagonist_msgs", "sensor_msgs", "pytest", "matplotlib", "plotly", "serial", "pandas"):
        assert run(plain_python, "-c", f"import {absent}", cwd=tmp_path, env=environment).returncode == 1, absent
    code = "from pam_antagonist.paths import config_dir; print(config_dir())"
    where = succeeds(plain_python, "-c", code, cwd=tmp_path, env=environment)
    assert Path(where.strip()) == plain_python.parents[1] / "share/pam_antagonist/config"
    simulated = ["simulate", "--rig", "shin2022", "--out", "bag", "--profile", "steps", "--duration", "2"]
    assert "\npam replay bag" in succeeds(pam, *simulated, cwd=tmp_path, env=environment)

    done = run(pam, "replay", "bag", "--rig", "shin2022", "--out", "core", cwd=tmp_path, env=environment)
    assert done.returncode == 0, done.stderr
    (said,) = [line for line in done.stderr.splitlines() if "plotly" in line]
    assert "pip install 'pam_antagonist[reports]'" in said
    assert "Plotly" not in (tmp_path / "core/report.html").read_text(encoding="utf-8")

    _give(plain_python, "reports")
    succeeds(pam, "replay", "bag", "--rig", "shin2022", "--out", "result", cwd=tmp_path, env=environment)
    report = json.loads((tmp_path / "result/report.json").read_text(encoding="utf-8"))
    assert report["samples"] == pytest.approx(2000, abs=2)
    assert report["software"]["pam_antagonist"] != "not installed"
    assert "Plotly" in (tmp_path / "result/report.html").read_text(encoding="utf-8")


@pytest.mark.thorough(4)
def test_pip_puts_one_command_on_the_path(plain_python: Path, tmp_path: Path) -> None:
    there = {path.name for path in plain_python.parent.iterdir()}
    assert "pam" in there and not there & set(COMMANDS)
    said = succeeds(plain_python.parent / "pam", "--version", cwd=tmp_path, env={"HOME": str(tmp_path)})
    assert said == f"pam_antagonist {pam_antagonist.__version__}\n"
