"""A node whose clock can be set, as NTP, an empty battery or ``date`` sets one, while the machine's own stays right.

``python -m validation.faults.stepped NODE FILE ARGUMENTS...`` runs a node of the package. Its ROS time
is the system's plus the 64-bit integer [ns] in the file. All nodes of a pipeline read the same file, so their clocks
change together.
"""

from __future__ import annotations

import mmap
import sys
from collections.abc import Sequence
from pathlib import Path

from pam_antagonist.__main__ import main as run
from pam_antagonist.nodes.node import PamNode

_SIZE = 8


class Step:
    """An offset that several processes share."""

    def __init__(self, path: Path, *, new: bool = False) -> None:
        if new:
            path.write_bytes(bytes(_SIZE))
        with path.open("r+b") as file:
            self._values = memoryview(mmap.mmap(file.fileno(), _SIZE)).cast("q")

    @property
    def ns(self) -> int:
        """Offset of the clock to the system's [ns]."""
        return self._values[0]

    @ns.setter
    def ns(self, value: int) -> None:
        self._values[0] = value


def main(argv: Sequence[str]) -> int:
    """Run a node; the result is its exit status."""
    node, path, *arguments = argv
    now_ns, step = PamNode.now_ns, Step(Path(path))
    PamNode.now_ns = lambda node: now_ns(node) + step.ns  # type: ignore[method-assign, assignment]
    return run([node, *arguments])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
