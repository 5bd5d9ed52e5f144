"""What every function of the API takes: a rig or its name, a recording or its bag."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

from pam_antagonist.recording import Recording, read_bag
from pam_antagonist.recording.recording import Recording as _Recording
from pam_antagonist.rig import Rig, load_rig

RigGiven: TypeAlias = Rig | str | Path
"""A rig, the name of one of the package's, or the path of a rig file."""
Bag: TypeAlias = _Recording | str | Path
"""A recording, or the path of a rosbag2."""


def as_rig(rig: RigGiven) -> Rig:
    """The rig itself.

    Args:
        rig: or its name, or its file.
    """
    return rig if isinstance(rig, Rig) else load_rig(rig)


def as_recording(bag: Bag) -> Recording:
    """The recording itself.

    Args:
        bag: or its bag.
    """
    return bag if isinstance(bag, _Recording) else read_bag(bag)


def as_recordings(bags: Bag | Sequence[Bag]) -> list[Recording]:
    """Recordings, one by one.

    Args:
        bags: one or several.
    """
    several = [bags] if isinstance(bags, (_Recording, str, Path)) else bags
    return [as_recording(bag) for bag in several]
