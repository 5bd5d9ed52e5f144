"""Effects from the literature that no law of the catalogue can imitate, to try a search for laws on.

They were written by another hand than the search. Where each sits, and what it depends on, stands in ``places``.
"""

from __future__ import annotations

import numpy as np

from validation.battery.form import (
    EITHER_WAY,
    Deviation,
    Floats,
    Form,
    Random,
    each,
    named,
    plain,
    played,
    remembered,
    sides,
    sign,
)


def _damping(amount: float, muscle: int | None, rng: Random) -> Deviation:
    return Deviation({named("damping", muscle): amount * 50.0, "damping_lean": sign(rng) * rng.uniform(0.6, 0.95)})


def _coil(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """A coil's core turns with minor loops: play of several widths, the narrow ones the strongest."""
    loop = amount * rng.uniform(1.5e-3, 2.5e-3)

    def lagging(time: Floats, voltage: Floats) -> Floats:
        loops = [(played(voltage, width) - voltage) / width for width in (0.1, 0.4, 1.2)]
        return np.asarray(voltage + loop * (1.5 * loops[0] + loops[1] + 0.5 * loops[2]))

    return Deviation(voltage=each(muscle, lagging))


def _gauge_tube(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """A sensor behind a tube: late by the viscosity over the pressure, so that low pressures are read late."""
    slow = amount * 1e-2

    def late(time: Floats, pressure: Floats) -> Floats:
        rate = float(time[1] - time[0]) / slow
        return remembered(pressure, lambda held, p: held + (p - held) * min(rate * (held / 450e3) ** 2, 1.0))

    return Deviation(pressure=each(muscle, late))


def _multiplexer(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """A converter that reads one channel soon after the other keeps a share of the other one's charge."""
    share = amount * 3e-3

    def mixed(time: Floats, pressure: Floats) -> Floats:
        out = pressure.copy()
        for i in sides(muscle):
            out[:, i - 1] += share * (pressure[:, 2 - i] - pressure[:, i - 1])
        return out

    return Deviation(pressure=mixed)


def _eccentric(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """A code disc off its centre, behind a gear: a sine of the angle, once a turn of the disc."""
    error, gear, phase = amount * 3.5e-4, rng.uniform(6.0, 12.0), rng.uniform(0.0, 2.0 * np.pi)
    return Deviation(angle=lambda angle: angle + error * (np.sin(gear * angle + phase) - np.sin(phase)))


FORMS: tuple[Form, ...] = (
    Form("check valve between the chambers", "check", False, plain("check", 1.1e-10, way=EITHER_WAY),
         "ISO 6358-1 (2013)"),
    Form("relief valve", "relief", True, plain("relief", 1.6e-10, relief_at=(430e3, 500e3)), "Beater (2007)"),
    Form("kinked hose", "kink", True, plain("kink", 3e-2, kink_way=EITHER_WAY), "Brazier (1927)", 30.0),
    Form("fold of the bladder", "fold", True, plain("fold", 2.5e-2), "Tsagarakis and Caldwell (2000)"),
    Form("flow forces on the spool", "jet", True, plain("jet", 1.5e-3), "Merritt (1967), ch. 5"),
    Form("coil with minor loops", "coil", True, _coil, "Preisach (1935); Vaughan and Gamble (1996)"),
    Form("damping other one way", "damping", False, _damping, "Reynolds et al. (2003)"),
    Form("spring that engages", "engage", False, plain("engage", 0.1, engage_at=(0.02, 0.1), way=EITHER_WAY),
         "Hunt and Crossley (1975)"),
    Form("gauge behind a tube", "gauge_tube", True, _gauge_tube, "Bergh and Tijdeman (1965)", 60.0),
    Form("multiplexer that remembers", "multiplexer", True, _multiplexer, "Kester (2005)"),
    Form("eccentric code disc", "eccentric", False, _eccentric, "Sanchez-Brea and Morlanes (2008)"),
)  # fmt: skip
"""Forms outside of every law."""
