"""Which way identify and close_loop go with recordings: one table, asked by the commands and by the API.

An option that a way does not name is refused, never ignored.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pam_antagonist.diagnosis.thresholds import SHORTEST
from pam_antagonist.errors import BadInput
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig

_USUAL = {"joint": "auto", "starts": 1, "seed": 0}
"""What some options are where nobody gave them; the others are empty then."""
_STATE = frozenset({"joint", "lock_angle", "seed"})
_FIT = _STATE | {"free", "freeze", "starts", "dask"}
_SEARCH = _STATE | {"store", "resume", "dask"}


@dataclass(frozen=True)
class Way:
    """A row of the table: what was recorded, and the options that each command takes beside the common ones."""

    words: str
    identify: frozenset[str]
    diagnose: frozenset[str]

    def refuse(self, command: str, given: Mapping[str, object], dashes: str = "") -> None:
        """Refuse options that this way does not know.

        `command`: ``identify`` or ``diagnose``. `given`: values by name. `dashes`: what stands before a name.

        Raises:
            BadInput: the first of them.
        """
        for name, value in given.items():
            if value and value != _USUAL.get(name) and name not in getattr(self, command):
                shown = dashes + name.replace("_", "-") if dashes else name
                raise BadInput(f"{shown}: not for {self.words}; leave it out")


COURSE = Way("a joint that valves or regulators drive for long", _FIT, _SEARCH)
TRIALS = Way("short trials of a joint", _FIT, _SEARCH)
DATA_SHEET = Way("a rig file that data sheets and a ruler made", _FIT, _SEARCH)
EPISODES = Way("many episodes of a joint with pressure regulators", frozenset(), frozenset({"also"}))
SEALED = Way("a joint whose muscles are sealed", _STATE, _SEARCH)


def way(recordings: Sequence[Recording], rig: Rig) -> Way:
    """The way for recordings and a rig. A sealed joint goes its own; trials are tried in parts of the model.

    Raises:
        BadInput: recordings without the commands that this way needs.
    """
    by_rig = SEALED if rig.valves.sealed else DATA_SHEET if rig.is_from_data_sheets else None
    in_episodes = any(one.episode_ns is not None for one in recordings)
    if by_rig is None and rig.drive == "regulator" and in_episodes:
        return EPISODES
    for one in recordings:
        one.driven_by(rig.drive)
    if by_rig is not None:
        return by_rig
    short = in_episodes or any(one.duration_s < SHORTEST for one in recordings)
    if short and sum(one.duration_s for one in recordings) >= SHORTEST:
        return TRIALS
    return COURSE
