"""Work on the workers of a Dask scheduler in place of threads."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from contextlib import contextmanager

from pam_antagonist import __version__
from pam_antagonist.errors import BadInput
from pam_antagonist.optional import needs

_TIMEOUT = 10.0


def refuse_for_episodes(address: str | None) -> None:
    """Say that episodes are fitted here."""
    if address is not None:
        raise BadInput("--dask: a recording of episodes is fitted on this machine only; leave --dask out")


@contextmanager
def connected(address: str | None) -> Iterator[None]:
    """Everything inside that runs in parallel by joblib does so on the workers of a scheduler."""
    if address is None:
        yield
        return
    from joblib import parallel_config

    with needs("dask", "--dask"):
        import distributed
    try:
        client = distributed.Client(address, timeout=_TIMEOUT, set_as_default=True)
    except (OSError, TimeoutError, ValueError) as error:
        raise BadInput(
            f"--dask {address}: no scheduler answers there ({type(error).__name__}); expected an address such as "
            "tcp://host:8786"
        ) from None
    with client:
        found = client.run(_version)
        if not found:
            raise BadInput(f"--dask {address}: the scheduler has no workers; start one with: dask worker {address}")
        for worker, version in found.items():
            if version != __version__:
                raise BadInput(
                    f"--dask {address}: worker {worker} has {version or 'no pam_antagonist'}; expected pam_antagonist "
                    f"{__version__}, as here"
                )
        with parallel_config(backend="dask"):
            yield


def _version() -> str:
    """Version of the package where this runs; empty where there is none."""
    try:
        return str(importlib.import_module("pam_antagonist").__version__)
    except ImportError:
        return ""
