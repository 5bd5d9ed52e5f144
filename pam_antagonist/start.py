"""``python start.py MODULE [arguments]``: start a module in a process of its own, as ``python -m MODULE`` does.

Unlike there, the current folder is no place to import from: a script beside somebody's recordings may be called
signal.py. What PYTHONPATH names comes last: it may be meant for another Python. (PYTHONSAFEPATH is unknown to
Python 3.10.)
"""

import sys

_HERE = __file__.rpartition("/")[0]
sys.path[:] = [folder for folder in sys.path if folder not in ("", _HERE)]

import os  # noqa: E402
import runpy  # noqa: E402


def _own_first(path: list[str], given: str, own: str) -> list[str]:
    """Folders to import from: those that PYTHONPATH gives come last, but for the one of this package."""
    later = {os.path.abspath(folder) for folder in given.split(os.pathsep)} - {own}
    return sorted(path, key=lambda folder: folder in later)


if __name__ == "__main__":
    sys.path[:] = _own_first(sys.path, os.environ.get("PYTHONPATH", ""), os.path.dirname(_HERE))
    os.environ["PYTHONSAFEPATH"] = "1"  # for the processes of joblib
    del sys.argv[0]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
