"""The forms of the battery: which effects they write in another way, and which are in no catalogue.

An *amount* of 1 moves one channel of a typical recording by about its sensor's noise (root mean square over a minute).
Signs, times and widths are drawn at random. A form whose effect the catalogue does not have counts as in no catalogue.
"""

from __future__ import annotations

from collections.abc import Sequence

from pam_antagonist.model.effects import CATALOGUE
from validation.battery import forms_air, forms_motion, forms_uncatalogued, forms_valve
from validation.battery.form import Form

_ALL = (*forms_motion.FORMS, *forms_valve.FORMS, *forms_air.FORMS)
UNCATALOGUED = forms_uncatalogued.FORMS
"""Outside of every law, and drawn by themselves, so that they change no battery of old."""
FORMS: dict[str, Form] = {form.name: form for form in (*_ALL, *UNCATALOGUED)}
"""All forms by name."""
SINGLE: tuple[Form, ...] = tuple(form for name in CATALOGUE for form in _ALL if form.effect == name)
"""Other forms of the catalogue's effects."""
FOREIGN: tuple[Form, ...] = tuple(form for form in _ALL if form.effect not in CATALOGUE)
"""What is in no catalogue."""
OTHER, VARIATION = 0.10, 0.05
"""Forms with a remainder above the first are truly other ones, those below the second variations of the catalogue's."""
REMAINDERS = {
    "bottle without compressor": 0.23, "braid under pressure": 0.019, "bristles": 0.11, "bumpers": 0.135,
    "capillary": 0.001, "choked fitting": 0.04, "creep under load": 0.024, "cubic error": 0.028, "dahl": 0.022,
    "dahl at the joint": 0.094, "dead time": 0.108, "drifting offset": 0.016, "drifting zero": 0.016,
    "energy balance": 0.034, "fading friction": 0.083, "forced convection": 0.105, "fractional creep": 0.054,
    "gas and wall": 0.052, "geared pendulum": 0.013, "generalised maxwell slip": 0.143, "hardening spring": 0.016,
    "hess and soom": 0.052, "hysteresis of the membrane": 0.355, "limited slew": 0.058, "line to the supply": 0.033,
    "line with volume": 0.014, "logarithmic creep": 0.037, "long tube": 0.052, "maxwell slip": 0.015,
    "muscles that warm up": 0.005, "muscles that work warms": 0.037, "orifice-fed tank": 0.034,
    "play of the spool": 0.003, "regulator": 0.004, "seam that opens": 0.461, "second-order spool": 0.093,
    "seeping": 0.001, "shift and gain": 0.021, "slow one way": 0.281, "spool that sticks": 0.617, "stribeck": 0.079,
    "turbulent line": 0.04, "two-time creep": 0.023, "warm coil": 0.052, "worn edge": 0.24,
    "check valve between the chambers": 0.506, "relief valve": 0.252, "kinked hose": 0.392,
    "fold of the bladder": 0.476, "flow forces on the spool": 0.164, "coil with minor loops": 0.24,
    "damping other one way": 0.213, "spring that engages": 0.392, "gauge behind a tube": 0.517,
    "multiplexer that remembers": 0.814, "eccentric code disc": 0.127,
}  # fmt: skip
"""What base parameters and the catalogue's law of that effect (of the last eleven: its best law) leave of a form.

Fitted at commit c47df4a to 30 s without noise at a size of 8: root mean square over all channels of both recordings, as
a share of what the form does to them. Forms without a law (pushes) have none.
"""


def is_other(form: Form) -> bool:
    """Whether the catalogue's law leaves more than a tenth of a form."""
    return REMAINDERS.get(form.name, 0.0) > OTHER


def group_of(forms: Sequence[str]) -> str:
    """In which group the forms of a case count: ``other``, ``near`` or ``variation``; ``no law`` without remainders."""
    shares = [REMAINDERS.get(name) for name in forms]
    known = [share for share in shares if share is not None]
    if len(known) < len(forms) or not known:
        return "no law"
    return "other" if min(known) > OTHER else "near" if min(known) >= VARIATION else "variation"
