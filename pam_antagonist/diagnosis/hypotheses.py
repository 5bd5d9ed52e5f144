"""What a model may lack, as hypotheses with one interface, and what trying one of them gives.

A search (:mod:`search`) asks every hypothesis of a table in turn what it would make of the present model, takes the
best answer that is worth it, and asks again. An effect of the catalogue and a calibration are hypotheses; so are an
effect that begins or ends and friction along the motion, which rules ask for
(:mod:`judgement`). Another package adds its own by an entry point of the group ``pam_antagonist.hypotheses``, the name
of a class.
"""

from __future__ import annotations

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np

from pam_antagonist.diagnosis import thresholds
from pam_antagonist.diagnosis.models import FITTED, Model, evidence, further_share, held_out_evidence, held_share
from pam_antagonist.errors import BadInput
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.gauss_newton import Fitted
from pam_antagonist.inference.point import Point

_SETTINGS = "settings.json"


@dataclass(frozen=True, eq=False)
class Kept:
    """A finished refit."""

    point: Point
    blocks_per_error: float  # what the fit counted, see :class:`~pam_antagonist.inference.likelihood.Scale`
    gain: float  # evidence for it after its first descent, which decides whether it is fitted from other starts


@dataclass(frozen=True)
class ResumeFolder:
    """A folder with one small file for each refitted candidate; without a folder, nothing is kept."""

    folder: Path | None = None

    def claim(self, settings: Mapping[str, Any]) -> None:
        """Make the folder that of one run: of these recordings, this rig and these settings.

        `settings`: whatever a candidate depends on, as plain values; ``report.json`` holds them likewise.
        """
        if self.folder is None:
            return
        path = self.folder / _SETTINGS
        if path.is_file():
            try:
                earlier = json.loads(path.read_text(encoding="utf-8"))
            except ValueError:
                earlier = {}
            other = [name for name, value in settings.items() if earlier.get(name) != json.loads(json.dumps(value))]
            if other:
                raise BadInput(
                    f"{self.folder}: left by a run with another {other[0]}; expected the same recordings, rig and "
                    "settings to go on with, or remove it"
                )
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(dict(settings), indent=2) + "\n", encoding="utf-8")

    def finished(self) -> int:
        """How many refits are kept."""
        if self.folder is None or not self.folder.is_dir():
            return 0
        return sum(1 for path in self.folder.glob("*.json") if path.name != _SETTINGS)

    def load(self, key: str) -> Kept | None:
        """A finished refit, None where there is none that can be read."""
        if self.folder is None or not (self.folder / f"{key}.json").is_file():
            return None
        try:
            found = json.loads((self.folder / f"{key}.json").read_text(encoding="utf-8"))
            effects = {str(name): float(value) for name, value in found["effects"].items()}
            point = Point(np.array(found["theta"], dtype=np.float64), effects)
            return Kept(point, float(found["blocks_per_error"]), float(found["gain"]))
        except (ValueError, KeyError, TypeError, AttributeError):
            return None

    def save(self, key: str, kept: Kept) -> None:
        """Keep a finished refit."""
        if self.folder is None:
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        point = kept.point
        content = {
            "theta": point.theta.tolist(),
            "effects": dict(point.effects),
            "blocks_per_error": kept.blocks_per_error,
            "gain": kept.gain,
        }
        partial = self.folder / f"{key}.part"
        partial.write_text(json.dumps(content), encoding="utf-8")
        partial.replace(self.folder / f"{key}.json")


def key_of(experiment: Experiment, parts: Sequence[str]) -> str:
    """Name of a refit: what was fitted, on what, from which model."""
    digest = hashlib.sha256()
    digest.update(np.ascontiguousarray(experiment.trial.measured).tobytes())
    digest.update(np.ascontiguousarray(experiment.trial.given).tobytes())
    digest.update(f"{experiment.rig!r} {experiment.fitted} {experiment.held_parts} {experiment.seed} ".encode())
    digest.update(f"{sorted(experiment.spans.items())} {experiment.span} {experiment.narrower} ".encode())
    digest.update(f"{type(experiment).__name__} ".encode())
    digest.update(f"{experiment.trial.joint} {experiment.trial.lock_angle} {'/'.join(parts)}".encode())
    return digest.hexdigest()[:24]


class Work(NamedTuple):
    """Where a search says what it does, and where it keeps finished candidates."""

    progress: Callable[[str], None] = lambda text: None
    checkpoint: ResumeFolder = ResumeFolder()


@dataclass(frozen=True, eq=False)
class TriedCandidate:
    """A candidate in one round of a search."""

    effect: str
    round: int
    score: float
    # evidence of the fitted part after a full fit; None where the score was too low for one.
    delta_bic: float | None = None
    # evidence of the held-out part, where no parameter has a price; None likewise.
    held_out_evidence: float | None = None
    # of the held-out and of the fitted excess that it removes; None likewise, and beside a model at the noise, which
    # has no excess.
    shares: tuple[float, float] | None = None
    model: Model | None = None
    # the score with muscle 1 alone, and with muscle 2 alone; None where the effect belongs to no muscle.
    muscles: tuple[float, float] | None = None
    # of the excess without effects, fitted and held out together, that it removes; None likewise.
    share: float | None = None
    taken: bool = False
    # the model without effects of the recordings as the candidate sees them, where it is finished; None: as they were.
    base: Model | None = None
    # of a calibration that cannot be the same in all recordings: value and standard deviation in each of them, by name.
    apart: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    part: str = ""  # of the joint in which it was tried; empty while a search goes on

    @property
    def standing(self) -> float:
        """Evidence of both parts, by which candidates are compared; those without a full fit come last."""
        return -np.inf if self.delta_bic is None else self.delta_bic + (self.held_out_evidence or 0.0)

    @property
    def least(self) -> float:
        """The smaller evidence of both parts."""
        return -np.inf if self.delta_bic is None else min(self.delta_bic, self.held_out_evidence or 0.0)

    def fitted(
        self, first: Model, before: Model, fits: Sequence[Fitted | None], effects: Sequence[str]
    ) -> TriedCandidate:
        """The candidate with the results of its fits. A recording without positive evidence for it keeps its model.

        Args:
            first: model without any effect, whose excess counts.
            before: model without the candidate, of recordings as the candidate sees them.
            fits: None for a recording in which the candidate was not fitted.
            effects: of the model with it.
        """

        def one(experiment: Experiment, old: Fitted, new: Fitted | None) -> tuple[Fitted, float, float]:
            gain = 0.0 if new is None else evidence(experiment, old, new)
            if new is None or gain <= 0.0:
                return old, 0.0, 0.0
            return new, gain, held_out_evidence(experiment, old, new)

        each = [one(*pair, new) for pair, new in zip(before.pairs, fits, strict=True)]
        chosen, gains, later = zip(*each, strict=True)
        model = Model(before.experiments, chosen, tuple(effects))
        return replace(
            self, delta_bic=sum(gains), held_out_evidence=sum(later), model=model,
            share=further_share(first, before, model),
            shares=(held_share(before, model), further_share(before, before, model, FITTED)),
        )  # fmt: skip

    @property
    def is_worth_taking(self) -> bool:
        """Whether it goes into the model.

        Its evidence is positive in the fitted part and in the held-out part, and strong enough in both together. It
        removes enough of the excess.
        """
        if self.held_out_evidence is None or self.shares is None or self.least < thresholds.POSITIVE:
            return False
        strong = self.held_out_evidence >= thresholds.STRONG
        enough = thresholds.TAKEN if strong else thresholds.TAKEN_WITHOUT_STRONG_HELD_OUT
        first, further = self.shares[0] >= thresholds.FIRST_SHARE, (self.share or 0.0) >= thresholds.FURTHER_SHARE
        return self.standing >= enough and (first if self.round == 1 else further)

    @property
    def ends_at_noise(self) -> bool:
        """Whether it has enough evidence, and with it the model is at the sensors' noise.

        Such a candidate may remove little of the excess, since the model has left little.
        """
        certain = self.least >= thresholds.POSITIVE and self.standing >= thresholds.TAKEN
        return certain and self.model is not None and self.model.is_at_noise

    def near(self, others: Sequence[TriedCandidate]) -> tuple[str, ...]:
        """Candidates that do as well, by evidence and on held-out data."""
        return tuple(
            other.effect for other in others if other is not self and self.standing - other.standing < thresholds.STRONG
            and not other.apart and (other.shares is None or other.shares[0] >= thresholds.FIRST_SHARE)
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Ranking:
    """What a search tried, and what it took."""

    base: Model  # the model without effects; calibrations that were taken are in it
    model: Model  # with effects
    tried: tuple[TriedCandidate, ...] = ()  # every candidate for an effect of every round, in the order of evidence
    # every calibration of every round, likewise; it is in both models where it was taken.
    calibrations: tuple[TriedCandidate, ...] = ()
    # for each effect and calibration that was taken, those that would have done as well in its place; of an effect its
    # rivals among calibrations only.
    rivals: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    start: Model | None = None

    @property
    def first(self) -> Model:
        """The model whose excess counts: the base, or one before an effect that the recordings already contain."""
        return self.base if self.start is None else self.start

    @property
    def share(self) -> float:
        """The share of the held-out excess that the effects remove."""
        return held_share(self.base, self.model) if self.model.effects else 0.0

    @property
    def leader(self) -> TriedCandidate | None:
        """The effect of the first round that leads all others clearly, even if it leaves most of the excess; else None.

        Physics outside of the catalogue is imitated by several effects about equally well. An effect whose form differs
        from its law has no such rival.
        """
        first = sorted((one for one in self.tried if one.round == 1), key=lambda one: -one.standing)
        if not first or first[0].shares is None:
            return None
        best, second = first[0], max((one.standing for one in first[1:]), default=0.0)
        enough = best.standing >= max(thresholds.TAKEN_WITHOUT_STRONG_HELD_OUT, thresholds.LEADS * second)
        large = min(best.shares or (0.0,)) >= thresholds.EXPLAINED_BY_LEADER
        return best if best.least >= thresholds.STRONG and enough and large else None


class Hypothesis(ABC):
    """A kind of thing that recordings may show and a model lacks.

    A model that it proposes may have other parameters, or see the recordings in another way (other experiments).
    """

    # whether it is an effect, whose place is in the extended model only; what is no effect is a correction of what was
    # recorded, and its place is in every model.
    is_effect: ClassVar[bool] = True

    @abstractmethod
    def propose(self, now: Ranking, number: int, work: Work) -> list[TriedCandidate]:
        """What it would make of the present model, fitted, each with its evidence.

        `now`: its model is the present one. `number`: of the round.
        """

    def is_worth_taking(self, tried: TriedCandidate) -> bool:
        """Whether one of its candidates may go into the model."""
        return tried.is_worth_taking

    def take(self, now: Ranking, best: TriedCandidate) -> tuple[Model, Model]:
        """The models without and with effects, with a candidate that was chosen."""
        assert best.model is not None
        return best.base or (now.base if self.is_effect else best.model), best.model

    @abstractmethod
    def knows(self, name: str) -> bool:
        """Whether a candidate of this name is one of its own."""

    @abstractmethod
    def sentence(self, name: str, muscle: int | None, values: Mapping[str, float], sealed: bool = False) -> str:
        """What a report says where it was found.

        Args:
            muscle: 1 or 2, or None for both.
            values: of its parameters, by name.
            sealed: whether the joint is sealed.
        """

    @abstractmethod
    def instead(self, name: str) -> str:
        """What a report says where it would explain the data as well as what was found."""

    @abstractmethod
    def experiment(self, name: str, found: str | None = None, sealed: bool = False) -> str:
        """What to record, to tell it from what was found."""
