"""Find the package's topics in a bag, and its joint in a topic: namespaces, names, missing topics, wrong types."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from ..shown import few
from .cdr import Decoded, stores_of
from .notes import Issue
from .raw import RawBag, RawTopic
from .topics import COMMAND_TOPICS, DEFAULT_NAMESPACE, SAMPLE_TOPICS, STATE_TOPICS, TOPICS, Topic, find_topic

Floats = NDArray[np.float64]

READ_TOPICS = tuple(name for name in TOPICS if name not in ("diagnostics", "rig", "external_torque"))
"""Logical names of the topics that a recording is made from."""


class SeveralJoints(BadInput):
    """A bag holds several joints, and the caller did not choose one.

    Args:
        message: error message for the user.
        namespaces: of the joints.
    """

    def __init__(self, message: str, namespaces: list[str]) -> None:
        super().__init__(message)
        self.namespaces = namespaces


def choose_topics(bag: RawBag, topics: Mapping[str, str] | None, namespace: str | None) -> dict[str, RawTopic]:
    """Find the package's topics in a bag.

    `topics`: Logical (or relative) name -> topic in the bag, for topics that have another name there. `namespace`: of
    all other topics; None to find it in the bag. Returns logical name -> messages; all sample topics are there and not
    empty.
    """
    if not any(len(raw) for raw in bag.topics.values()):
        raise BadInput(f"{bag.path}: no samples, the bag holds no messages ({_list(bag)})")
    renamed = _renamed(topics or {})
    if namespace is None:
        namespace = _find_namespace(bag, renamed)
    chosen = {}
    regulated = drive_of(bag, namespace, renamed) == "regulator"
    needed_topics = (STATE_TOPICS["regulator"],) if regulated else SAMPLE_TOPICS
    whole = TOPICS["joint_sample"]
    if "joint_sample" in renamed or _problem(bag, whole, whole.resolve(namespace)) is None:
        needed_topics = ("joint_sample",)
    for name in READ_TOPICS:
        topic = TOPICS[name]
        actual = renamed.get(name, topic.resolve(namespace))
        needed = name in needed_topics or name in renamed
        problem = _problem(bag, topic, actual)
        if problem is None:
            chosen[name] = bag.topics[actual]
        elif needed:
            raise BadInput(f"{bag.path}: {problem}{_hint(bag, topic, actual, namespace)}")
        elif actual in bag.topics and len(bag.topics[actual]):
            bag.issues.append(Issue(f"{problem}: left out", "missing"))
    return chosen


def _renamed(topics: Mapping[str, str]) -> dict[str, str]:
    renamed = {}
    for name, actual in topics.items():
        topic = find_topic(name)
        if topic is None or topic.name not in READ_TOPICS:
            if name.endswith(":") and name[:-1] in READ_TOPICS:
                raise BadInput(f"topic name {name!r}: expected --topic {name[:-1]}=/NAME, without a colon")
            raise BadInput(f"topic name {name!r} is unknown, expected one of {', '.join(READ_TOPICS)}")
        renamed[topic.name] = actual if actual.startswith("/") else f"/{actual}"
    return renamed


def _find_namespace(bag: RawBag, renamed: Mapping[str, str]) -> str:
    """The only namespace, or the one with most topics, whose names and types are the package's."""
    for names in ((*SAMPLE_TOPICS, STATE_TOPICS["regulator"], "joint_sample"), READ_TOPICS):
        open_names = [name for name in names if name not in renamed]
        found: dict[str, int] = {}
        for actual, raw in bag.topics.items():
            for name in open_names:
                ending = f"/{TOPICS[name].relative}"
                if actual.endswith(ending) and raw.msgtype == TOPICS[name].type:
                    prefix = actual[: -len(ending)]
                    found[prefix] = found.get(prefix, 0) + 1
        if names is READ_TOPICS:
            # "/pam/measured/joint_states" is not the topic joint_states of a namespace "/pam/measured".
            found = {prefix: count for prefix, count in found.items() if not prefix.endswith("/measured")}
        best = [prefix for prefix, count in found.items() if count == max(found.values())]
        if len(best) > 1:
            listed = ", ".join(sorted(prefix or "/" for prefix in best))
            raise SeveralJoints(
                f"{bag.path}: several namespaces hold such topics ({listed}), choose one with --namespace", sorted(best)
            )
        if best:
            return best[0]
    return DEFAULT_NAMESPACE


def joints_in(bag: RawBag) -> list[str]:
    """The namespaces with messages of every sample topic; each is a joint."""

    def there(namespace: str, *names: str) -> bool:
        every = [(TOPICS[name].type, bag.topics.get(TOPICS[name].resolve(namespace))) for name in names]
        return all(raw is not None and raw.msgtype == kind and len(raw) > 0 for kind, raw in every)

    endings = [f"/{TOPICS[name].relative}" for name in (*STATE_TOPICS.values(), "joint_sample")]
    found = {actual[: -len(end)] for actual in bag.topics for end in endings if actual.endswith(end)}
    kinds = ((STATE_TOPICS["regulator"],), SAMPLE_TOPICS, ("joint_sample",))
    return sorted(one for one in found if any(there(one, *names) for names in kinds))


def drive_of(bag: RawBag, namespace: str, renamed: Mapping[str, str]) -> str:
    """Drive of a joint: ``regulator`` where pressure commands but no voltages were recorded, else ``valve``."""

    def there(name: str) -> bool:
        raw = bag.topics.get(renamed.get(name, TOPICS[name].resolve(namespace)))
        return raw is not None and len(raw) > 0

    return "regulator" if there(STATE_TOPICS["regulator"]) and not there(STATE_TOPICS["valve"]) else "valve"


def _problem(bag: RawBag, topic: Topic, actual: str) -> str | None:
    """What is wrong with a topic, or None."""
    raw = bag.topics.get(actual)
    if raw is None:
        return f"topic {actual} is missing"
    if actual in bag.conflicts:
        return f"topic {actual} was recorded with several types ({', '.join(bag.conflicts[actual])})"
    if len(raw) == 0:
        return f"topic {actual} has no samples"
    if raw.msgtype != topic.type:
        return f"topic {actual} is a {raw.msgtype or 'message without a type'}, expected {topic.type}"
    if raw.encoding != "cdr":
        return f"topic {actual} is encoded as {raw.encoding!r}, expected cdr"
    if not stores_of(raw.msgtype, raw.digest, raw.definition):
        return f"topic {actual} was recorded with another definition of {topic.type} than this package has"
    return None


def _hint(bag: RawBag, topic: Topic, actual: str, namespace: str) -> str:
    """What to do about a missing topic."""
    if actual in bag.topics:
        return ""
    for drive, got in (("regulator", "what the regulators got"), ("valve", "what was on the valves")):
        command = TOPICS[COMMAND_TOPICS[drive]].resolve(namespace)
        if topic.name == "valve_state" and command in bag.topics:
            return (
                f"; {command} is there, but says what was asked for, not {got}: if that is the same on this rig, "
                f"use --topic {STATE_TOPICS[drive]}={command}"
            )
    return f"; {_list(bag)}; if one of them is it, use --topic {topic.name}=/NAME"


def _list(bag: RawBag) -> str:
    if not bag.topics:
        return "no topics are in it"
    names = [f"{name} ({raw.msgtype})" for name, raw in sorted(bag.topics.items())]
    return f"the topics in it are {few(names)}"


def values_of_joint(
    bag: RawBag, topic: str, decoded: Decoded, joint: str | None, live: Decoded | None
) -> tuple[dict[str, Floats], NDArray[np.bool_]]:
    """Position [rad] and effort [N m] of one joint in all messages of a JointState, NaN where one has none.

    `live`: Messages of the estimator's ``joint_states``, or None. Also returns which messages name the joint.
    """
    names = _joint_names(decoded)
    listed = ", ".join(names) or "no names"
    if joint is not None and joint not in names:
        raise BadInput(f"{bag.path}: {topic} has no joint {joint!r}; it has {listed}")
    if joint is None and len(names) > 1:
        estimated = [] if live is None else _joint_names(live)
        if len(estimated) != 1 or estimated[0] not in names:
            raise BadInput(
                f"{bag.path}: {topic} holds {len(names)} joints ({listed}), expected to know which one it is; type "
                f"--joint-name with one of these names, such as --joint-name {names[0]}"
            )
        joint = estimated[0]
        text = f"{topic} holds {len(names)} joints ({listed}): took {joint}, the joint of the estimator"
        bag.issues.append(Issue(text, size=len(names)))
    result = {"position": np.full(decoded.size, np.nan), "effort": np.full(decoded.size, np.nan)}
    there = np.zeros(decoded.size, bool)
    for group in decoded.groups:
        unnamed = group.counts["name"] == 0
        if unnamed and (many := max(group.counts[field] for field in result)) > 1:
            raise BadInput(f"{bag.path}: {topic} holds {many} joints without names, expected a name for each")
        for index in range(max(1, group.counts["name"])):
            its = np.ones(len(group.rows), bool)
            if not unnamed:
                its = group.columns[f"name[{index}]"] == (joint or names[0]).encode()
            if np.any(there[group.rows[its]]):
                raise BadInput(f"{bag.path}: {topic} names {joint or names[0]} twice in one message, expected once")
            there[group.rows[its]] = True
            for field, values in result.items():
                if index < group.counts[field]:
                    values[group.rows[its]] = group.columns[field][its, index]
    return result, there


def _joint_names(decoded: Decoded) -> list[str]:
    """Joint names, sorted."""
    found = {
        name
        for group in decoded.groups
        for index in range(group.counts["name"])
        for name in np.unique(group.columns[f"name[{index}]"]).tolist()
    }
    return sorted(name.decode(errors="replace") for name in found)
