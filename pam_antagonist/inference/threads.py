"""Parallel work on threads that all fits share."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import TypeVar

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


def side_by_side(work: Callable[[_Item], _Result], items: Iterable[_Item], jobs: int) -> list[_Result]:
    """Call a function for several items in parallel.

    `work`: function of one item; mostly compiled code, so that threads run in parallel.
    """
    return list(map(work, items) if jobs == 1 else _workers(jobs).map(work, items))


@lru_cache(maxsize=1)
def _workers(jobs: int) -> ThreadPoolExecutor:
    """Threads that all fits share, so that their number does not grow with the number of fits."""
    return ThreadPoolExecutor(jobs, thread_name_prefix="simulation")
