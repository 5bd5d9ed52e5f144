"""Linear algebra has one thread while a calculation runs; machine code is kept by what it is made of."""

from __future__ import annotations

import ast
import io
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pam_antagonist import _jit, diagnose, identify, simulate
from pam_antagonist.blas import one_blas_thread

threadpoolctl = pytest.importorskip("threadpoolctl")


def threads() -> set[int]:
    """Threads of every BLAS library that is loaded."""
    return {item["num_threads"] for item in threadpoolctl.threadpool_info() if item["user_api"] == "blas"}


@one_blas_thread
def during() -> tuple[set[int], np.ndarray]:
    matrix = np.random.default_rng(1).normal(size=(400, 400))
    return threads(), np.linalg.solve(matrix @ matrix.T, matrix)


def test_one_thread_and_the_same_bits_whatever_the_host_program_has_set() -> None:
    results = []
    for wanted in (1, 2, 3):
        with threadpoolctl.threadpool_limits(wanted, "blas"):
            if threads() != {wanted}:
                pytest.skip(f"this BLAS does not take {wanted} threads")
            inside, result = during()
            assert inside == {1}
            assert threads() == {wanted}
            results.append(result.tobytes())
    assert len(set(results)) == 1


def test_a_calculation_that_fails_restores_it_as_well() -> None:
    @one_blas_thread
    def fails() -> None:
        raise ValueError("bad")

    with threadpoolctl.threadpool_limits(2, "blas"):
        before = threads()
        with pytest.raises(ValueError, match="bad"):
            fails()
        assert threads() == before


@pytest.mark.parametrize("calculation", [diagnose, identify], ids=["diagnose", "identify"])
def test_diagnose_and_identify_run_with_it(calculation: Any) -> None:
    class Seen(Exception):
        """What the first message finds; it ends the calculation."""

    def message(text: str) -> None:
        raise Seen(threads())

    recording = simulate("shin2022", duration=30.0, seed=1)
    with threadpoolctl.threadpool_limits(2, "blas"), pytest.raises(Seen) as seen:
        calculation(recording, "shin2022", progress=message)
    assert seen.value.args[0] == {1}


ROOT = Path(__file__).resolve().parents[1]
KERNEL = """
from pam_antagonist._jit import COMPILING, kernel

@kernel
def law(x):
    return 2.0 * x

print(law(1.5), COMPILING.kernels, COMPILING.seconds > 0.0)
"""

APART = """
from pam_antagonist._jit import in_place, inlined

@in_place
def law(x):
    return 2.0 * x

@inlined
def twice(x):
    return law(x) + law(x + 1.0)

print(twice(1.0), "alwaysinline" in "".join(law.inspect_llvm().values()))
"""


def test_a_kernel_of_its_own_is_not_copied_into_those_that_call_it(tmp_path: Path) -> None:
    """numba passes the wish to be inlined on to what an inlined function calls."""
    environment = {
        **os.environ,
        "NUMBA_CACHE_DIR": str(tmp_path),
        "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path]),
    }
    module = tmp_path / "lab_apart.py"
    module.write_text(APART)
    done = subprocess.run([sys.executable, module], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout == "6.0 False\n"


@pytest.mark.slow(4)
def test_a_kernel_is_compiled_once_for_each_state_of_its_code(tmp_path: Path) -> None:
    module = tmp_path / "lab_law.py"
    path = f"{ROOT}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"

    def run() -> str:
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": path}
        return subprocess.run(
            [sys.executable, module], env=environment, capture_output=True, text=True, check=True
        ).stdout.strip()

    module.write_text(KERNEL)
    assert run() == "3.0 1 True"
    os.utime(module, (1.0, 1.0))  # as after another checkout or an installation
    assert run() == "3.0 0 False"
    module.write_text(KERNEL.replace("2.0", "4.0"))
    assert run() == "6.0 1 True"


def test_comments_and_docstrings_make_no_other_code() -> None:
    plain = b"import math\n\ndef f(x):\n    return x + 1\n"
    said = b'"""Module."""\nimport math\n\n\ndef f(x):\n    """Adds."""\n    # one\n    return x + 1\n'
    assert _jit._code(plain) == _jit._code(said) != _jit._code(plain.replace(b"1", b"2"))


def test_sentences_about_an_effect_make_no_other_code() -> None:
    effect = b'EFFECT = Effect(name="leak", meaning="Air escapes.", hooks={"mass_loss": leaked}, sealed=Sealed(at=1))'
    assert _jit._code(effect) == _jit._code(effect.replace(b"Air escapes.", b"Some air escapes."))
    assert _jit._code(effect) != _jit._code(effect.replace(b"mass_loss", b"cooling"))
    assert _jit._code(effect) != _jit._code(effect.replace(b'"leak"', b'"creep"'))


def test_all_that_kernels_are_made_of_counts_and_nothing_else() -> None:
    package = ROOT / "pam_antagonist"
    found = {path.relative_to(package).as_posix() for path in _jit._kernel_sources()}
    assert found >= {"model/dynamics.py", "model/effects/leak.py", "model/parameters.py", "estimation/filter.py"}
    assert not found & {"estimation/estimator.py", "estimation/metrics.py"}
    modules = {
        ".".join(("pam_antagonist", *path.relative_to(package).with_suffix("").parts)).removesuffix(".__init__"): path
        for folder in ("model", "estimation")
        for path in (package / folder).rglob("*.py")
    }
    for path in _jit._kernel_sources():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{path}: relative imports are not followed"
                inside = {f"{node.module}.{alias.name}" for alias in node.names}
                names = inside if inside <= set(modules) else {node.module, *inside}
                for name in names & set(modules):
                    assert modules[name] in _jit._kernel_sources(), f"{path} imports {name}"


class Terminal(io.StringIO):
    """Standard error of somebody who looks."""

    def isatty(self) -> bool:
        return True


def test_compiling_is_told_on_a_terminal_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    said, log = Terminal(), io.StringIO()
    compiling = _jit.Compiling()
    monkeypatch.setattr(sys, "stderr", said)
    for call in (compiling.on_start, compiling.on_start, compiling.on_end, compiling.on_end):
        call(None)
    assert "Compiling, once (about a minute): 2 functions" in said.getvalue()
    assert said.getvalue().endswith("\r\033[K"), "the line is free again"
    monkeypatch.setattr(sys, "stderr", log)
    compiling.on_start(None)
    compiling.on_end(None)
    assert log.getvalue() == "" and compiling.kernels == 3 and compiling.seconds > 0.0
