"""The cases whose answers are frozen, one row for each kind: every way of close_loop has its own.

The recordings at hand are other people's or other simulators'. All others are simulated by this package: joints of the
battery, rigs with values from the priors of identify, the sealed joint with other values.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass, field
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from pam_antagonist.estimation import simulate_model
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig, load_rig
from validation import at_hand
from validation.battery.plants import RIG, Case, cases
from validation.rigs import fresh

_SEED, _COUNT, _NOTHING = 39117, 47, 13
"""Of the 47 cases of the battery 7 have nothing wrong."""
_OUTSIDE = 10
"""Joints with an effect that no law of the catalogue can imitate."""
_GUESSED = range(820, 832)
_KNOWN = range(900, 960)
"""Seeds of fresh rigs. Of the second, the first six of a kind are taken."""
_OF_A_KIND = 6
_SEALED = 10
_HALF = ", half"
"""End of the name of a case whose second half is held out."""

AT_HAND = "at hand"
KINDS = (AT_HAND, "battery", "laws", "guessed", "regulators", "trials", "sealed")

Truth = Mapping[str, Any] | None


@dataclass(frozen=True)
class Joint:
    """What is diagnosed."""

    truth: Truth  # ``effects``: pairs of a name and a muscle; None where nobody knows them
    recordings: Sequence[Any]
    rig: str | Rig
    options: dict[str, Any] = field(default_factory=dict)  # of ``diagnose``


Made = Callable[[], AbstractContextManager[Joint]]


def kind_of(name: str) -> str:
    """Kind of a case."""
    kind, _, _ = name.partition("/")
    return kind if kind in KINDS else AT_HAND


def joints(data: Path | None, old: Mapping[str, Mapping[str, Any]]) -> dict[str, Made]:
    """Name of a case, and a context that gives its joint.

    `data`: folder of the recordings at hand. `old`: frozen answers; their joints of the battery are taken, so that no
    change of the battery changes them.
    """
    battery, laws = (
        [_case(one["truth"]) for name, one in old.items() if name.startswith(f"{kind}/")] or drawn
        for kind, drawn in (("battery", _drawn()), ("laws", _outside()))
    )
    known = {regulators: _known(regulators) for regulators in (True, False)}
    own = {
        "battery": {case.name: partial(_of_battery, case) for case in battery},
        "laws": {case.name: partial(_of_battery, case) for case in laws},
        "guessed": {str(seed): partial(_fresh, seed, guessed=True) for seed in _GUESSED},
        "regulators": {str(seed): partial(_fresh, seed, guessed=False) for seed in known[True]},
        "trials": {str(seed): partial(_fresh, seed, guessed=False) for seed in known[False]},
        "sealed": {str(seed): partial(_sealed, seed) for seed in range(_SEALED)},
    }
    out: dict[str, Made] = {f"{kind}/{name}": made for kind, of_it in own.items() for name, made in of_it.items()}
    if data is not None:
        out |= {name: partial(_at_hand, name, data) for name in (*at_hand.NAMES, f"measured/sealed_joint{_HALF}")}
    return out


@contextmanager
def _at_hand(name: str, data: Path) -> Iterator[Joint]:
    with tempfile.TemporaryDirectory() as scratch:
        joint = at_hand.joint(name.removesuffix(_HALF), data, Path(scratch))
        truth = None if joint.truth is None else {"effects": [(effect, None) for effect in joint.truth]}
        also = {"also": joint.also} if joint.also else {}
        half = {"holdout": 0.5} if name.endswith(_HALF) else {}
        yield Joint(truth, joint.recordings, joint.rig, {**also, **half})


def _drawn() -> list[Case]:
    """The battery's joints, one with nothing wrong behind two others."""
    every = [case for _, case in cases(_SEED, _COUNT, _NOTHING)]
    nothing, others = ([case for case in every if (case.kind == "none") is none] for none in (True, False))
    return [case for k, one in enumerate(nothing) for case in (*others[2 * k : 2 * k + 2], one)]


def _outside() -> list[Case]:
    return [case for _, case in cases(_SEED, 0, uncatalogued=_OUTSIDE)]


def _case(truth: Mapping[str, Any]) -> Case:
    effects = tuple((name, muscle) for name, muscle in truth["effects"])
    return Case(truth["name"], truth["kind"], effects, tuple(truth["form"]), truth["seed"], tuple(truth["sizes"]), True)


@contextmanager
def _of_battery(case: Case) -> Iterator[Joint]:
    yield Joint(asdict(case), case.recordings(), RIG, {"seed": case.seed % 2**31})


def _known(regulators: bool) -> list[int]:
    """Seeds of fresh rigs with regulators, or with valves that short trials are recorded of."""
    drawn = ((seed, fresh.Kind.drawn(np.random.default_rng(seed))) for seed in _KNOWN)
    fitting = (seed for seed, kind in drawn if kind.regulators == regulators and kind.trials != regulators)
    return list(islice(fitting, _OF_A_KIND))


@contextmanager
def _fresh(seed: int, guessed: bool) -> Iterator[Joint]:
    lab = fresh.laboratory(seed)
    # Who knows a joint has measured it: its file has all but the effect, and no priors.
    declared = {name: numbers for name, numbers in lab.true.effects.items() if name != "hysteresis"}
    inside = [(name, None) for name in lab.true.effects if name not in declared]
    known = lab.true.unchecked(effects=declared, priors={})
    yield Joint({"effects": inside}, lab.fit, lab.typed if guessed else known, {"seed": seed})


_INSIDE: tuple[dict[str, dict[str, float]], ...] = (
    {},
    {"leak": {"area_1": 2e-12}},
    {"leak": {"area_2": 2e-12}},
    {"creep": {"share_1": 0.03, "share_2": 0.03, "time": 4.0}},
    {"hysteresis": {"amplitude_1": 4.0, "amplitude_2": 4.0, "width": 3e-4}},
)
"""What is in the sealed joints, in turn, beside the friction of their drive, which this way looks for as well."""
_SCATTERED = ("muscle_1.volume.d2", "muscle_2.volume.d2", "joint.stiffness", "friction.shaft")
_PRESSURE_STD, _ANGLE_STD = 20.0, 5e-4
"""[Pa], [rad] Of the simulated sensors; the measured recording was low-passed."""
_SECONDS = 25.0


@contextmanager
def _sealed(seed: int) -> Iterator[Joint]:
    """The sealed joint with values that differ by some per cent, moved by a torque that is known."""
    rig, inside = load_rig("sealed_joint"), _INSIDE[seed % len(_INSIDE)]
    rng = np.random.default_rng((_SEED, seed))
    true = moved(rig, {name: rig.value(name) * float(rng.uniform(0.95, 1.05)) for name in _SCATTERED})
    true = true.replaced(effects={**true.effects, **inside})
    time = 1e-3 * np.arange(1, round(1e3 * _SECONDS) + 1)
    slow, late = rng.uniform(0.1, 0.2), rng.uniform(0.0, 2.0 * np.pi)
    push = 1.2 * np.sin(2.0 * np.pi * slow * time) + 0.4 * np.sin(2.0 * np.pi * 0.3 * slow * time + late)
    closed = np.zeros((len(time), 2))
    charge = np.array([true.valves.charge_1, true.valves.charge_2])
    run = simulate_model(true, closed, charge, external_torque=push)
    recording = Recording(
        path=Path(f"sealed_{seed}"), stamp_ns=np.rint(1e9 * time).astype(np.int64),
        pressure=run.pressure + rng.normal(0.0, _PRESSURE_STD, run.pressure.shape), voltage=closed,
        angle=run.angle + rng.normal(0.0, _ANGLE_STD, len(time)), torque=None, external_torque=push,
    )  # fmt: skip
    yield Joint({"effects": [(name, None) for name in ("friction", *inside)]}, [recording], rig, {"seed": seed})
