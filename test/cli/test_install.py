"""`pip install .` in a plain environment is enough to replay: no ROS, nothing that is not declared."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[2]
BUILD_TOOL = "setuptools"


def _closure(requirements: list[str]) -> list[str]:
    """Distributions that are asked for, and what those ask for themselves."""
    todo = [Requirement(text) for text in requirements]
    found: set[str] = set()
    while todo:
        requirement = todo.pop()
        wanted = requirement.marker is None or requirement.marker.evaluate({"extra": ""})
        if wanted and requirement.name not in found:
            found.add(requirement.name)
            todo += [Requirement(text) for text in metadata.distribution(requirement.name).requires or []]
    return sorted(found)


def _link_distributions(names: list[str], folder: Path) -> None:
    """Make the files of these distributions, and of no other, importable from a folder."""
    for name in names:
        files = metadata.distribution(name).files
        if files is None:
            pytest.skip(f"{name} does not say which files it consists of, so it cannot be set apart")
        for top in {file.parts[0] for file in files if file.parts[0] not in ("..", "__pycache__")}:
            target = Path(str(metadata.distribution(name).locate_file(top)))
            if not (folder / top).exists():
                (folder / top).symlink_to(target)


@pytest.mark.slow
def test_pip_install_in_a_plain_environment_is_enough_to_replay(bag: Path, tmp_path: Path) -> None:
    environment = tmp_path / "plain"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(environment)], check=True)
    (site,) = (environment / "lib").glob("python*/site-packages")
    # Files of this environment stand in for what pip would download; nothing else of it can be seen.
    _link_distributions([BUILD_TOOL], site)
    source = tmp_path / "source"
    unwanted = shutil.ignore_patterns(".git", ".venv", "build", "install", "log", "*.egg-info", "__pycache__", "test")
    shutil.copytree(ROOT, source, ignore=unwanted)
    clean = {name: os.environ[name] for name in ("PATH", "HOME", "LANG", "NUMBA_CACHE_DIR") if name in os.environ}
    python = str(environment / "bin" / "python")
    pip = [
        sys.executable,
        "-m",
        "pip",
        "--python",
        python,
        "install",
        "--no-deps",
        "--no-index",
        "--no-build-isolation",
    ]
    done = subprocess.run([*pip, str(source)], env=clean, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    shutil.rmtree(source)
    (installed,) = metadata.distributions(name="pam_antagonist", path=[str(site)])
    assert installed.requires
    _link_distributions(_closure(installed.requires), site)

    ros = subprocess.run([python, "-c", "import rclpy"], env=clean, cwd=tmp_path, capture_output=True, check=False)
    assert ros.returncode != 0, "this environment is not plain"
    command = [python, "-m", "pam_antagonist", "replay", str(bag), "--rig", "shin2022", "--out", str(tmp_path / "out")]
    done = subprocess.run(command, env=clean, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["samples"] == 4000
    assert report["software"]["pam_antagonist"] != "not installed"
    assert "Plotly" in (tmp_path / "out" / "report.html").read_text()
