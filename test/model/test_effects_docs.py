"""docs/effects.md says what the catalogue says, and its recipe for a thirteenth effect works."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from pam_antagonist.model.effects import CATALOGUE, AddedState, EffectParameter

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")
SECTIONS = dict(re.findall(r"^## `(\w+)`\n(.*?)(?=^## )", TEXT, flags=re.MULTILINE | re.DOTALL))


def table(section: str, title: str) -> list[list[str]]:
    """Cells of the table whose first column has this title."""
    lines = section.splitlines()
    starts = [k for k, line in enumerate(lines) if line.startswith(f"| {title} |")]
    if not starts:
        return []
    rows = []
    for line in lines[starts[0] + 2 :]:
        if not line.startswith("|"):
            break
        rows.append([cell.strip() for cell in line.strip("|").split("|")])
    return rows


def test_a_section_for_each_effect_in_the_catalogue_s_order():
    assert list(SECTIONS) == list(CATALOGUE)


@pytest.mark.parametrize("name", CATALOGUE)
def test_words(name):
    effect, section = CATALOGUE[name], SECTIONS[name]
    assert effect.meaning in section
    assert f"*Source* {effect.source}." in section
    assert f"*Signature* {effect.signature}" in section
    assert "```math" in section


@pytest.mark.parametrize("name", CATALOGUE)
def test_parameters(name):
    def row(item: EffectParameter) -> list[str]:
        numbers = [f"{value:g}" for value in (item.neutral, item.low, item.high)]
        return [f"`{item.name}`", item.unit, *numbers, item.meaning]

    shown = [[cells[0], *cells[2:]] for cells in table(SECTIONS[name], "parameter")]
    assert shown == [row(item) for item in CATALOGUE[name].parameters]


@pytest.mark.parametrize("name", CATALOGUE)
def test_states(name):
    def row(state: AddedState) -> list[str]:
        noise = f"`{state.noise}`" if isinstance(state.noise, str) else f"{state.noise:g}"
        switches = " or ".join(f"`{name}`" for name in (state.switch, *state.further))
        return [f"`{state.name}`", state.unit, switches, f"{state.initial_std:g}", noise]

    shown = [[cells[0], *cells[2:]] for cells in table(SECTIONS[name], "added state")]
    assert shown == [row(state) for state in CATALOGUE[name].states]
    assert bool(shown) != ("No added state." in SECTIONS[name])


def test_files_and_functions_that_it_names_are_there():
    for name, section in SECTIONS.items():
        path, functions = re.search(r"\]\(\.\./(pam_antagonist/model/\w+\.py)\) · (.*)", section).groups()
        source = (ROOT / path).read_text(encoding="utf-8")
        for function in re.findall(r"`(\w+)`", functions):
            assert f"def {function}(" in source, (name, function)


def applied(folder: Path) -> int:
    """Make the page's changes to a copy of the package; each must fit at exactly one place."""
    blocks = re.findall(r"^```diff (\S+)\n(.*?)^```", TEXT, flags=re.MULTILINE | re.DOTALL)
    for path, block in blocks:
        lines = block.splitlines()
        assert all(line[:1] in ("+", "-", " ", "") for line in lines)
        before = "".join(f"{line[1:]}\n" for line in lines if not line.startswith("+"))
        after = "".join(f"{line[1:]}\n" for line in lines if not line.startswith("-"))
        file = folder / path
        source = file.read_text(encoding="utf-8") if before else ""
        assert not before or source.count(before) == 1, (
            f"{path}: these lines stand there {source.count(before)} times:\n{before}"
        )
        file.write_text(source.replace(before, after) if before else after, encoding="utf-8")
    return len(blocks)


TRIAL = """
import numpy as np
from pam_antagonist.model import dynamics, parameters as par, rest
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.rig import load_rig

assert len(CATALOGUE) == 13 and list(CATALOGUE)[-1] == "bumper"
rig = load_rig("RIG")
p, base = rig.parameters(), load_rig("shin2022").parameters()
assert p[par.BUMPER_STIFFNESS] == 40.0 and p[par.STATELESS_EFFECTS] == 1.0 and base[par.STATELESS_EFFECTS] == 0.0
rates = []
for vector in (p, base):
    for angle in (0.05, 0.3, -0.3):
        dx = np.empty(4)
        dynamics.derivative(np.array([angle, 2.0, 450e3, 450e3]), np.array([5.5, 5.5]), vector, dx)
        rates.append(dx[1] * rig.joint.inertia)
with_it, without = np.array(rates[:3]), np.array(rates[3:])
z = rig.sample_period / rig.joint.inertia * rig.joint.viscous_friction
assert with_it[0] == without[0], "within the gap it is not there"
np.testing.assert_allclose((with_it - without)[1:] * (1 + z), [-40.0 * 0.1, 40.0 * 0.1], rtol=1e-9)
rest = rest.rest_angle(700e3, 200e3, p), rest.rest_angle(700e3, 200e3, base)
assert 0.2 < rest[0] < rest[1] - 0.02, rest
print("thirteen")
"""


@pytest.mark.slow
def test_the_recipe_makes_a_thirteenth(tmp_path):
    shutil.copytree(ROOT / "pam_antagonist", tmp_path / "pam_antagonist", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "config", tmp_path / "config")
    shutil.copy(ROOT / "package.xml", tmp_path)
    assert applied(tmp_path) >= 6
    rig = tmp_path / "rig.yaml"
    rig.write_text("based_on: shin2022\nname: trial\neffects: {bumper: {stiffness: 40.0}}\n", encoding="utf-8")
    environment = {"PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path / "kernels"), "PATH": "/usr/bin:/bin"}
    done = subprocess.run(
        [sys.executable, "-c", TRIAL.replace("RIG", str(rig))],
        cwd=tmp_path, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout == "thirteen\n"
