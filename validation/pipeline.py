"""The live pipeline as processes: nodes with a recorder beside them."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from pam_antagonist.nodes.processes import Processes, free_domain, ros_arguments

_DRAIN = 0.3
"""[s] For samples that are on their way when the plant stops."""


@contextmanager
def running(
    folder: Path, nodes: Mapping[str, Mapping[str, object]], namespaces: Sequence[str] = (), file: Path | None = None
) -> Iterator[Processes]:
    """Nodes with their parameters, the plant as the last one; the bag is in ``folder/bag`` afterwards.

    `namespaces`: of the joints that are recorded, default: the usual one. `file`: parameters by namespace and node.
    """
    # A ROS domain of its own, so that two pipelines cannot hear each other.
    os.environ.setdefault("ROS_DOMAIN_ID", str(free_domain()))
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with Processes(folder) as processes:
        recorded = [word for name in namespaces for word in ("--namespace", name)]
        processes.start("record", ["--out", str(folder / "bag"), *recorded])
        sections = [] if file is None else ["--params-file", str(file)]
        for name, parameters in nodes.items():
            processes.start(name, [*ros_arguments(dict(parameters), {}), *sections])
        try:
            yield processes
        finally:
            # From the source to the sink, so that every sample that was sent is estimated and recorded.
            if "plant" in nodes:
                processes.stop("plant")
                time.sleep(_DRAIN)
            processes.stop(*(name for name in reversed(list(nodes)) if name != "plant"), "record")
