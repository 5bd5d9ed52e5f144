"""The experiment that would tell effects apart that a recording cannot."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from pam_antagonist.model.effects import CATALOGUE, experiment_between


def experiments_that_tell(
    found: Sequence[str], ambiguous: Sequence[str], conditions: Collection[str]
) -> dict[str, str]:
    """For each effect that is as likely as a found one, what to record.

    Args:
        found: effects in the model.
        ambiguous: effects that do as well.
        conditions: of the joint in the recordings at hand.
    """
    said = {}
    for other in ambiguous:
        pair = experiment_between(other, found[0]) if found else None
        said[other] = pair or CATALOGUE[other].experiment
        if len(set(conditions)) == 1:
            missing = "locked" if "free" in conditions else "free"
            said[other] += f"; or add a recording with the joint {missing}"
    return said
