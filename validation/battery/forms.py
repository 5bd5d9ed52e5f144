"""The forms of the battery: which effects they write in another way, and which are in no catalogue.

An *amount* of 1 moves one channel of a typical recording by about its sensor's noise (root mean square over a minute).
Signs, times and widths are drawn at random. A form whose effect the catalogue does not have counts as in no catalogue.
"""

from __future__ import annotations

from pam_antagonist.model.effects import CATALOGUE
from validation.battery import forms_air, forms_motion, forms_valve
from validation.battery.form import Deviation, Form

__all__ = ["FOREIGN", "FORMS", "SINGLE", "Deviation", "Form"]

_ALL = (*forms_motion.FORMS, *forms_valve.FORMS, *forms_air.FORMS)
FORMS: dict[str, Form] = {form.name: form for form in _ALL}
"""All forms by name."""
SINGLE: tuple[Form, ...] = tuple(form for name in CATALOGUE for form in _ALL if form.effect == name)
"""Other forms of the catalogue's effects."""
FOREIGN: tuple[Form, ...] = tuple(form for form in _ALL if form.effect not in CATALOGUE)
"""What is in no catalogue."""
