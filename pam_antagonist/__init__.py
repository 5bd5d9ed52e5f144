"""Sensor-less angle and torque of a joint that is driven by two pneumatic artificial muscles.

``__all__`` lists the Python API. Names are imported at their first use, so that ``import pam_antagonist`` is fast.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from pam_antagonist.api.adapt import adapt
    from pam_antagonist.api.diagnose import DiagnoseResult, IdentifyResult, diagnose, identify
    from pam_antagonist.api.excite import ExciteResult, excite
    from pam_antagonist.api.history import HistoryResult, history
    from pam_antagonist.api.import_csv import import_csv
    from pam_antagonist.api.new_rig import new_rig
    from pam_antagonist.api.replay import CheckResult, ReplayResult, check, replay
    from pam_antagonist.api.simulate import simulate
    from pam_antagonist.api.static import StaticResult, static
    from pam_antagonist.errors import BadInput
    from pam_antagonist.estimation.estimator import Estimator
    from pam_antagonist.recording.reader import read_bag
    from pam_antagonist.recording.recording import Recording
    from pam_antagonist.recording.writer import write_bag
    from pam_antagonist.rig.file import load_rig
    from pam_antagonist.rig.schema import Rig

_NAMES = {
    "errors": ("BadInput",),
    "estimation.estimator": ("Estimator",),
    "recording.recording": ("Recording",),
    "recording.reader": ("read_bag",),
    "recording.writer": ("write_bag",),
    "rig.schema": ("Rig",),
    "rig.file": ("load_rig",),
    "api.adapt": ("adapt",),
    "api.diagnose": ("DiagnoseResult", "IdentifyResult", "diagnose", "identify"),
    "api.excite": ("ExciteResult", "excite"),
    "api.history": ("HistoryResult", "history"),
    "api.import_csv": ("import_csv",),
    "api.new_rig": ("new_rig",),
    "api.replay": ("CheckResult", "ReplayResult", "check", "replay"),
    "api.simulate": ("simulate",),
    "api.static": ("StaticResult", "static"),
}
_WHERE = {name: module for module, names in _NAMES.items() for name in names}

__all__ = [
    "BadInput",
    "CheckResult",
    "DiagnoseResult",
    "Estimator",
    "ExciteResult",
    "HistoryResult",
    "IdentifyResult",
    "Recording",
    "ReplayResult",
    "Rig",
    "StaticResult",
    "__version__",
    "adapt",
    "check",
    "diagnose",
    "excite",
    "history",
    "identify",
    "import_csv",
    "load_rig",
    "new_rig",
    "read_bag",
    "replay",
    "simulate",
    "static",
    "write_bag",
]


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_WHERE[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
