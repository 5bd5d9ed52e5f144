"""Work that is done side by side, on threads that all fits share."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import TypeVar

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


def side_by_side(work: Callable[[_Item], _Result], items: Iterable[_Item], jobs: int) -> list[_Result]:
    """Work on several items, each by itself: a single fit would leave the other cores idle.

    Args:
        work: gives an array of any shape; compiled for the most part, so that threads do.
        items: what each call gets.
        jobs: threads.
    """
    return list(map(work, items) if jobs == 1 else _workers(jobs).map(work, items))


@lru_cache(maxsize=1)
def _workers(jobs: int) -> ThreadPoolExecutor:
    """Threads that all fits share, so that there are no more of them than asked for, however many fits run."""
    return ThreadPoolExecutor(jobs, thread_name_prefix="simulation")
