"""How processor time and memory grow with the data: picture and tables of docs/performance.md.

``./run benchmark --only growth --json FILE``, then ``./run python docs/growth_picture.py FILE``.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.ticker import FormatStrFormatter, NullFormatter

COMMANDS = {"replay": "#0072b2", "identify": "#d55e00", "close_loop": "#009e73"}
SIZES = {"minutes": "length of each recording [min]", "recordings": "recordings of a minute"}


def series(figures: dict[str, dict[str, dict[str, float]]], name: str, what: str) -> tuple[np.ndarray, np.ndarray]:
    """Sizes, and processor time [s] (``cpu_s``) or most memory [MB] (``peak_mb``) at each."""
    known = figures.get(name, {}).get("parts", {})
    pairs = sorted((int(key.removeprefix(f"{what}_")), value) for key, value in known.items() if key.startswith(what))
    sizes, values = zip(*pairs, strict=True) if pairs else ((), ())
    return np.array(sizes), np.array(values)


def main() -> None:
    """Draw the picture and print the tables."""
    figures = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))["figures"]
    drawn, axes = plt.subplots(2, 2, figsize=(8.0, 6.0), dpi=110, layout="constrained", sharey="row")
    for (of, label), (time, memory) in zip(SIZES.items(), axes.T, strict=True):
        head = None
        for command, color in COMMANDS.items():
            sizes, seconds = series(figures, f"{command}_by_{of}", "cpu_s")
            _, megabytes = series(figures, f"{command}_memory_by_{of}", "peak_mb")
            if not len(sizes):
                continue
            if head is None:
                head = sizes
                print(
                    f"\n| {of} | {' | '.join(map(str, sizes))} | exponent | most memory |\n|{'---|' * (len(sizes) + 3)}"
                )
            exponent, most = figures[f"{command}_by_{of}"]["value"], megabytes.max() / 1e3
            spent = " | ".join(f"{value:.1f} s" for value in seconds)
            print(f"| `{command}` | {spent} | {exponent:.2f} | {most:.2f} GB |")
            time.loglog(sizes, seconds, "o-", color=color, label=command)
            memory.loglog(sizes, megabytes / 1e3, "o-", color=color, label=command)
        if head is not None:
            # In proportion to the data.
            time.loglog(head, 10.0 * head / head[0], ":", color="0.6", label="in proportion to the data")
            memory.axhline(4.0, color="0.6", linestyle="--")
            for one in (time, memory):
                one.set_xticks(head, [str(size) for size in head])
                one.xaxis.set_minor_formatter(NullFormatter())
        memory.set_xlabel(label)
    axes[0, 0].set_ylabel("processor time [s]")
    axes[1, 0].set_ylabel("most memory [GB]")
    axes[0, 0].legend(frameon=False)
    for one in axes.flat:
        one.grid(visible=True, which="major", alpha=0.3)
        one.yaxis.set_major_formatter(FormatStrFormatter("%g"))
        one.yaxis.set_minor_formatter(NullFormatter())
    for one in axes[1]:
        one.set_ylim(0.2, 5.0)
        one.set_yticks([0.2, 0.5, 1.0, 2.0, 4.0])
    drawn.savefig(Path(__file__).with_name("growth.png"))


if __name__ == "__main__":
    main()
