"""The assumption behind the intervals of a report whose rig was not identified, for its first lines."""

from __future__ import annotations

from pam_antagonist.rig.schema import Rig
from pam_antagonist.shown import number


def assumption(rig: Rig, tuning: str = "default", identified: bool = False) -> str | None:
    """The uncertainty that a rig file claims without proof, in a sentence; None for an identified rig."""
    if rig.identified:
        return None
    considered = rig.tuning(tuning).consider
    claimed = [f"{name} ± {_size(rig.value(name), std)}" for name, std in rig.uncertainty.items() if considered]
    if considered and rig.directions:
        claimed.append(f"its {len(rig.directions)} directions")
    known = f"as well as its file claims ({', '.join(claimed)})" if claimed else "exactly, as its file claims,"
    its = "As configured, its" if identified else "Its"
    also = " The intervals of the identified rig follow from the recordings." if identified else ""
    return (
        f"Assumption: rig {rig.name} was not identified. {its} 95 % intervals are right if its parameters are known "
        f"{known} and if nothing else is wrong.{also} The NIS tests the pressures only: it cannot show whether that is "
        "so."
    )


def _size(value: float, std: float) -> str:
    """An uncertainty in per cent of the value; absolute where the value is 0."""
    return f"{number(100.0 * std / abs(value), 2)} %" if value else number(std, 2)
