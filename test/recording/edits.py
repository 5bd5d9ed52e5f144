"""Edits that break files, and values that nobody expects in YAML."""

from __future__ import annotations

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

ABSURD = [0, 1, 0x7F, 0xFF, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**32, 2**62, 2**63 - 1, 2**63, 2**64 - 1]

VALUES = [
    "", "~", "[]", "{}", "yes", "1e308", "-1e308", "1e-320", "1e999", ".nan", "-.inf", "0x" + "f" * 5000, "9" * 400,
    "1:59:59", "2001-13-45", "2001-01-01", "'\\0'", '"\\0"', '"\\ud800"', "\x00", "\x1b[2J", "../../etc/passwd",
    "[../../../etc/passwd]", "/proc/self/mem", "!!python/name:os.system", "!!python/object/apply:os.system [id]",
    "&a [*a]", "*a", "[" * 900, "{a: " * 900, "{<<: 3}", "{<<: [1]}", "!!set {a}", "!!binary x", "!!float x",
    "!!int ''", "!!timestamp x", "=", "? a", "- - -", "- 1\n- 2", "|\n  x", ">-\n  " + "x" * 3000,
    "'" + "x" * 5000 + "'", "\ufeff", "\u2028", "{1: 2}",
]  # fmt: skip


def laughs(first: str, each: str, levels: int = 10) -> list[str]:
    """A billion laughs: entries of a mapping, each of ten aliases of the one before, 10 ** levels once written out."""
    aliases = (", ".join([f"*a{k}"] * 10) for k in range(levels))
    return [f"a0: &a0 {first}"] + [f"a{k}: &a{k} {each.format(text)}" for k, text in enumerate(aliases, 1)]


Edit = tuple[str, int, int]
EDIT = st.one_of(
    st.tuples(st.just("cut"), st.integers(0, 10**6), st.just(0)),
    st.tuples(st.just("byte"), st.integers(0, 10**6), st.integers(0, 255)),
    st.tuples(st.sampled_from(["u16", "u32", "u64"]), st.integers(0, 10**6), st.sampled_from(ABSURD)),
    st.tuples(st.sampled_from(["drop", "twice", "zeros"]), st.integers(0, 10**6), st.integers(1, 5000)),
)


def edited(data: bytes, edits: list[Edit], places: list[int]) -> bytes:
    """Data with edits; half of the places are those where something begins."""
    out = bytearray(data)
    for kind, where, what in edits:
        if not out:
            break
        at = places[where // 2 % len(places)] + where % 3 * 4 if where % 2 and places else where
        at %= len(out)
        if kind == "cut":
            del out[at:]
        elif kind == "byte":
            out[at] = what
        elif kind in ("u16", "u32", "u64"):
            width = int(kind[1:]) // 8
            out[at : at + width] = (what % 2 ** (8 * width)).to_bytes(width, "little")
        elif kind == "drop":
            del out[at : at + what]
        elif kind == "twice":
            out[at:at] = out[at : at + what]
        else:
            out[at : at + what] = bytes(len(out[at : at + what]))
    return bytes(out)


def examples(count: int) -> settings:
    ignored = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow, HealthCheck.data_too_large]
    return settings(max_examples=count, derandomize=True, suppress_health_check=ignored)
