"""Models of the angle without physics, fitted and judged on the episodes on which the joint's model is."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis.episodes import Row
from pam_antagonist.inference.bootstrap import rmse
from pam_antagonist.inference.held_episodes import Held, last
from pam_antagonist.inference.pressure_driven import PressureDriven
from pam_antagonist.optional import available

Floats = NDArray[np.float64]
Model = Callable[[Floats, Floats, Floats], Floats]

HISTORY = 48
"""Rows of half a second."""
_EACH = 4
"""The trees see each fourth row of it."""


def features(joint: PressureDriven, rows: int, others: bool) -> Floats:
    """The pressures of a row and of the rows before it (N, ...); before the first row they are as in it.

    Args:
        joint: the episodes.
        rows: of history.
        others: whether further signals count as well.
    """
    begin = np.repeat(joint.first[:-1], np.diff(joint.first))
    signals = np.column_stack([joint.pressure, joint.signals]) if others else joint.pressure
    steps = range(0, rows + 1, _EACH) if rows else (0,)
    at = np.arange(len(joint.time))
    return np.column_stack([signals[np.maximum(at - back, begin)] for back in steps]) / 1e5


def linear(seen: Floats, angle: Floats, unseen: Floats) -> Floats:
    """Least squares.

    Args:
        seen: features that are fitted (N, F).
        angle: theirs (N,) [rad].
        unseen: features of what is asked (M, F).
    """
    ones = np.ones((len(seen), 1))
    solved = np.linalg.lstsq(np.hstack([seen, ones]), angle, rcond=None)[0]
    return np.asarray(np.hstack([unseen, np.ones((len(unseen), 1))]) @ solved)


def trees(seen: Floats, angle: Floats, unseen: Floats) -> Floats:
    """Boosted trees of scikit-learn, as they come.

    Args:
        seen: features that are fitted (N, F).
        angle: theirs (N,) [rad].
        unseen: features of what is asked (M, F).
    """
    from sklearn.ensemble import HistGradientBoostingRegressor  # type: ignore[import-not-found,import-untyped,unused-ignore]

    return np.asarray(HistGradientBoostingRegressor(random_state=0).fit(seen, angle).predict(unseen))


def rows(joint: PressureDriven, held: Held, window: float) -> tuple[Row, ...]:
    """Errors of all models without physics.

    Args:
        joint: the episodes.
        held: which are held out.
        window: share of the fitted ones, the last, for a model of later episodes.
    """
    kinds: list[tuple[str, Model, int, bool]] = [
        ("static map of the two pressures", linear, 0, False),
        ("half a second of the pressures, linear", linear, HISTORY, False),
        ("the same with the other joint's", linear, HISTORY, True),
    ]
    if available("sklearn"):
        kinds.append(("half a second, boosted trees, with the other joint's", trees, HISTORY, True))
    later, between = joint.take(held.later), joint.take(held.interleaved)
    pool, recent = joint.take(held.pool), joint.take(last(held.pool, window))
    out = []
    for name, model, history, others in kinds:

        def errors(
            seen: PressureDriven, unseen: PressureDriven, model: Model = model, history: int = history,
            others: bool = others,
        ) -> Floats:  # fmt: skip
            found = model(features(seen, history, others), seen.angle, features(unseen, history, others))
            return (unseen.angle - found)[:, None]

        out.append(
            Row(
                name,
                rmse(*later.squares(errors(pool, later))),
                rmse(*later.squares(errors(recent, later))),
                rmse(*between.squares(errors(pool, between))),
            )  # fmt: skip
        )
    return tuple(out)
