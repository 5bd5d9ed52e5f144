"""Forms of what air does: leaks, the supply, warmth."""

from __future__ import annotations

import math

import numpy as np

from validation.battery.form import Deviation, Floats, Form, Make, Random, named, plain, signed


def _tank(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """1/V, and an orifice that holds the working flow at a drop of a few kPa for an amount of one."""
    return Deviation({"tank": rng.uniform(800.0, 3000.0), "feed": 6.7e-7 / math.sqrt(amount)})


def _compressor(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """A compressor with a pressure switch: the supply saws between two pressures (Beater 2007)."""
    band = amount * 4e3
    return Deviation({"compressor": band / rng.uniform(3.0, 6.0), "switch": band})


def _bottle(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """A bottle that nothing fills (Wehner et al. 2014): the supply falls by all that is drawn."""
    return Deviation({"compressor": amount * 100.0, "switch": 1e9})


def _warm(name: str, unit: float, low: float, high: float, flow: float = 0.0) -> Make:
    def make(amount: float, muscle: int | None, rng: Random) -> Deviation:
        times = {f"{name}_time": rng.uniform(low, high)}
        return Deviation({**named(name, amount * unit, muscle), **times, **({"gas_flow": flow} if flow else {})})

    return make


def _ripple(amount: float, muscle: int | None, rng: Random) -> Deviation:
    frequency, phase = rng.uniform(0.15, 0.5), rng.uniform(0.0, 2.0 * np.pi)

    def rippled(time: Floats) -> Floats:
        return np.asarray(amount * 2e3 * np.sin(2.0 * np.pi * frequency * time + phase))

    return Deviation(supply=rippled)


FORMS: tuple[Form, ...] = (
    Form("seeping", "leak", True, plain("seep", 2.6e-13), "Hagen and Poiseuille"),
    Form("capillary", "leak", True, plain("capillary", 4.3e-19), "compressible Hagen and Poiseuille"),
    Form(
        "seam that opens", "leak", True, plain("seam", 4e-18, seam_pressure=(350e3, 500e3)),
        "variable area: van Zyl and Clayton (2007)",
    ),
    Form("crack that stretches", "crack", True, plain("crack", 4e-10), "Klute and Hannaford (1998)"),
    Form("regulator", "supply_droop", False, plain("regulator", 900.0), "Beater (2007)"),
    Form("orifice-fed tank", "supply_droop", False, _tank, "ISO 6358-1 (2013)"),
    Form("line to the supply", "supply_droop", False, plain("inlet", 1500.0), "Darcy and Weisbach"),
    Form("bottle without compressor", "supply_droop", False, _bottle, "Wehner et al. (2014)"),
    Form("compressor with a switch", "compressor", False, _compressor, "Beater (2007)"),
    Form("energy balance", "thermal", False, _warm("gas", 1e-2, 0.6, 2.0), "Carneiro and de Almeida (2006)"),
    Form("gas and wall", "thermal", False, _warm("wall", 1e-2, 0.6, 2.0), "Det, Scavarda and Richard (1989)"),
    Form(
        "forced convection", "thermal", False, _warm("gas", 2e-2, 4.0, 8.0, 40.0), "Carneiro and de Almeida (2006)"
    ),
    Form("chambers exchange air", "exchange", False, plain("exchange", 6.0e-13), ""),
    Form("volume swells with pressure", "swell", True, plain("swell", 1e-2), ""),
    Form("valves disturb each other", "crosstalk", False, signed("crosstalk", 3e-3), ""),
    Form("supply ripples", "ripple", False, _ripple, ""),
)  # fmt: skip
"""Forms of leaks, supply and warmth."""
