"""A lab's own effects, those of examples/lab_effects: from the rig file to the report, without a line of this package.

They are installed in a folder beside the package; every command runs in a process of its own, as it would in a lab.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FILES = {
    path.stem: path.read_text(encoding="utf-8") for path in sorted((ROOT / "examples" / "lab_effects").glob("*.py"))
}
RIG = """\
based_on: shin2022
name: lab
effects:
  {effects}
"""
STEPS = "--profile", "steps", "--duration", "36", "--seed", "3"

Run = Callable[..., "subprocess.CompletedProcess[str]"]


def install(folder: Path, files: dict[str, str]) -> None:
    """The package ``lab_effects`` as pip would leave it: the files, and their entry points."""
    (folder / "lab_effects").mkdir(parents=True)
    (folder / "lab_effects" / "__init__.py").write_text("", encoding="utf-8")
    for name, text in files.items():
        (folder / "lab_effects" / f"{name}.py").write_text(text, encoding="utf-8")
    about = folder / "lab_effects-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: lab-effects\nVersion: 1.0\n", encoding="utf-8")
    points = "".join(f"{name} = lab_effects.{name}\n" for name in files)
    (about / "entry_points.txt").write_text(f"[pam_antagonist.effects]\n{points}", encoding="utf-8")


def running(folder: Path, kernels: Path) -> Run:
    """Runs Python with a lab's package installed."""
    path = os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH"), str(ROOT)])])
    environment = {**os.environ, "PYTHONPATH": path, "NUMBA_CACHE_DIR": str(kernels)}

    def run(*arguments: object) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, *map(str, arguments)]
        return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)

    return run


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lab")
    install(folder, FILES)
    for name, effects in (
        ("end_stop", "end_stop: {stiffness: 8.0, gap: 0.06}"),
        ("sorption", "sorption: {capacity_1: 2.0e-11, time: 2.0}"),
        ("typo", "end_stop: {stifness: 8.0}"),
        ("high", "end_stop: {stiffness: 1.0e4}"),
    ):
        (folder / f"{name}.yaml").write_text(RIG.format(effects=effects), encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def run(lab: Path, tmp_path_factory: pytest.TempPathFactory) -> Run:
    return running(lab, tmp_path_factory.mktemp("kernels"))


def good(done: subprocess.CompletedProcess[str]) -> str:
    assert done.returncode == 0, done.stderr
    return done.stdout


FIRST = """
import numpy as np

from pam_antagonist._jit import COMPILING
from pam_antagonist.cli.first_start import FITS, REPLAY, compile_first
from pam_antagonist.estimation import Estimator, simulate_model
from pam_antagonist.model import lanes
from pam_antagonist.model.drive import Inputs
from pam_antagonist.rig import load_rig

rig = load_rig("shin2022")
before = COMPILING.kernels
assert set(REPLAY) <= set(FITS)
compile_first(FITS, rig)
Estimator(rig)
simulate_model(rig, np.full((2, 2), 5.0), np.full(2, 4e5))
starts, vectors = [np.array([[0.0, 0.0, 4e5, 4e5]])] * lanes.LANES, [rig.parameters("free")] * lanes.LANES
Inputs.even(2, 1e-3, command=np.full((2, 2), 5.0)).driven_each(starts, vectors)
print(COMPILING.kernels - before)
"""


@pytest.fixture(scope="module")
def starts(run: Run) -> list[subprocess.CompletedProcess[str]]:
    """The first two starts of all: what they compile is there for the tests that compute."""
    return [run("-c", FIRST) for _ in range(2)]


@pytest.mark.thorough(80)
def test_at_a_first_start_all_that_fits_need_is_compiled_by_processes_of_their_own(
    starts: list[subprocess.CompletedProcess[str]],
) -> None:
    assert [good(start) for start in starts] == ["0\n", "0\n"]
    assert "compiling for a rig without effects, once" in starts[0].stderr and starts[1].stderr == ""


@pytest.mark.slow
def test_a_rig_file_has_the_effect_and_its_typos_are_refused(lab: Path, run: Run) -> None:
    for name, words in (("typo", "did you mean 'stiffness'?"), ("high", "expected 0 to 500 N m/rad")):
        done = run("-m", "pam_antagonist", "simulate", "--rig", f"{name}.yaml", "--out", lab / name)
        assert done.returncode == 2
        assert words in done.stderr
        assert len(done.stderr.splitlines()) == 1


FILTER = """
import numpy as np
from pam_antagonist.estimation import Estimator, simulate_model
from pam_antagonist.simulation.excitation import profile
from pam_antagonist.rig import load_rig

rig = load_rig("sorption.yaml")
voltage = profile("steps", 8.0, rig.sample_period, seed=1)
truth = simulate_model(rig, voltage, np.array([450e3, 450e3]))
bound = 2.0e-11 * (truth.pressure[:, 0] - rig.atmosphere.pressure)
stamps = 10**18 + np.arange(len(voltage)) * round(rig.sample_period * 1e9)
run = Estimator(rig, "default").run(stamps, truth.pressure, voltage)
assert list(run.added) == ["bound_1"], list(run.added)
mass = run.added["bound_1"]
assert np.all(np.isfinite(mass)) and abs(mass[0] / bound[0] - 1.0) < 0.01
# It follows the pressure by two seconds.
late = np.empty(len(bound))
late[0] = bound[0]
for k in range(1, len(bound)):
    late[k] = late[k - 1] + rig.sample_period / 2.0 * (bound[k - 1] - late[k - 1])
assert np.max(np.abs(mass - late)) < 0.05 * np.ptp(late), np.max(np.abs(mass - late)) / np.ptp(late)
print("followed")
"""


@pytest.mark.thorough(45)
@pytest.mark.usefixtures("starts")
def test_the_filter_estimates_a_state_of_the_lab_s_own(run: Run) -> None:
    assert good(run("-c", FILTER)) == "followed\n"


@pytest.mark.thorough(30)
@pytest.mark.usefixtures("starts")
def test_close_loop_finds_the_effect_by_its_name(lab: Path, run: Run) -> None:
    good(run("-m", "pam_antagonist", "simulate", "--rig", "end_stop.yaml", "--out", "bag", *STEPS))
    told = good(run("-m", "pam_antagonist", "close_loop", "bag", "--rig", "shin2022", "--out", "found", "--no-figures"))
    assert "takes the joint up (end_stop)" in told
    report = json.loads((lab / "found" / "report.json").read_text(encoding="utf-8"))
    assert report["verdict"] == "effect"
    assert [effect["name"] for effect in report["effects"]] == ["end_stop"]
    value, std = (report["effects"][0]["parameters"]["stiffness"][key] for key in ("value", "std"))
    assert abs(value - 8.0) < max(4.0 * std, 0.8)
    assert "with " in report["sentence"] and "N m/rad takes the joint up" in report["sentence"]
    page = (lab / "found" / "report.html").read_text(encoding="utf-8")
    assert "takes the joint up (end_stop)" in page
    assert "end_stop" in (lab / "found" / "rig_extended.yaml").read_text(encoding="utf-8")
    # The refined rig is one that every command takes.
    arguments = "--rig", "found/rig_extended.yaml", "--out", "again", "--no-figures"
    good(run("-m", "pam_antagonist", "replay", "bag", *arguments))


@pytest.mark.slow
def test_the_effects_have_their_sections(run: Run) -> None:
    text = good(run("-m", "pam_antagonist.model.effects.page", "end_stop", "sorption"))
    assert text.startswith("## `end_stop`\n\nRubber on either side takes the joint up")
    assert "* `gap` $\\gamma$ (0.1; 0.01 to 1.5 rad): angle at which the joint meets it" in text
    assert "`bound_1`, `bound_2` $b_i$ [kg], with `capacity_i`: initial std 1e-07, noise 1e-09 a √s" in text


PROBE = """
from pam_antagonist._jit import cache_dir
from pam_antagonist.model.composition import joint_torque
from pam_antagonist.rig import load_rig
p = load_rig("end_stop.yaml").parameters()
print(cache_dir(), joint_torque(0.0, 0.2, 0.0, 0.2, None, p))
"""


@pytest.mark.thorough(7)
def test_a_change_of_the_file_is_noticed(tmp_path: Path) -> None:
    install(tmp_path, {"end_stop": FILES["end_stop"]})
    (tmp_path / "end_stop.yaml").write_text(RIG.format(effects="end_stop: {stiffness: 8.0}"), encoding="utf-8")
    run = running(tmp_path, tmp_path / "kernels")
    first = good(run("-c", PROBE)).split()
    file = tmp_path / "lab_effects" / "end_stop.py"
    file.write_text(FILES["end_stop"].replace("return -stiffness *", "return -2.0 * stiffness *"), encoding="utf-8")
    second = good(run("-c", PROBE)).split()
    assert second[0] != first[0]
    # 8 N m/rad beyond 0.1 rad, behind the change twice that.
    assert [float(torque) for _, torque in (first, second)] == pytest.approx([-0.8, -1.6])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('name="end_stop"', 'name="leak"'), "effect 'leak': this name is taken"),
        (
            ("0.1, 0.01, 1.5, 0.1,", "0.1, 0.2, 1.5, 0.3,"),
            "gap: bounds 0.2 to 1.5, expected ones that hold the neutral",
        ),
        (('source="linear spring behind a gap"', 'source=""'), "source is empty"),
        (("def push(stiffness, gap, joint_angle)", "def push(stiffness, gap, angle)"), "push asks for 'angle'"),
        (('"joint_torque"', '"joint_tork"'), "unknown hook 'joint_tork', expected one of spool_voltage, voltage_shift"),
        (("@inlined\n", ""), "expected a function with the decorator @inlined"),
    ],
)
def test_what_is_wrong_with_a_file_is_said_in_a_line(tmp_path: Path, change: tuple[str, str], words: str) -> None:
    assert change[0] in FILES["end_stop"]
    text = FILES["end_stop"].replace(*change)
    install(tmp_path, {"end_stop": text.replace("joint_angle", "angle") if "angle)" in change[1] else text})
    done = running(tmp_path, tmp_path / "kernels")("-c", "import pam_antagonist.model.dynamics")
    assert done.returncode == 1
    assert words in done.stderr.splitlines()[-1]
