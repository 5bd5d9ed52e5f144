"""What a diagnosis says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from pam_antagonist.diagnosis.heldout import Compared
from pam_antagonist.diagnosis.remaining import Left
from pam_antagonist.diagnosis.select import Model, Trial
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.rig import Rig


@dataclass(frozen=True)
class FoundEffect:
    """An effect that the recordings show.

    Attributes:
        name: in the catalogue.
        muscle: 1 or 2; None for both, and for an effect that belongs to neither.
        parameters: value, standard deviation and unit of each, by name.
        delta_bic: evidence for it: what the model loses without it, the price of its unknowns paid.
        holdout_gain: share of the held-out excess over noise (:mod:`beyond`) that goes with it.
        recordings: names of the recordings that show it.
        notes: what is to be known about it.
    """

    name: str
    muscle: int | None
    parameters: Mapping[str, tuple[float, float, str]]
    delta_bic: float
    holdout_gain: float
    recordings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Ranked:
    """A candidate in one round.

    Attributes:
        name: of the effect.
        round: 1 for the first effect, and so on.
        score: evidence to first order.
        delta_bic: evidence in full simulation, None where the score was too low to try.
        holdout_gain: share of the held-out excess over noise (:mod:`beyond`) that it removes, None likewise.
        taken: whether it went into the model.
        muscles: the score with muscle 1 alone and with muscle 2 alone; None where the effect belongs to no muscle.
    """

    name: str
    round: int
    score: float
    delta_bic: float | None
    holdout_gain: float | None
    taken: bool
    muscles: tuple[float, float] | None


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The answer.

    Attributes:
        verdict: ``effect``, ``none`` or ``unexplained``.
        sentence: the verdict with its evidence, for people.
        effects: what was found; empty but for ``effect``.
        ambiguous_with: effects that the recordings cannot tell from the found ones.
        experiment: what would tell them apart, by effect.
        ranking: all candidates.
        share: share of the held-out excess over noise (:mod:`beyond`) that the extended model removes.
        errors: by model (``as_configured``, ``recalibrated``, ``extended``), as in ``report.json``.
        by_recording: the same and more, for each recording.
        remaining: what is not explained, described.
        unseen: what these recordings cannot show.
        warnings: what the user should know.
        profiles: profile likelihoods of the found sizes.
        rig_recalibrated: common base parameters.
        rig_extended: with the effects.
        own: for each recording its name and its own extended rig.
        experiments: the recordings as they were compared.
        recalibrated: the model without effects.
        extended: the model with them.
        trials: candidates with their models.
        compared: the recordings with the three models on each, those that were held out as a whole as well.
        seconds: what took how long.
        sealed: of a sealed joint, what only such a one has (:mod:`pam_antagonist.diagnosis.sealed`); else None.
    """

    verdict: Literal["effect", "none", "unexplained"]
    sentence: str
    effects: tuple[FoundEffect, ...]
    ambiguous_with: tuple[str, ...]
    experiment: Mapping[str, str]
    ranking: tuple[Ranked, ...]
    share: float
    errors: Mapping[str, Mapping[str, Any]]
    by_recording: tuple[Mapping[str, Any], ...]
    remaining: tuple[Left, ...]
    unseen: tuple[str, ...]
    warnings: tuple[str, ...]
    profiles: tuple[Mapping[str, Any], ...]
    rig_recalibrated: Rig
    rig_extended: Rig
    own: tuple[tuple[str, Rig], ...]
    experiments: tuple[Experiment, ...]
    recalibrated: Model
    extended: Model
    trials: tuple[Trial, ...]
    compared: tuple[Compared, ...]
    seconds: Mapping[str, float]
    sealed: Mapping[str, Any] | None = None
