"""Further inputs of a rig's model, sample by sample: its signals, and the coefficients of its weak laws.

A signal, such as the pressure of a neighbouring joint, counts from its value in the rig file. One that is missing is
taken for that value. The weak laws go with sums of products of pressures and signals, and of what of them fades within
fractions of a second (:mod:`pam_antagonist.model.effects.weak_laws`). All of that is known before a step of the filter.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pam_antagonist._jit import in_place
from pam_antagonist.errors import BadInput
from pam_antagonist.model.effects.base import COEFFICIENTS, SIGNALS
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

PLACES = (
    "torque", "torque*angle", "torque*angle^2", "torque*angle^3", "drag", "drag*angle", "drag*angle^2", "drag*speed",
    "friction", "friction*angle", "friction*angle^2", "friction*slow", "friction*slow*angle", "friction*fast",
    "friction*fast*angle",
)  # fmt: skip
"""Names of the coefficients of the effect, in its order."""
OWN = ("pressure_1", "pressure_2")
FADING = (0.03, 0.1, 0.3)
"""[s] What of an input fades within these times counts as well."""
_FACTORS = 3
"""Most factors of a feature."""


def fading(name: str, time: float) -> str:
    """Name of what of an input fades within a time [s]."""
    return f"{name} within {time:g} s"


@in_place
def _follow(seconds, pressure, signals, middle, unit, constants, factors, places, weights, last, held, clock, z, out):
    """Further inputs at samples (N,), one after the other; ``last``, ``held`` and ``clock`` are the memory.

    `seconds`: since the sample before (N,) [s]. `z`: 1, then all that a product may have as a factor. `out`: result
    (N, SIGNALS + COEFFICIENTS).
    """
    inputs = middle.shape[0]
    for k in range(seconds.shape[0]):
        for j in range(out.shape[1]):
            out[k, j] = 0.0
        for j in range(signals.shape[1]):
            if math.isfinite(signals[k, j]):
                out[k, j] = signals[k, j]
        for i in range(inputs):
            now = ((pressure[k, i] if i < 2 else out[k, i - 2]) - middle[i]) / unit[i]
            if not math.isfinite(now):
                now = last[i]  # 0 before the first reading
            z[1 + i] = now
            for c in range(constants.shape[0]):
                if clock[0] == 0:
                    held[c, i] = now
                else:
                    stays = math.exp(-max(seconds[k], 0.0) / constants[c])
                    held[c, i] = stays * held[c, i] + (1.0 - stays) * 0.5 * (now + last[i])
                z[1 + inputs * (1 + c) + i] = now - held[c, i]
            last[i] = now
        clock[0] = 1
        for t in range(weights.shape[0]):
            product = weights[t]
            for f in range(factors.shape[1]):
                product *= z[factors[t, f]]
            out[k, SIGNALS + places[t]] += product


class FurtherInputs:
    """The further inputs of a rig's model, with what they remember.

    Raises:
        BadInput: numbers of weak laws for a place, an input or a feature that there is not.
    """

    def __init__(self, rig: Rig) -> None:
        self.names = tuple(rig.signals)
        self._reference = np.array(list(rig.signals.values()), dtype=np.float64)
        laws = rig.weak_laws
        names = [] if laws is None else [*OWN, *rig.signals]
        where = f"rig {rig.name}: weak_laws"
        terms: list[tuple[int, list[int], float]] = []
        if laws is not None:
            for given in (laws.middle, laws.range):
                if sorted(given) != sorted(names):
                    raise BadInput(f"{where}: inputs {', '.join(given)}; expected {', '.join(names)}")
            for place, numbers in laws.numbers.items():
                if place not in PLACES:
                    raise BadInput(f"{where}.numbers: no {place!r}; expected {', '.join(PLACES)}")
                for name, value in numbers.items():
                    found = _factors(name, names)
                    if found is None:
                        raise BadInput(f"{where}.numbers.{place}: no {name!r}; expected a product of its inputs")
                    terms.append((PLACES.index(place), found, value))
        self._middle = np.array([laws.middle[name] for name in names] if laws else [], dtype=np.float64)
        self._unit = np.array([laws.range[name] for name in names] if laws else [], dtype=np.float64)
        self._table = (
            np.array(FADING),
            np.array([found for _, found, _ in terms], dtype=np.int64).reshape(-1, _FACTORS),
            np.array([place for place, _, _ in terms], dtype=np.int64),
            np.array([value for _, _, value in terms], dtype=np.float64),
        )
        self._last, self._held = np.zeros(len(names)), np.zeros((len(FADING), len(names)))
        self._factors = np.ones(1 + len(names) * (1 + len(FADING)))
        self._clock, self._stamp = np.zeros(1, np.int64), 0
        # Of one sample, so that a live filter makes no arrays.
        self._seconds, self._relative = np.zeros(1), np.zeros((1, len(self.names)))
        self.now = np.zeros((1, SIGNALS + COEFFICIENTS))

    @classmethod
    def of(cls, rig: Rig) -> FurtherInputs | None:
        """Those of a rig; None if its model has none."""
        return cls(rig) if rig.signals or rig.weak_laws is not None else None

    def reset(self) -> None:
        """Forget what was; the next sample comes after a long rest."""
        self._last[:] = self._held[:] = self._clock[:] = 0

    def follow(self, stamp_ns: NDArray[np.int64], pressure: Floats, signals: Floats) -> Floats:
        """Further inputs at the next samples (N, 4 + 15): signals, then coefficients of weak laws [N m].

        Args:
            stamp_ns: stamps (N,) [ns].
            pressure: (N, 2) [Pa].
            signals: in the order of the rig file (N, S) [SI], NaN where missing.
        """
        out = np.empty((len(stamp_ns), SIGNALS + COEFFICIENTS))
        if len(stamp_ns):
            before = stamp_ns[0] if self._clock[0] == 0 else self._stamp
            self._take(np.diff(stamp_ns, prepend=before) * 1e-9, pressure, signals - self._reference, out)
            self._stamp = int(stamp_ns[-1])
        return out

    def step(self, stamp_ns: int, pressure: Floats, signals: Sequence[float]) -> None:
        """:meth:`follow` of one sample, into :attr:`now` (1, 4 + 15).

        `pressure`: (1, 2) [Pa]. `signals`: [SI], NaN where missing; none: all are.
        """
        self._seconds[0] = 0.0 if self._clock[0] == 0 else (stamp_ns - self._stamp) * 1e-9
        self._relative[0] = signals if len(signals) else math.nan
        self._relative -= self._reference
        self._take(self._seconds, pressure, self._relative, self.now)
        self._stamp = stamp_ns

    def _take(self, seconds: Floats, pressure: Floats, relative: Floats, out: Floats) -> None:
        memory = self._last, self._held, self._clock, self._factors
        _follow(seconds, pressure, relative, self._middle, self._unit, *self._table, *memory, out)

    def columns(self, signals: Mapping[str, Floats], samples: int) -> Floats:
        """Signals by name as columns (N, S), NaN where one is missing."""
        nothing = np.full(samples, np.nan)
        return np.column_stack([np.empty((samples, 0)), *(signals.get(name, nothing) for name in self.names)])


def _factors(name: str, inputs: list[str]) -> list[int] | None:
    """The factors of a feature: 0 the constant, then the inputs, then what of each fades; None if there is no such."""
    places = {"constant": 0, **{one: 1 + i for i, one in enumerate(inputs)}}
    for c, time in enumerate(FADING):
        places |= {fading(one, time): 1 + len(inputs) * (1 + c) + i for i, one in enumerate(inputs)}
    if name.endswith("^3"):
        found = [places.get(name[:-2])] * _FACTORS
    else:
        found = [places.get(part) for part in name.split("*")]
    known = [place for place in found if place is not None]
    if len(known) < len(found) or len(known) > _FACTORS:
        return None
    return [*known, *[0] * (_FACTORS - len(known))]
