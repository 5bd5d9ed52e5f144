"""Firmness of a found effect: whether several splits of a recording support it.

The recording is held out in five parts in turn. In each split the models with and without the effect are fitted again
to the rest, from their earlier fits and with the derivatives there. The held-out part then decides between them. A
buffer as long as the memory of the residual separates it from the rest: values next to a fitted block are no prediction
(Burman, Chow and Nolan 1994).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis import thresholds
from pam_antagonist.diagnosis.models import Model, in_threads, likelier, recalibrated
from pam_antagonist.diagnosis.preparation import Group
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.gauss_newton import Fitted, Linearised
from pam_antagonist.inference.trial import Split
from pam_antagonist.strict_json import picked

Floats = NDArray[np.float64]

SPLITS = 5
_LENGTH = 10.0
"""[s] Approximate length that is held out at once in a long recording."""
_THIRDS, _STRETCH, _BETWEEN = 3, 5.0, 1.0
"""Stretches that are counted in turn, their length and what lies between fitted and held out ones, about [s]."""
_MOST_BUFFER = 3.0
"""[s] Longest buffer between fitted and held-out data, however long the residual's memory is."""


def in_turn(
    count: int, splits: int, length: float, buffer: int, errors_from: int, edges: Sequence[int] = ()
) -> tuple[Split, ...]:
    """Splits that hold out blocks in turn, so that each part of a recording is held out once.

    Args:
        length: of what is held out at once, about [block means].
        buffer: block means on either side of what is held out that are neither fitted nor held out.
        edges: where the recording changes; every part between them is split by itself.
    """
    turn = np.zeros(count, dtype=int)
    bounds = [0, *(edge for edge in edges if splits <= edge <= count - splits), count]
    for begin, end in zip(bounds[:-1], bounds[1:], strict=True):
        pieces = splits * max(round((end - begin) / (splits * length)), 1)
        turn[begin:end] = np.arange(end - begin) * pieces // (end - begin) % splits
    out = []
    for number in range(splits):
        held = turn == number
        near = np.convolve(held, np.ones(2 * buffer + 1), mode="full")[buffer : buffer + count] > 0.0
        out.append(Split(~near, held, errors_from))
    return tuple(out)


def parted(experiment: Experiment, edges: Sequence[int] = ()) -> Experiment:
    """A recording of which every third stretch is held out, and not its end. `edges`: as of :func:`in_turn`."""
    trial = experiment.trial
    count, length, buffer = len(trial) // trial.block, _STRETCH / trial.block_s, round(_BETWEEN / trial.block_s)
    split = in_turn(count, _THIRDS, length, buffer, experiment.errors_from, edges)[-1]
    return replace(experiment, fitted=count * trial.block, split=split)


@dataclass(frozen=True)
class Firmness:
    """What the splits say of an effect."""

    evidence: tuple[float, ...]
    held_s: tuple[tuple[float, float], ...]  # begin and end [s] of what each split holds out, the last part of it

    @property
    def agree(self) -> int:
        """How many splits support the effect."""
        return sum(value > 0.0 for value in self.evidence)

    @property
    def of(self) -> int:
        """How many splits there are."""
        return len(self.evidence)

    def to_json(self) -> dict[str, int]:
        """The keys of ``report.json``."""
        return picked(self, "agree", "of")

    @property
    def is_firm(self) -> bool:
        """Whether most splits support the effect."""
        return self.agree >= thresholds.SPLITS_AGREE

    def in_words(self) -> str:
        """The number of splits that agree, and those that do not."""
        against = [
            f"{begin:.0f} to {end:.0f} s"
            for value, (begin, end) in zip(self.evidence, self.held_s, strict=True)
            if value <= 0.0
        ]
        text = f"{self.agree} of {self.of} splits agree"
        return text if not against else f"{text}; those that hold out {', '.join(against)} disagree"


def in_words(firm: Mapping[str, Firmness]) -> str:
    """What the splits say of all effects, in words; empty where there were no splits."""
    if len({one.agree for one in firm.values()}) == 1 and min(one.agree for one in firm.values()) == SPLITS:
        return next(iter(firm.values())).in_words()
    several = len(firm) > 1
    return "; ".join((f"{name}: " if several else "") + one.in_words() for name, one in firm.items())


def by_itself_or_in_turn(group: Group) -> Model:
    """The model without effects of a group, of recordings with what is held out of them.

    An angle-driven joint shows few sweeps. Its last part alone would decide by one or two of them. So its recordings
    are fitted as a whole and judged by all splits together. Errors in a report stay those of the last part.
    """
    if any(experiment.runs_by_itself or experiment.judged for experiment in group.experiments):
        return recalibrated(group.experiments)
    base = recalibrated([_whole(experiment) for experiment in group.experiments])
    pairs = zip(group.experiments, base.fits, strict=True)
    return replace(base, experiments=tuple(replace(_whole(e), splits=_splits(e, f)) for e, f in pairs))


def firmness(model: Model, without: Mapping[str, Model]) -> dict[str, Firmness]:
    """What the splits say of each effect of a model, by its name."""
    splits = model.each(_splits)
    fits = {"": model, **without}
    differ = {name: [r for r, old in enumerate(one.fits) if old is not model.fits[r]] for name, one in without.items()}
    shown = [("", r) for r in sorted(set().union(*differ.values()))]
    shown += [(name, r) for name, recordings in differ.items() for r in recordings]

    def linear(name: str, r: int) -> Linearised:
        return Linearised.of(_whole(fits[name].experiments[r]), fits[name].fits[r])

    def held(name: str, r: int, k: int) -> Floats:
        return starts[name, r].on(splits[r][k].fitted).residual[splits[r][k].held]

    starts = dict(zip(shown, in_threads(linear, shown, model.jobs), strict=True))
    tasks = [(name, r, k) for name, r in shown for k in range(SPLITS)]
    left = dict(zip(tasks, in_threads(held, tasks, model.jobs), strict=True))

    def evidence(name: str, k: int) -> float:
        scales = {r: fits[name].fits[r].scale for r in differ[name]}
        return sum(likelier(scale, left[name, r, k], left["", r, k]) for r, scale in scales.items())

    parts = tuple(_held(model.experiments[0], split) for split in splits[0])
    return {name: Firmness(tuple(evidence(name, k) for k in range(SPLITS)), parts) for name in without}


def _whole(experiment: Experiment) -> Experiment:
    """The recording with nothing held out."""
    return replace(experiment, fitted=experiment.trial.whole_blocks(len(experiment.trial)), split=None, judged=())


def _splits(experiment: Experiment, fitted: Fitted) -> tuple[Split, ...]:
    """The splits of a recording, with buffers as long as the memory of its model's residual."""
    block = experiment.trial.block_s
    buffer = round(min(float(fitted.scale.length.max()), _MOST_BUFFER / block))
    edges = [round(edge / block) for edge in experiment.edges(fitted.point)]
    return in_turn(
        len(experiment.trial) // experiment.trial.block, SPLITS, _LENGTH / block, buffer, experiment.errors_from, edges
    )  # fmt: skip


def _held(experiment: Experiment, split: Split) -> tuple[float, float]:
    """Begin and end [s] of the last part that a split holds out."""
    edges = np.flatnonzero(np.diff(split.held, prepend=False, append=False))[-2:]
    begin, end = edges * experiment.trial.block_s
    return float(begin), float(end)
