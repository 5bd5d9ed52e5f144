"""Files that are no rigs, by accident or on purpose: refused at once, without running or filling anything.

At once is within 20 s: the bombs would take hours or all memory, the others take milliseconds.
"""

from __future__ import annotations

import time

import pytest
from edits import VALUES, laughs

CONTENTS = {
    "empty": ("", "expected a mapping"),
    "only a comment": ("# nothing\n", "expected a mapping"),
    "list": ("- geometry\n- gas\n", "expected a mapping"),
    "number": ("5\n", "expected a mapping"),
    "keys that are numbers": ("1: 2\n", "expected a mapping"),
    "keys that are lists": ("? [a, b]\n: 1\n", "not valid YAML"),
    "not YAML": ("a: b: c\n", "not valid YAML"),
    "tabs": ("a:\n\tb: 1\n", "not valid YAML"),
    "unclosed": ("a: [1, 2\n", "not valid YAML"),
    "two documents": ("a: 1\n---\nb: 2\n", "not valid YAML"),
    "unknown anchor": ("a: *b\n", "not valid YAML"),
    "list that holds itself": ("a: &a [*a]\n", "not valid YAML"),
    "mapping that holds itself": ("geometry: &a\n  radius: *a\n", "not valid YAML"),
    "number of 10,000 digits": ("name: " + "9" * 10_000, ""),
    "deep list": ("a: " + "[" * 10_000, "not valid YAML"),
    "deep closed list": ("a: " + "[" * 10_000 + "]" * 10_000, "not valid YAML"),
    "deep mapping": ("a: " + "{a: " * 5_000, "not valid YAML"),
    "deep block mapping": ("".join(" " * k + "a:\n" for k in range(420)), "not valid YAML"),
    "billion laughs": ("\n".join(laughs("[ha, ha]", "[{}]")), "stand for more than 100000 values"),
    "billion laughs by merging": ("\n".join(laughs("{x: 1}", "{{<<: [{}]}}")), "stand for more than 100000 values"),
    "hexadecimal number of 50,000 digits": (f"geometry: {{radius: 0x{'f' * 50_000}}}\n", ""),
    "number of 20,000 digits": (f"name: {'1' * 20_000}\n", "too large"),
    "a file of 2 MB": ("#" * 2_000_000, "bytes"),
}


@pytest.mark.parametrize(("content", "word"), CONTENTS.values(), ids=CONTENTS.keys())
def test_no_rig(tmp_path, refusal, content, word):
    path = tmp_path / "bad.yaml"
    path.write_text(content)
    began = time.process_time()
    message = refusal(path)
    assert word in message
    assert time.process_time() - began < 20.0


TOUCH = "!!python/object/apply:"
NONE = [
    *VALUES, f"{TOUCH}pathlib.Path.touch [touched]", f"{TOUCH}os.system ['touch touched']", "!!binary é", "!!null x",
    "!!python/object/new:os.PathLike []", "!!bool x", "!!set 3", "0x" + "f" * 9_000, "0b" + "1" * 990,
    ":".join(["59"] * 9_000), *(f"{{{', '.join(laughs('[ha, ha]', '[{}]', levels))}}}" for levels in (10, 4)),
]  # fmt: skip
SAID = ("geometry", "too large", "not valid YAML", "stand for more than 100000 values")


@pytest.mark.parametrize("value", NONE, ids=lambda value: ascii(value)[:40])
def test_values_that_are_none(edited, refusal, tmp_path, monkeypatch, value):
    """The message shows what was found, shortened; nothing is written out or run."""
    monkeypatch.chdir(tmp_path)
    began = time.process_time()
    message = refusal(edited(("radius: 0.0365", f"radius: {value}")))
    assert any(word in message for word in SAID), message
    assert time.process_time() - began < 20.0
    assert [path.name for path in tmp_path.iterdir()] == ["rig.yaml"]


def test_binary_file(tmp_path, refusal):
    path = tmp_path / "bag.yaml"
    path.write_bytes(b"\x89MCAP0\r\n\xff\xfe" * 20)
    assert "cannot be read" in refusal(path)
