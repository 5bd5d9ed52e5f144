"""The pictures of the tutorial, from its rehearsal: ``./run python docs/tutorial_pictures.py rehearsed``."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from pam_antagonist.recording import read_bag
from pam_antagonist.report.commission import Driven, figure_of
from validation.pictures import picture

OUT = Path(__file__).parent / "tutorials"


def main() -> None:
    """Write ``docs/tutorials/slow.png`` and ``quick.png``."""
    done = Path(sys.argv[1])
    for name in ("slow", "quick"):
        limits = json.loads((done / f"{name}_1" / "plan.json").read_text())["limits"]
        recording = read_bag(done / f"{name}_1" / "bag", judge=False)
        driven = Driven(name, recording, tuple(limits["pressure_pa"]), limits["angle_rad"])
        (OUT / f"{name}.png").write_bytes(picture(figure_of(driven)))


if __name__ == "__main__":
    main()
