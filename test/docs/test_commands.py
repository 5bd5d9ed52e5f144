"""Every command and option that the documentation names exists, and the reference names all of them."""

from __future__ import annotations

import contextlib
import functools
import importlib
import io
import re
from pathlib import Path

import pages
import pytest

from pam_antagonist.__main__ import COMMANDS as PRODUCT
from pam_antagonist.__main__ import usage
from pam_antagonist.nodes import bridge, controller, estimator, plant
from pam_antagonist.recording.topics import TOPICS
from validation.__main__ import COMMANDS as MEASUREMENTS

COMMANDS = {**PRODUCT, **MEASUREMENTS}
DEVELOPMENT = {"test", "python", "colcon", "docs"}
NODES = {"plant": plant, "bridge": bridge, "estimator": estimator, "controller": controller}
FOREIGN = {"--ros-args", "--params-file", "--enclave"}
"""Options of ROS 2 that every node takes."""


@functools.cache
def options(command: str) -> frozenset[str]:
    """Options of a command, by its ``--help``."""
    module, function = COMMANDS[command].target.split(":")
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.suppress(SystemExit):
        getattr(importlib.import_module(module), function)(["--help"])
    return frozenset(re.findall(r"--[a-z][a-z-]*", out.getvalue())) | {"--help"}


@pytest.mark.parametrize("page", pages.PAGES, ids=pages.name)
def test_commands_and_their_options_exist(page: Path) -> None:
    for command, *arguments in pages.commands(pages.read(page)):
        assert command in COMMANDS or command in DEVELOPMENT, f"{pages.name(page)}: ./run {command}"
        if command in COMMANDS:
            named = {word.split("=")[0] for word in arguments if re.match(r"--[a-z]", word)}
            assert named <= options(command) | FOREIGN, f"{pages.name(page)}: ./run {command} {' '.join(arguments)}"


@pytest.mark.parametrize("page", pages.PAGES, ids=pages.name)
def test_options_in_the_text_exist(page: Path) -> None:
    every = frozenset().union(*(options(command) for command in COMMANDS), re.findall(r"--[a-z]+", usage())) | FOREIGN
    others = {"--no-daemon", "--spin-time", "--build", "--draft"}  # of ros2, ./run docs and docs/release.py
    for named in re.findall(r"`(--[a-z][a-z-]*)[^`]*`", pages.prose(page)):
        assert named in every | others, f"{pages.name(page)}: {named}"


def test_the_reference_has_every_command_with_every_option() -> None:
    sections = re.split(r"^## (\w+)\n", pages.read(pages.ROOT / "docs/reference/commands.md"), flags=re.MULTILINE)[1:]
    found = dict(zip(sections[::2], sections[1::2], strict=True))
    assert list(found) == list(COMMANDS), "run ./run python docs/generate.py"
    for command, section in found.items():
        named = frozenset(re.findall(r"--[a-z][a-z-]*", section))
        assert options(command) - {"--help"} <= named, f"{command}: run ./run python docs/generate.py"
        assert named <= options(command) | FOREIGN, f"{command}: run ./run python docs/generate.py"


def test_the_reference_has_every_topic_and_every_parameter() -> None:
    text = pages.read(pages.ROOT / "docs/reference/nodes.md")
    assert all(f"| `{topic.relative}` | `{topic.type}` |" in text for topic in TOPICS.values())
    for node, module in NODES.items():
        parts = [part for part in text.split("\n### ") if node in part.split("\n")[0].split(", ")]
        for entry in module.PARAMETERS:
            assert any(f"* `{entry.name}` (`{entry.default}`; " in part for part in parts), (
                f"{node}: {entry.name}: run ./run python docs/generate.py"
            )
