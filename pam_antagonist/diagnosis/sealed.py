"""The diagnosis of a sealed joint that is moved from outside: the same steps, with the measured angle as the input."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from pam_antagonist.diagnosis import alike, errors, findings, rigs, rules, sealed_base, sealed_errors, sealed_words
from pam_antagonist.diagnosis.alike import Alike
from pam_antagonist.diagnosis.heldout import Compared
from pam_antagonist.diagnosis.laps import Laps
from pam_antagonist.diagnosis.profiles import profile_sizes
from pam_antagonist.diagnosis.result import Diagnosis, FoundEffect, Ranked
from pam_antagonist.diagnosis.sealed_left import describe, statistics
from pam_antagonist.diagnosis.select import (
    STRONG,
    Model,
    Selection,
    Trial,
    recalibrated,
    select,
)
from pam_antagonist.diagnosis.shares import held_share, left_by
from pam_antagonist.diagnosis.store import Store
from pam_antagonist.errors import BadInput
from pam_antagonist.identification.sealed_session import tuned
from pam_antagonist.inference.angle_driven import AIR, BALANCE, AngleDriven
from pam_antagonist.inference.trial import TORQUE
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig

_NAMES = {AIR: "pressures", BALANCE: "torque"}
_FEW_SWEEPS = 4
_TUNINGS = 25
"""Tunings of the estimator that are tried for each model, from the rig file's."""
_FORETOLD = 2.0
"""Evidence on held-out data: positive (Kass and Raftery 1995). Few sweeps are held out: strong is too much to ask."""
_LEAST_SHARE = 0.1
"""Share of the held-out squares beyond noise that a candidate must remove."""
EXPLAINED = 0.5
"""Share of the held-out excess over noise that effects must remove. A joint sticks and its muscles stray, and no law of
the catalogue gives either; the larger part is what can be asked of an explanation."""


@dataclass(frozen=True, eq=False)
class Judged:
    """One part of the joint, its air or its balance of torques, with what was found there.

    Attributes:
        part: ``air`` or ``balance``.
        experiments: the recordings.
        selection: what was tried.
        verdict: of this part alone.
        share: of its held-out residual beyond noise that its effects remove.
        model: the chosen one, the recalibrated one where no effect was found.
        effects: that were found.
        values: of their parameters, by dotted path.
        warnings: contradictions between recordings.
    """

    part: str
    experiments: tuple[AngleDriven, ...]
    selection: Selection
    verdict: str
    share: float
    model: Model
    effects: tuple[FoundEffect, ...]
    values: Mapping[str, float]
    warnings: tuple[str, ...]

    @property
    def base(self) -> Model:
        """The model without effects."""
        return self.selection.recalibrated


def diagnose_sealed(
    recordings: Sequence[Recording],
    rig: Rig,
    *,
    joint: str = "auto",
    holdout: float = 1.0 / 3.0,
    jobs: int = 2,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
    profiles: bool = True,
    estimator: bool = True,
    store: Store | None = None,
) -> Diagnosis:
    """Trace what the model of a sealed joint lacks; arguments as of :func:`pam_antagonist.diagnosis.diagnose`.

    Raises:
        BadInput: recordings from which nothing can be told.
    """
    if not recordings:
        raise BadInput("no recording: expected one at least")
    if not 0.1 <= holdout <= 0.5:
        raise BadInput(f"holdout {holdout:g}: expected a share of each recording from 0.1 to 0.5")
    said = progress or (lambda message: None)
    laps = Laps()
    trials = [sealed_base.made_ready(recording, rig, joint, holdout) for recording in recordings]
    cuts = [sealed_base.cut(trial, holdout) for trial in trials]
    named = [(recording, trial.name) for recording, trial in zip(recordings, trials, strict=True)]
    plain = sealed_base.identified(named, rig, holdout, said)
    laps.end("recalibration")
    parts: list[Judged] = []
    for kind in (AIR, BALANCE):
        known = [(trial, cut) for trial, cut in zip(trials, cuts, strict=True) if kind == AIR or trial.has(TORQUE)]
        if known:
            driven = tuple(
                AngleDriven(
                    plain, replace(trial, name=f"{trial.name}, {_NAMES[kind]}"), cut, seed=seed, jobs=jobs, part=kind
                )
                for trial, cut in known
            )
            parts.append(_judged(kind, driven, jobs, said, store or Store()))
    laps.end("selection")
    # The part that shows the stronger effect comes first.
    parts.sort(key=lambda part: -max((effect.delta_bic for effect in part.effects), default=0.0))
    found = tuple(
        replace(effect, recordings=tuple(name.rsplit(",", 1)[0] for name in effect.recordings))
        for part in parts for effect in part.effects
    )  # fmt: skip
    verdicts = {part.verdict for part in parts}
    verdict = "effect" if "effect" in verdicts else "unexplained" if "unexplained" in verdicts else "none"
    warnings = [warning for part in parts for warning in part.warnings]
    warnings += sealed_words.few_sweeps(trials, cuts, _FEW_SWEEPS)
    for part in parts:
        for effect in part.effects:
            alone = alike.either_muscle(part.experiments, part.model.fits, effect.name) if part.part == AIR else None
            if alone is not None:
                warnings.append(
                    f"{effect.name}: both muscles alike is simplest, but muscle {alone} alone would do nearly as well"
                )
    compared_on = [item for part in parts for item in _alike(part)]
    found = tuple(_with_spread(effect, compared_on) for effect in found)
    ambiguous = tuple(dict.fromkeys(name for name in (*_near(parts), *(a.other for a in compared_on if a.ambiguous))))
    profiled: list[Mapping[str, Any]] = []
    for part in parts:
        if profiles and part.effects:
            profiled += profile_sizes(part.experiments, part.model, part.effects, jobs, said)
    flat = [item["parameter"] for item in profiled if item["flat"]]
    if flat:
        warnings.append(f"the likelihood of {', '.join(flat)} is flat: not determined by these recordings")
    laps.end("profiles")
    models = {"as_configured": rig, "recalibrated": _rig(plain, parts, True), "extended": _rig(plain, parts, False)}
    if estimator:
        said("tuning the estimators")
        names = ["recalibrated", *(["extended"] if found else [])]
        best = Parallel(n_jobs=jobs, prefer="threads")(
            delayed(tuned)(models[name], named, 1.0 - holdout, lambda text: None, _TUNINGS) for name in names
        )
        models |= {name: rig for name, (rig, _, _) in zip(names, best, strict=True)}
    if not found:
        models["extended"] = models["recalibrated"]
    laps.end("tuning")
    said("errors before and after")
    entries = []
    for recording, trial, cut in zip(recordings, trials, cuts, strict=True):
        own = {name: _own(model, name, parts, trial.name) for name, model in models.items()}
        entry = _entry(recording, trial, cut, own, estimator)
        entries.append({**entry, "residuals": _statistics(parts, trial.name)})
    samples = [len(trial) - cut for trial, cut in zip(trials, cuts, strict=True)]
    totals = {name: _together([entry["errors"][name] for entry in entries], samples) for name in models}
    laps.end("errors")
    share = min((part.share for part in parts if part.effects), default=0.0)
    remaining = tuple(left for part in parts for left in describe(part.experiments, part.model))
    laps.end("remaining residual")
    reference = sealed_errors.static_map(trials, cuts)
    return Diagnosis(
        verdict=verdict,  # type: ignore[arg-type]
        sentence=sealed_words.sentence(verdict, found, ambiguous, totals, reference),
        effects=found,
        ambiguous_with=ambiguous,
        experiment=sealed_words.experiments(ambiguous),
        ranking=_ranking(parts),
        share=share,
        errors=totals,
        by_recording=tuple(entries),
        remaining=remaining,
        unseen=sealed_words.unseen(any(trial.has(TORQUE) for trial in trials)),
        warnings=tuple(warnings),
        profiles=tuple(profiled),
        rig_recalibrated=models["recalibrated"],
        rig_extended=models["extended"],
        own=tuple((trial.name, _own(models["extended"], "extended", parts, trial.name)) for trial in trials),
        experiments=tuple(e for part in parts for e in part.experiments),
        recalibrated=Model((), tuple(f for part in parts for f in part.base.fits)),
        extended=Model(tuple(n for p in parts for n in p.model.effects), tuple(f for p in parts for f in p.model.fits)),
        trials=tuple(trial for part in parts for trial in part.selection.trials),
        compared=_compared(parts),
        seconds=laps.seconds,
        sealed={
            "reference": reference,
            "alike": [_alike_entry(item) for item in compared_on],
            "shares": {_NAMES[part.part]: part.share for part in parts if part.effects},
            "verdicts": {_NAMES[part.part]: part.verdict for part in parts},
            "friction_taken_out": rig.friction.shaft > 0.0 or rig.friction.muscle > 0.0,
        },
    )


def _judged(
    part: str, experiments: tuple[AngleDriven, ...], jobs: int, said: Callable[[str], None], store: Store
) -> Judged:
    """Recalibrate, select and judge one part."""
    base = recalibrated(experiments, jobs)
    selection = select(experiments, base, jobs, _worth, lambda text: said(f"{_NAMES[part]}: {text}"), store)
    model = selection.model
    share = held_share(experiments, *(left_by(experiments, m.fits) for m in (base, model)))
    enough = bool(model.effects) and (share >= EXPLAINED or rules.at_noise(experiments, model))
    if enough:
        verdict, model = "effect", findings.without_idle(experiments, base, model, jobs)
    else:
        verdict, model = ("unexplained" if rules.has_significant_excess(experiments, base.fits) else "none"), base
    effects, values, warnings = findings.found(experiments, base, model, jobs)
    return Judged(
        part, experiments, selection, verdict, share if enough else 0.0, model, effects, values, tuple(warnings)
    )


def _worth(trial: Trial) -> bool:
    """Whether a candidate goes into the model: strong evidence where it was fitted, none against it elsewhere."""
    if trial.delta_bic is None or trial.foretold is None or trial.shares is None or trial.model is None:
        return False
    return trial.delta_bic >= STRONG and trial.foretold >= _FORETOLD and trial.shares[0] >= _LEAST_SHARE


def _alike(part: Judged) -> list[Alike]:
    """What was compared with the found effects on equal terms."""
    if part.verdict != "effect":
        return []
    if part.part == AIR:
        tried = alike.losses(part.experiments, part.base.fits, part.model.effects)
    else:
        tried = alike.loops(part.experiments, part.model.fits, part.model.effects)
    return [] if tried is None else [tried]


def _with_spread(effect: FoundEffect, compared_on: Sequence[Alike]) -> FoundEffect:
    """A friction whose error holds what the sticking samples change, in which its torque may be anything up to it."""
    sizes = [item.size for item in compared_on if item.found == effect.name and np.isfinite(item.size)]
    if effect.name != "friction" or not sizes:
        return effect
    value, std, unit = effect.parameters["coulomb"]
    spread = (value, float(np.hypot(std, value - sizes[0])), unit)
    return replace(effect, parameters={**effect.parameters, "coulomb": spread})


def _alike_entry(item: Alike) -> dict[str, Any]:
    return {
        "found": item.found, "other": item.other, "evidence": item.evidence, "residual": list(item.residual),
        "unit": item.unit, "shape": item.shape, "about": item.about, "ambiguous": item.ambiguous,
        "size": None if np.isnan(item.size) else item.size,
    }  # fmt: skip


def _near(parts: Sequence[Judged]) -> tuple[str, ...]:
    """Candidates that do as well as the one that was taken in their round."""
    out = []
    for part in parts:
        if part.verdict != "effect":
            continue
        for trial in part.selection.trials:
            taken = next(
                t for t in part.selection.trials if t.round == trial.round
            )  # they stand in the order of evidence
            if trial.round > len(part.selection.model.effects) or trial is taken or trial.shares is None:
                continue
            if taken.standing - trial.standing < STRONG and trial.shares[0] >= _LEAST_SHARE:
                out.append(trial.effect)
    found = {name for part in parts for name in part.model.effects}
    return tuple(name for name in dict.fromkeys(out) if name not in found)


def _rig(plain: Rig, parts: Sequence[Judged], without_effects: bool) -> Rig:
    """One rig with what was found in all parts."""
    now = plain
    for part in parts:
        here = tuple(replace(experiment, rig=now) for experiment in part.experiments)
        model, values = (part.base, {}) if without_effects else (part.model, part.values)
        now = rigs.common_rig(here, model, values)
    return now


def _own(rig: Rig, name: str, parts: Sequence[Judged], recording: str) -> Rig:
    """A rig with one recording's own values; the one that was configured stays as it is."""
    if name == "as_configured":
        return rig
    now = rig
    for part in parts:
        model = part.model if name == "extended" else part.base
        for experiment, fitted in zip(part.experiments, model.fits, strict=True):
            if experiment.trial.name == f"{recording}, {_NAMES[part.part]}":
                now = rigs.own_rig(replace(experiment, rig=now), fitted.point) if len(part.experiments) > 1 else now
    return now


def _entry(recording: Recording, trial: Any, cut: int, models: Mapping[str, Rig], estimator: bool) -> dict[str, Any]:
    """A recording in ``report.json``."""
    entry: dict[str, Any] = {
        "recording": trial.name,
        "joint": trial.joint,
        "lock_angle_rad": None,
        "role": "both",
        "held_out_from_s": cut * trial.dt,
        "sweeps": {
            "fitted": sealed_base.sweeps(trial, 0, cut), "held_out": sealed_base.sweeps(trial, cut, len(trial))
        },
        "errors": {name: sealed_errors.held_out(trial, cut, rig) for name, rig in models.items()},
    }  # fmt: skip
    if estimator:
        entry["ukf"] = {name: sealed_errors.of_estimator(recording, rig, trial, cut) for name, rig in models.items()}
    return entry


def _statistics(parts: Sequence[Judged], recording: str) -> dict[str, list[dict[str, Any]]]:
    """What the residuals of a recording are like on held-out data, by model."""
    return {
        name: [
            row
            for part in parts
            for experiment, old, new in zip(part.experiments, part.base.fits, part.model.fits, strict=True)
            if experiment.trial.name == f"{recording}, {_NAMES[part.part]}"
            for row in statistics(experiment, (old if name == "recalibrated" else new).point)
        ]
        for name in ("recalibrated", "extended")
    }


def _together(parts: Sequence[Mapping[str, Any]], samples: Sequence[int]) -> dict[str, Any]:
    out = errors.together(parts, samples)
    means = [part["pressure"]["mean_rmse_pa"] ** 2 * count for part, count in zip(parts, samples, strict=True)]
    out["pressure"]["mean_rmse_pa"] = (sum(means) / sum(samples)) ** 0.5
    if len(parts) == 1:
        out["torque"] = parts[0]["torque"]
    return out


def _ranking(parts: Sequence[Judged]) -> tuple[Ranked, ...]:
    out = []
    for part in parts:
        for trial in part.selection.trials:
            taken = part.verdict == "effect" and trial.model is not None and trial.effect in part.model.effects and (
                trial.model.effects == part.selection.model.effects[: trial.round]
            )  # fmt: skip
            share = None if trial.shares is None else trial.shares[0]
            out.append(Ranked(trial.effect, trial.round, trial.score, trial.delta_bic, share, taken, trial.muscles))
    return tuple(out)


def _compared(parts: Sequence[Judged]) -> tuple[Compared, ...]:
    """Each part of each recording with its models."""
    return tuple(
        Compared(
            experiment,
            {"as_configured": experiment.origin, "recalibrated": old.point, "extended": new.point},
            "both",
        )
        for part in parts
        for experiment, old, new in zip(part.experiments, part.base.fits, part.model.fits, strict=True)
    )
