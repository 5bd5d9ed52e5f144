"""Linear algebra has one thread while a calculation runs, and the host program's number of threads afterwards."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pam_antagonist import diagnose, identify, simulate
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
