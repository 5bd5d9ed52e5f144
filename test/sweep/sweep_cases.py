"""Small cases that strangers could make: a rig, its recordings with something wrong in them, and the words to type.

``cases(count, seed)`` draws them so that all pairs of choices occur as early as possible: most faults need two choices
that meet. ``made(case, rigs, folder)`` writes the bags and the rig file of a case.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pam_antagonist import load_rig, simulate
from pam_antagonist.cli import new_rig
from pam_antagonist.estimation import simulate_model
from pam_antagonist.recording import Recording, write_bag
from pam_antagonist.rig import Rig
from pam_antagonist.rig.file import write_rig
from pam_antagonist.rig.physical import unphysical
from pam_antagonist.simulation.excitation import for_rig

# Answers to new_rig: big and small muscles, lever and pulley, with and without a stop, open and closed centre.
_BIG = {
    "radius": "20mm", "muscle": "DMSP-20", "nominal-length": "300mm", "length": "285mm", "supply": "6bar",
    "valve": "MPYE-5-M5", "inertia": "0.002", "mass": "0.5kg",
}  # fmt: skip
_SMALL = {
    "kind": "pulley", "radius": "15mm", "muscle": "own", "muscle-diameter": "10mm", "muscle-force": "150N",
    "muscle-pressure": "5bar", "muscle-contraction": "20", "nominal-length": "160mm", "length": "148mm",
    "supply": "5bar", "inertia": "1.5e-4", "mass": "100g", "stop": "40deg", "valve": "shin2022",
}  # fmt: skip


def _with_regulators(answers: Mapping[str, str], **further: str) -> dict[str, str]:
    kept = {name: value for name, value in answers.items() if not name.startswith("valve")}
    return {**kept, "drive": "regulator", **further}


ANSWERS: dict[str, dict[str, str]] = {
    "lever_valves": _BIG,
    "pulley_valves": _SMALL,
    "lever_regulators": _with_regulators(_BIG, regulator="VPPM-0L6H"),
    "pulley_regulators": _with_regulators(_SMALL, regulator="VEAA-D11", **{"regulator-time": "0.12"}),
}
NAMED = "shin2022", "sealed_joint"
"""Rigs of the package, beside those of new_rig."""

CHOICES: dict[str, tuple[Any, ...]] = {
    "rig": (*ANSWERS, *NAMED),
    "rate": (20, 50, 200, 1000, 2000),
    "seconds": (24, 60, 24, 12, 5),
    "joint": ("free", "locked", "both", "two rigs"),
    "channels": ("all", "no torque", "no angle", "neither"),
    "profile": ("steps", "multisine", "steps", "multisine", "one side", "still"),
    "damage": ("none", "hole", "held", "jitter", "clipped", "spike", "cut short"),
    "lacks": ("nothing", "effect", "far off"),
    "typed": (
        "", "another rig", "--flip-angle", "--swap-pressures", "--gauge", "--pressure-unit bar", "--joint locked",
        "--joint free", "--encoder-zero 25", "--torque-scale 5", "--delay-voltage 300", "--no-check",
    ),
    "fit": ("identify", "close_loop", "", ""),
}  # fmt: skip
"""What is drawn -> what it may be, twice what is to come twice as often; the first is the plainest."""

_MOST, _MOST_FITTED = 24_000, 2_400
"""Samples of a case, and of one that is fitted: they decide what the sweep costs."""
_SPOILS = {"seconds": 3, "channels": 1, "profile": 4, "damage": 1, "typed": 1}
"""What may leave nothing to compute -> how many of its choices never do."""
_SLOWEST = 200
"""Rate of the simulated joint under a slower log [Hz]."""


class Case(NamedTuple):
    """One of each of ``CHOICES``, and the seed of all that is random in it."""

    rig: str
    rate: int
    seconds: int
    joint: str
    channels: str
    profile: str
    damage: str
    lacks: str
    typed: str
    fit: str
    seed: int

    def __str__(self) -> str:
        words = (self.rig, f"{self.rate}Hz", f"{self.seconds}s", *self[3:-1], str(self.seed))
        return "/".join(word.replace(" ", "_") for word in words if word not in ("", "none", "nothing"))

    @property
    def samples(self) -> int:
        return self.rate * self.seconds * (1 + (self.joint in ("both", "two rigs")))


def cases(count: int, seed: int) -> list[Case]:
    """Draw cases: of twenty that are possible, the one with the most pairs that no earlier case has."""
    rng = np.random.default_rng(seed)
    drawn: list[Case] = []
    seen: set[tuple[int, Any, int, Any]] = set()

    def pairs(case: Case) -> set[tuple[int, Any, int, Any]]:
        return {(i, case[i], k, case[k]) for i, k in combinations(range(len(CHOICES)), 2)}

    while len(drawn) < count:
        possible: list[Case] = []
        while len(possible) < 20:
            case = _drawn(len(drawn), rng)
            if case.samples <= (_MOST_FITTED if case.fit else _MOST):
                possible.append(case)
        drawn.append(max(possible, key=lambda case: len(pairs(case) - seen)))
        seen |= pairs(drawn[-1])
    return drawn


def _drawn(number: int, rng: np.random.Generator) -> Case:
    """Any case; of three, two have one thing at most that spoils them, so that something is computed from them."""
    values = {name: values[rng.integers(len(values))] for name, values in CHOICES.items()}
    if number % 3:
        kept = rng.choice(list(_SPOILS))
        values |= {name: CHOICES[name][rng.integers(plain)] for name, plain in _SPOILS.items() if name != kept}
    return Case(**values, seed=number)


def write_rigs(folder: Path) -> dict[str, Rig]:
    """The rigs of ``CHOICES``: those of new_rig are made by the command."""
    for name, answers in ANSWERS.items():
        words = [word for option, value in answers.items() for word in (f"--{option}", value)]
        assert new_rig.main(["--out", str(folder / f"{name}.yaml"), "--name", name, *words]) == 0
    return {
        name: load_rig(name if name in NAMED else folder / f"{name}.yaml", regulators=True) for name in CHOICES["rig"]
    }


@dataclass(frozen=True)
class Made:
    """Files of a case: its bags, and the rig file to give."""

    bags: list[Path]
    rig: Path


def made(case: Case, rigs: Mapping[str, Rig], folder: Path) -> Made:
    """Write the bags and the rig file of a case."""
    rig = rigs[case.rig].replaced(sample_period=1.0 / max(case.rate, 50))
    others = [name for name in rigs if name != case.rig]
    given = rigs[others[case.seed % len(others)]] if case.typed == "another rig" else rig
    write_rig(given, folder / "rig.yaml")
    joints = {"both": ("free", "locked"), "two rigs": ("free", "free")}.get(case.joint, (case.joint,))
    bags = []
    for k, joint in enumerate(joints):
        true = _true(rig, case, 0.15 if k and case.joint == "two rigs" else 0.0)
        recording = _damaged(_recorded(true, joint, case, case.seed + 1000 * k), case)
        bags.append(folder / f"bag_{k + 1}")
        write_bag(bags[-1], recording)
    return Made(bags, folder / "rig.yaml")


def _true(rig: Rig, case: Case, further: float) -> Rig:
    """The rig that is recorded: as the file says, or with something that the file lacks."""
    if case.lacks == "effect":
        effects = {"friction": {"coulomb": 0.05}} if case.rig == "sealed_joint" else {
            "hysteresis": {"amplitude_1": 5.0, "amplitude_2": 5.0, "width": 1e-3}
        }  # fmt: skip
        rig = rig.replaced(effects={**rig.effects, **effects})
    off = further + (0.12 if case.lacks == "far off" else 0.0)
    if not off:
        return rig
    for share in (1.0, 0.5, 0.25):
        scale = 1.0 + share * off * np.random.default_rng(case.seed).choice((-1.0, 1.0), 2)
        maps = {
            f"muscle_{i}": muscle.replaced(
                force=muscle.force.replaced(v1=muscle.force.v1 * factor, w2=muscle.force.w2 * factor)
            )
            for i, muscle, factor in ((1, rig.muscle_1, scale[0]), (2, rig.muscle_2, scale[1]))
        }
        # The linear map's terms nearly cancel: some draws are no muscle.
        if not unphysical(changed := rig.replaced(**maps)):
            return changed
    raise AssertionError(f"{case}: no rig that differs by a quarter of {off:g} is a muscle")


def _recorded(rig: Rig, joint: str, case: Case, seed: int) -> Recording:
    if rig.valves.sealed:
        return _of_sealed(rig, joint, case, np.random.default_rng(seed))
    # The joint moves in finer steps than a slow log has rows. A command holds from row to row.
    every = max(1, _SLOWEST // case.rate)
    rig = rig.replaced(sample_period=1.0 / (every * case.rate))
    command = for_rig(rig, case.profile if case.profile == "multisine" else "steps", case.seconds, seed)
    rows = np.arange(len(command))
    command = command[rows - rows % every]
    if case.profile == "still":
        command[:] = np.mean(rig.command_limits)
    if case.profile == "one side":
        command[:, 1] = command[0, 1]
    recording = simulate(rig, command, joint=joint, seed=seed, mismatch=0.03)
    return _taken(recording, rows[every - 1 :: every])


def _of_sealed(rig: Rig, joint: str, case: Case, rng: np.random.Generator) -> Recording:
    """A sealed joint, driven by a torque that is measured."""
    every = max(1, _SLOWEST // case.rate)
    step = 1.0 / (every * case.rate)
    rig = rig.replaced(sample_period=step)
    time = np.arange(round(case.seconds / step)) * step
    torque = {
        "still": np.zeros_like(time), "multisine": 1.2 * np.sin(0.94 * time) + 0.4 * np.sin(0.3 * time),
        "steps": 1.2 * np.clip(2.0 * np.sin(0.9 * time), -1.0, 1.0), "one side": 0.6 - 0.6 * np.cos(0.7 * time),
    }[case.profile]  # fmt: skip
    charge = np.array([rig.valves.charge_1, rig.valves.charge_2])
    run = simulate_model(rig, np.zeros((len(time), 2)), charge, external_torque=torque)
    still = joint == "locked"
    recording = Recording(
        path=Path("sealed"), stamp_ns=np.rint((1 + np.arange(len(time))) * step * 1e9).astype(np.int64),
        pressure=(charge if still else run.pressure) + rng.normal(0.0, 20.0, run.pressure.shape),
        voltage=np.zeros((len(time), 2)),
        angle=(0.0 if still else run.angle) + rng.normal(0.0, 5e-4, len(time)),
        torque=None, external_torque=torque,
    )  # fmt: skip
    return _taken(recording, np.arange(every - 1, len(time), every))


def _taken(recording: Recording, rows: np.ndarray, **changes: Any) -> Recording:
    names = ("stamp_ns", "pressure", "voltage", "angle", "torque", "external_torque", "angle_sensor")
    arrays = {name: changes.get(name, getattr(recording, name)) for name in names}
    return replace(recording, **{name: None if array is None else array[rows] for name, array in arrays.items()})


def _damaged(recording: Recording, case: Case) -> Recording:
    """The recording without the channels that nobody measured, and with what went wrong in it."""
    count, rng = len(recording.stamp_ns), np.random.default_rng(case.seed)
    rows, pressure, stamps = np.arange(count), recording.pressure.copy(), recording.stamp_ns.copy()
    angle, torque = recording.angle, recording.torque
    match case.damage:
        case "hole":
            rows = rows[(rows < 0.4 * count) | (rows > 0.52 * count)]
        case "cut short":
            rows = rows[: max(2, count // 20)]
        case "held":  # encoder, meter and one gauge that are slower than the log
            slow = rows - rows % 5
            angle, torque = (None if values is None else values[slow] for values in (angle, torque))
            pressure[:, 0] = pressure[slow, 0]
        case "jitter":
            period = np.median(np.diff(stamps))
            stamps = stamps + np.rint(rng.uniform(-0.4, 0.4, count) * period).astype(np.int64)
        case "clipped":
            pressure[:, 0] = np.minimum(pressure[:, 0], np.quantile(pressure[:, 0], 0.9))
        case "spike":
            pressure[count // 3, 1] = 3.0e6
            angle = None if angle is None else np.where(rows == count // 2, 7.0, angle)
    lost = {"no torque": ("torque", "external_torque"), "no angle": ("angle",), "all": ()}.get(
        case.channels, ("torque", "external_torque", "angle")
    )
    changes: dict[str, Any] = {"pressure": pressure, "stamp_ns": stamps, "angle": angle, "torque": torque}
    return _taken(recording, rows, **{**changes, **dict.fromkeys(lost)})


def words(case: Case, files: Made, out: Path) -> Iterator[tuple[str, list[str]]]:
    """Commands of a case: name, and arguments."""
    common = [*map(str, files.bags), "--rig", str(files.rig)]
    options = case.typed.split() if case.typed.startswith("--") else []
    yield "check", [*common, *(word for word in options if word != "--no-check")]
    for name in ("replay", case.fit):
        if name:
            figures = [] if case.seed % 4 == 0 else ["--no-figures"]
            yield name, [*common, "--out", str(out / name), *options, *figures]
