"""How much of what a form does the catalogue's law cannot imitate.

A form is simulated without noise, on a joint as configured. Base parameters and the catalogue's law of that effect are
fitted to it as a diagnosis fits them. The *remainder* is the root mean square of what is left over all channels of both
recordings, as a share of what the form did to them.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from pam_antagonist.diagnosis.catalogue_effects import as_configured, score_all
from pam_antagonist.errors import BadInput
from pam_antagonist.inference.free_parameters import Candidate
from pam_antagonist.inference.gauss_newton import refit
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.starts import best_of_starts
from pam_antagonist.inference.trial import ANGLE, PRESSURE_1, PRESSURE_2, TORQUE, Trial
from pam_antagonist.inference.valve_driven import ValveDriven
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.rig import load_rig
from pam_antagonist.strict_json import write_json
from validation.battery.forms import SINGLE, Form
from validation.battery.plants import JOINTS, RIG, Case

Floats = NDArray[np.float64]

OTHER, VARIATION = 0.10, 0.05
"""Forms with a remainder above the first are truly other ones, those below the second variations of the catalogue's."""
TYPICAL = 8.0
"""Size at which a form is looked at."""
FILE = "remainders.json"
_SECONDS, _SEED = 30.0, 21


@dataclass(frozen=True)
class Remainder:
    """What the model can imitate of a form.

    Attributes:
        size: that the form had, in noises of the channel that it moves most.
        before: root mean square of what it does to all channels, in noises of a block.
        base: what base parameters alone leave of that.
        law: what base parameters and the catalogue's law leave.
    """

    size: float
    before: float
    base: float
    law: float

    @property
    def share(self) -> float:
        """The remainder: the share that base parameters and law leave."""
        return self.law / self.before

    @property
    def base_share(self) -> float:
        """The share that base parameters alone leave."""
        return self.base / self.before


@dataclass(frozen=True, eq=False)
class _Quiet(ValveDriven):
    """A recording without noise, judged by the noise that its sensors would have, for one candidate."""

    effect: str = ""

    @cached_property
    @override
    def noise(self) -> Floats:
        sensors = load_rig(RIG).sensors
        every = (sensors.angle_std, sensors.torque_std, sensors.pressure_std, sensors.pressure_std)
        return np.array([every[channel] for channel in self.channels]) / np.sqrt(self.trial.block)

    @override
    def candidates(self, taken: Mapping[str, float]) -> tuple[Candidate, ...]:
        return (Candidate(self.effect),)


def remainder(form: Form) -> Remainder:
    """Fit the catalogue's law to what a form does.

    Args:
        form: of an effect that has a law.
    """
    effect = form.effect, 2 if form.by_muscle else None
    case = Case(form.name, "single", (effect,), (form.name,), _SEED, (TYPICAL,), exact=True)
    squares = np.array([_left(case, joint, form.effect) for joint in JOINTS])
    before, base, law = (float(value) for value in np.sqrt(squares[:, :3].sum(axis=0) / squares[:, 3].sum()))
    return Remainder(case.reached[0], before, base, law)


def _left(case: Case, joint: str, effect: str) -> tuple[float, float, float, float]:
    """Sums of squares in noises before any fit, behind that of the base and that of the law; how many they are."""
    rig = load_rig(RIG)
    true = case.channels(joint, _SECONDS, parameters=rig.parameters(joint))
    measured = np.empty((len(true.angle), 4))
    measured[:, ANGLE], measured[:, TORQUE] = true.angle, true.torque
    measured[:, PRESSURE_1], measured[:, PRESSURE_2] = true.pressure.T
    trial = Trial(case.name, joint, 0.0, rig.sample_period, case.voltage(joint, _SECONDS), measured)
    experiment = _Quiet(rig, trial, len(trial), seed=_SEED, effect=effect)
    first = as_configured(experiment)
    base = best_of_starts(experiment, refit(experiment, experiment.origin))
    free = Candidate(effect).free
    fits = []
    # As a diagnosis does: from the base as it was fitted, and as it was configured.
    for at in (base, first):
        score = score_all(experiment, base, at)[effect]
        point = Point(at.point.theta, dict(score.start))
        fits.append(best_of_starts(experiment, refit(experiment, point, free, at.base, renewals=2)))

    def squares(residual: Floats) -> float:
        return float(np.sum((residual / experiment.noise) ** 2))

    law = min(squares(fit.residual) for fit in fits)
    return squares(first.residual), squares(base.residual), min(law, squares(base.residual)), float(base.residual.size)


def with_law() -> tuple[Form, ...]:
    """Forms of effects that a law gives."""
    return tuple(form for form in SINGLE if CATALOGUE[form.effect].deterministic)


def load(path: Path) -> dict[str, Remainder]:
    """Remainders by the form's name; none where there is no such file.

    Raises:
        BadInput: a file that holds none.
    """
    if not path.exists():
        return {}
    try:
        return {name: Remainder(**item) for name, item in json.loads(path.read_text(encoding="utf-8")).items()}
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise BadInput(f"{path}: no remainders ({error}); expected what battery --remainders writes") from None


def save(path: Path, found: Mapping[str, Remainder]) -> None:
    """Write remainders, whole or not at all."""
    aside = path.with_suffix(".part")
    write_json(aside, {name: asdict(item) for name, item in sorted(found.items())})
    aside.rename(path)


@lru_cache(maxsize=1)
def known() -> Mapping[str, Remainder]:
    """The remainders that the draw of forms goes by, as this package has them."""
    return load(Path(__file__).with_name(FILE))


def is_other(form: Form) -> bool:
    """Whether the catalogue's law leaves more than a tenth of a form."""
    found = known().get(form.name)
    return found is not None and found.share > OTHER


def group_of(forms: Sequence[str]) -> str:
    """In which group the forms of a case count: ``other``, ``near`` or ``variation``; ``no law`` without remainders."""
    shares = [known()[name].share for name in forms if name in known()]
    if len(shares) < len(forms) or not shares:
        return "no law"
    least = min(shares)
    return "other" if least > OTHER else "near" if least >= VARIATION else "variation"
