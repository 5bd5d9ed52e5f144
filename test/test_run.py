"""./run: what it says, what it refuses, and that it leaves a finished environment alone."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from pam_antagonist.__main__ import COMMANDS as PRODUCT
from validation.__main__ import COMMANDS as MEASUREMENTS

COMMANDS = {**PRODUCT, **MEASUREMENTS}

ROOT = Path(__file__).resolve().parents[1]
# What ./run itself uses; the compilers and cmake are what it looks for.
TOOLS = "awk bash cat dirname env find flock grep ls mkdir readlink rm sed sha256sum tail tr uname".split()


def start(*arguments: str, root: Path = ROOT, **variables: str) -> subprocess.CompletedProcess[str]:
    """``./run`` in a shell that nobody has set up, some variables apart."""
    environment = {name: os.environ[name] for name in ("HOME", "PATH") if name in os.environ}
    if "ROS_DISTRO" in os.environ:  # an installed ROS is part of what ./run set up
        environment = dict(os.environ)
    environment |= variables
    return subprocess.run(
        [root / "run", *arguments], env=environment, capture_output=True, text=True, check=False, timeout=120
    )


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """As much of a fresh clone as ./run reads before it sets anything up."""
    for name in ("run", "requirements.txt", "setup.py", "setup.cfg"):
        shutil.copy(ROOT / name, tmp_path)
    for package in ("pam_antagonist", "validation"):
        (tmp_path / package).mkdir()
        shutil.copy(ROOT / package / "__main__.py", tmp_path / package)
    shutil.copytree(ROOT / "pam_antagonist_msgs", tmp_path / "pam_antagonist_msgs")
    return tmp_path


@pytest.fixture
def bare_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A PATH without compilers, cmake and Python."""
    folder = tmp_path_factory.mktemp("bin")
    for name in TOOLS:
        (folder / name).symlink_to(str(shutil.which(name)))
    return folder


def test_help_lists_every_executable(checkout: Path) -> None:
    done = start("--help", root=checkout)
    assert done.returncode == 0
    for name, command in COMMANDS.items():
        assert any(line.split() == [name, *command.summary.split()] for line in done.stdout.splitlines()), name
    assert not (checkout / ".venv").exists()


def test_help_of_the_documentation_builds_nothing(checkout: Path) -> None:
    for option in ("--help", "-h"):
        done = start("docs", option, root=checkout)
        assert done.returncode == 0 and "--build" in done.stdout and not done.stderr
    done = start("docs", "--bulid", root=checkout)
    assert done.returncode == 2 and "expected --build" in done.stderr
    assert not (checkout / ".venv").exists()


@pytest.mark.parametrize(("typed", "meant"), [("relpay", "replay"), ("tset", "test"), ("newrig", "new_rig")])
def test_a_name_with_a_slip_is_answered_with_the_nearest_one(checkout: Path, typed: str, meant: str) -> None:
    done = start(typed, root=checkout)
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert f"did you mean {meant}?" in done.stderr


def test_unknown_name_is_refused_before_anything_is_set_up(checkout: Path) -> None:
    done = start("replya", root=checkout)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1
    assert "'replya'" in done.stderr
    assert "replay" in done.stderr
    assert not (checkout / ".venv").exists()


def test_every_executable_is_a_name_that_is_known(checkout: Path) -> None:
    (checkout / ".venv").mkdir()
    (checkout / ".venv/mine").touch()  # so that nothing is set up: it ends behind the check of the name
    for name in ("replay", "plant", "battery"):  # one of each kind; the names are those that --help lists
        assert "did not make it" in start(name, "--help", root=checkout).stderr, name


@pytest.mark.skipif(
    "ROS_DISTRO" in os.environ or Path("/opt/ros/jazzy").exists(),
    reason="with an installed ROS, other things are missing",
)
def test_every_missing_prerequisite_gets_one_line(checkout: Path, bare_path: Path) -> None:
    done = start("test", root=checkout, PATH=str(bare_path))
    assert done.returncode == 2
    lines = done.stderr.splitlines()
    assert [line.split(" not found")[0] for line in lines] == [
        "error: CPython 3.10 to 3.13", "error: cmake", "error: make", "error: cc", "error: c++",
    ]  # fmt: skip
    assert all("install" in line for line in lines)


def test_python_that_does_not_exist_is_named(checkout: Path) -> None:
    done = start("test", root=checkout, PYTHON="python-of-nobody")
    assert done.returncode == 2
    assert "PYTHON=python-of-nobody" in done.stderr
    assert done.stderr.count("\n") == 1


def test_other_ros_distribution_is_refused(checkout: Path) -> None:
    done = start("test", root=checkout, ROS_DISTRO="humble")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "'humble'" in done.stderr
    assert "Jazzy" in done.stderr


def test_environment_of_somebody_else_is_not_replaced(checkout: Path) -> None:
    mine = checkout / ".venv" / "mine"
    mine.parent.mkdir()
    mine.write_text("precious")
    done = start("test", root=checkout)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert ".venv exists" in done.stderr
    assert mine.read_text() == "precious"


@pytest.mark.skipif(not (ROOT / ".venv" / "READY").is_file(), reason="these tests were not started by ./run test")
class TestReady:
    """The environment that these tests run in."""

    code = "import os, sys; print(sys.executable, os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'])"

    def test_second_call_sets_up_nothing(self) -> None:
        before = (ROOT / ".venv" / "READY").stat().st_mtime_ns
        done = start("python", "-c", self.code)
        assert done.returncode == 0, done.stderr
        assert done.stderr == ""
        assert done.stdout.split() == [sys.executable, "LOCALHOST"]
        assert (ROOT / ".venv" / "READY").stat().st_mtime_ns == before

    def test_discovery_leaves_the_machine_only_when_asked(self) -> None:
        assert start("python", "-c", self.code, ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET").stdout.split()[1] == "SUBNET"

    def test_exit_status_and_arguments_are_passed_on(self) -> None:
        done = start("python", "-c", "import sys; print(sys.argv[1:]); sys.exit(3)", "a b", "*")
        assert (done.returncode, done.stdout) == (3, "['a b', '*']\n")

    def test_messages_are_there(self) -> None:
        done = start("python", "-c", "import rclpy; from pam_antagonist_msgs import msg; print(msg.JointEstimate.LATE)")
        assert (done.returncode, done.stdout) == (0, "64\n")

    def test_works_from_another_folder_and_through_a_link(self, tmp_path: Path) -> None:
        (tmp_path / "link").symlink_to(ROOT / "run")
        done = subprocess.run(
            [tmp_path / "link", "python", "-c", "import pam_antagonist as p, os; print(p.__file__, os.getcwd())"],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=True,
        )
        assert done.stdout.split() == [str(ROOT / "pam_antagonist/__init__.py"), str(tmp_path)]


def test_nothing_is_imported_from_where_one_happens_to_be(tmp_path: Path) -> None:
    """Nor from folders that PYTHONPATH names for another Python, or without a place."""
    other = tmp_path / "lib" / "python3.8" / "site-packages"
    other.mkdir(parents=True)
    for name in ("difflib", "signal", "re", "numpy", "pam_antagonist"):
        for folder in (tmp_path, other):
            (folder / f"{name}.py").write_text("raise SystemExit('a script of somebody was run')\n", encoding="utf-8")
    for words, status in ((["reachable", "--rig", "shin2022"], 0), (["reachabel"], 2)):
        environment = {**os.environ, "PYTHONPATH": f":{other}:.:", "PYTHONHOME": str(tmp_path)}
        done = subprocess.run(
            [ROOT / "run", *words], env=environment, cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert done.returncode == status, done.stderr
        assert "of somebody" not in done.stdout + done.stderr
    assert "did you mean reachable?" in done.stderr
