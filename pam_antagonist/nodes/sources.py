"""Where the messages of a node come from: topics without a publisher, with several, and samples that do not come."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

from pam_antagonist.nodes.arrivals import disagreement, mixed
from pam_antagonist.nodes.health import Level, publishers_of
from pam_antagonist.recording.topics import TOPICS
from pam_antagonist.shown import listed

if TYPE_CHECKING:
    from collections.abc import Callable

    from pam_antagonist.nodes.node import PamNode
    from pam_antagonist.nodes.pairing import SamplePairing

_SECOND_NS = 1_000_000_000
"""[ns] in which a node is heard that is there."""
_AGAIN_NS = 900_000_000
"""[ns] Shortest time between two judgements: a joint at 10 Hz has samples in it, and a timer of 1 s may be early."""


def several(node: PamNode, topics: Iterable[str]) -> str:
    """The first topic with more than one publisher, in words; empty if there is none.

    `topics`: relative names.
    """
    for topic in topics:
        names = publishers_of(node, topic)
        if len(names) > 1:
            return (
                f"{len(names)} nodes publish {node.resolve_topic_name(topic)}: {listed(names)}; expected one (a node "
                "that was killed counts for some seconds)"
            )
    return ""


class OneEstimator:
    """Notices a second estimator on the topic of the estimates. One alone never sends a stamp twice.

    Nothing tells which of the two is right, so this is a reason to stop. The messages of a subscription with a callback
    have no number (see :meth:`PamNode.collect`), so their stamps have to tell.

    `disagree`: called with the problem in words.

    Attributes:
        repeats: estimates so far whose stamp was not newer than the last one; the caller counts them.
        present: the present problem, in words; empty if there is none.
    """

    def __init__(self, node: PamNode, disagree: Callable[[str], object]) -> None:
        self.repeats = 0
        self.present = ""
        self._node, self._disagree = node, disagree
        self._before = 0
        self._until_ns = 0

    def look(self, steady_ns: int) -> None:
        """Look whether estimates were repeated since the last call. `steady_ns`: steady time [ns]."""
        if self.repeats > self._before:
            self._before, self._until_ns = self.repeats, steady_ns + _SECOND_NS
            self.present = self.publishers
            if self.present:
                self._disagree(self.present)
        elif steady_ns > self._until_ns:
            self.present = ""

    @property
    def publishers(self) -> str:
        """The nodes that publish estimates, in words, if they are several; also where only one sends some now."""
        return several(self._node, (TOPICS["joint_estimate"].relative,))


class SourceFinding(NamedTuple):
    """What is wrong with the samples' topics."""

    level: Level
    words: str  # empty if nothing is
    is_mixed: bool = False  # whether several nodes send samples, of which nothing tells the right ones


class SampleSources:
    """Says why no samples, or incomplete ones, come of the topics of a sample; in the log as well, once.

    `names`: relative names of the topics by their places in a sample. `pairing`: what combines their messages.
    `period`: of the samples [s].
    """

    def __init__(self, node: PamNode, names: Mapping[int, str], pairing: SamplePairing, period: float) -> None:
        self._node, self._names, self._pairing, self._period = node, names, pairing, period
        self._samples = self._complete = 0
        self._lacking = dict(pairing.counts.lacking)
        self._since_ns: int | None = None
        self._kind = self._logged = ""
        self._finding = SourceFinding(Level.OK, "")

    def report(self, steady_ns: int) -> SourceFinding:
        """What is wrong now. It is judged about once a second. `steady_ns`: steady time [ns]."""
        if self._since_ns is not None and steady_ns - self._since_ns < _AGAIN_NS:
            return self._finding
        self._since_ns, before = steady_ns, self._kind
        self._kind, self._finding = self._judge()
        if self._kind and self._kind == before != self._logged:  # not what is soon over, as at a start
            self._logged = self._kind
            if self._finding.level is Level.ERROR:  # two lines of code: rclpy allows each one severity
                self._node.get_logger().error(self._finding.words)
            else:
                self._node.get_logger().warning(self._finding.words)
        return self._finding

    def _judge(self) -> tuple[str, SourceFinding]:
        """The kind of what is wrong, and the finding."""
        counts = self._pairing.counts
        samples, complete = counts.samples - self._samples, counts.samples - counts.incomplete - self._complete
        lacking = {name: counts.lacking[place] - self._lacking[place] for place, name in self._names.items()}
        self._samples, self._complete = counts.samples, counts.samples - counts.incomplete
        self._lacking = dict(counts.lacking)
        recent = {self._names[place]: stamps for place, stamps in self._pairing.arrivals.take().items()}
        silent = [name for name, stamps in recent.items() if not len(stamps)]
        if len(silent) == len(recent):
            return "silent", SourceFinding(Level.WARN, f"no samples: {absent(self._node, silent)}")
        if second := several(self._node, recent):
            is_mixed = any(mixed(stamps, self._period) for stamps in recent.values())
            return "several", SourceFinding(Level.ERROR, second, is_mixed)
        if silent:
            coming = listed([name for name in recent if name not in silent])
            why = f"{absent(self._node, silent)}; the {self._node.NAME} needs {listed(silent)} too"
            return f"without {silent}", SourceFinding(Level.ERROR, f"messages of {coming} come, but {why}")
        if 2 * complete < min(map(len, recent.values())) and (words := disagreement(recent)):
            return "stamps", SourceFinding(Level.ERROR, words)
        if samples > complete:
            most = max(lacking, key=lambda name: lacking[name])
            return "", SourceFinding(Level.WARN, f"{lacking[most]} of the last {samples} samples lack {most}")
        return "", SourceFinding(Level.OK, "")


def absent(node: PamNode, topics: Sequence[str]) -> str:
    """Why no message comes of some topics, in words. `topics`: relative names."""
    full = [node.resolve_topic_name(name) for name in topics]
    unpublished = [name for name in full if not node.count_publishers(name)]
    if unpublished:
        return f"nobody publishes {listed(unpublished)}"
    return f"no message of {listed(full)} comes, though there is a publisher"
