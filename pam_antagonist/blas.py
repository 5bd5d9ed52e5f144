"""Limit BLAS to one thread during a calculation, independent of the host program's setting.

Fits and diagnoses solve many small linear problems, and have threads of their own (``jobs``). The threads of a BLAS
library would wait for each other longer than they work. With one thread, the result also does not depend on the
library's number of threads.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import ParamSpec, TypeVar

from pam_antagonist.optional import available

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")


def one_blas_thread(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """Decorator of a whole calculation: BLAS has one thread meanwhile. numpy and scipy must be imported before."""

    @functools.wraps(function)
    def limited(*arguments: _Arguments.args, **named: _Arguments.kwargs) -> _Result:
        with _limit():
            return function(*arguments, **named)

    return limited


def _limit() -> AbstractContextManager[object]:
    # threadpoolctl is optional, because rosdep does not know it; without it a fit only takes longer.
    if not available("threadpoolctl"):
        return nullcontext()
    from threadpoolctl import threadpool_limits

    limit: AbstractContextManager[object] = threadpool_limits(1, "blas")
    return limit
