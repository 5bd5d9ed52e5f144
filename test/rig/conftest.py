"""Rig files with one thing changed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.paths import config_dir
from pam_antagonist.rig import load_rig


@pytest.fixture(scope="session")
def text() -> str:
    """The file of shin2022."""
    return (config_dir() / "rigs" / "shin2022.yaml").read_text(encoding="utf-8")


@pytest.fixture
def edited(text, tmp_path) -> Callable[..., Path]:
    """A copy of shin2022 with replacements made, each of which must apply exactly once."""

    def make(*replacements: tuple[str, str], before: str = "", after: str = "") -> Path:
        content = text
        for old, new in replacements:
            assert content.count(old) == 1, f"{old!r} stands {content.count(old)} times in shin2022.yaml"
            content = content.replace(old, new)
        path = tmp_path / "rig.yaml"
        path.write_text(before + content + after, encoding="utf-8")
        return path

    return make


@pytest.fixture
def refusal() -> Callable[..., str]:
    """The message with which a file is refused; it is one line, of readable length, and names the file."""

    def load(path: Path, longest: int = 400) -> str:
        with pytest.raises(BadInput) as error:
            load_rig(path)
        message = str(error.value)
        assert "\n" not in message
        assert message.startswith(f"{path}: ")
        message = message[len(f"{path}: ") :]
        assert 0 < len(message) < longest
        return message

    return load
