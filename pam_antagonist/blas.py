"""One thread for linear algebra while a calculation runs, whatever the host program has set.

Fits and diagnoses solve many small linear problems, beside threads of their own (``jobs``). The threads that a BLAS
library starts for each of these problems wait for one another longer than they work. One thread also makes the result
independent of how many the library would have taken.
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
    """Decorator: BLAS has one thread while the function runs; the former number is restored when it ends.

    Args:
        function: a whole calculation; what it needs of numpy and scipy is imported before it begins.
    """

    @functools.wraps(function)
    def limited(*arguments: _Arguments.args, **named: _Arguments.kwargs) -> _Result:
        with _limit():
            return function(*arguments, **named)

    return limited


def _limit() -> AbstractContextManager[object]:
    # rosdep does not know threadpoolctl: where ROS installed what the nodes need, a fit only takes longer.
    if not available("threadpoolctl"):
        return nullcontext()
    from threadpoolctl import threadpool_limits

    limit: AbstractContextManager[object] = threadpool_limits(1, "blas")
    return limit
