"""The documentation site: ``./run docs`` builds it strictly and serves it.

Pages are Markdown that the hosting platform shows as well: links to sources are relative paths, equations are in LaTeX,
and no page holds a list of other pages. The site gets its navigation from ``NAVIGATION`` and its API reference from the
docstrings. Its equations become MathML, so that no script from another host is needed.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "docs")]

NAVIGATION = {
    "Tutorials": ["tutorials/first_hour", "tutorials/your_own_rig"],
    "How-to: a rig and its recordings": [
        "how-to/your_rig",
        "how-to/recording",
        "how-to/import_csv",
        "how-to/check",
        "how-to/static",
    ],
    "How-to: find the model": ["how-to/identify", "how-to/close_loop", "how-to/regulators"],
    "How-to: connect and control": [
        "how-to/hardware",
        "how-to/driver",
        "how-to/references",
        "how-to/ros2_control",
        "how-to/several_joints",
    ],
    "How-to: watch and keep it safe": [
        "how-to/safety",
        "how-to/watch",
        "how-to/monitor",
        "how-to/security",
        "how-to/troubleshooting",
    ],
    "Reference": [
        "reference/commands",
        "reference/nodes",
        "reference/rig_file",
        "reference/report_json",
        "reference/api",
        "effects",
        "reference/protocol",
        "reference/glossary",
    ],
    "Explanation": [
        "explanation/model",
        "explanation/estimator",
        "explanation/control",
        "explanation/identification",
        "explanation/close_loop",
        "architecture",
    ],
    "Evidence": [
        "evidence/measured",
        "evidence/close_loop",
        "evidence/peers",
        "paper",
        "faults",
        "evidence/speed",
        "evidence/security",
    ],
}
"""Title of a part -> its pages."""

project = "pam_antagonist"
author = "pam_antagonist maintainers"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = [
    "generate.py",
    "layouts.py",
    "release.py",
    "demo_picture.py",
    "tutorial_pictures.py",
]
html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_title = "pam_antagonist"
html_math_renderer = "mathml"
html_show_sourcelink = False
myst_enable_extensions = ["dollarmath"]
myst_fence_as_directive = ["math"]
myst_heading_anchors = 4
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
napoleon_google_docstring = True
napoleon_numpy_docstring = False
nitpicky = False
suppress_warnings = ["misc.highlighting_failure"]

_SPACING = re.compile(r"\\\\\[[0-9.]+ex\]")


def _mathml(latex: str, display: str) -> str:
    from latex2mathml.converter import convert

    return str(convert(_SPACING.sub(r"\\\\", latex), display=display))


def _inline(writer: Any, node: Any) -> None:
    from docutils.nodes import SkipNode

    writer.body.append(_mathml(node.astext(), "inline"))
    raise SkipNode


def _block(writer: Any, node: Any) -> None:
    from docutils.nodes import SkipNode

    writer.body.append(_mathml(node.astext(), "block"))
    raise SkipNode


def _completed(app: Any, page: str, source: list[str]) -> None:
    """Put the table of all pages behind the first one, and into others what the code knows."""
    from generate import whole

    source[0] = whole(source[0])
    if page == "index":
        parts = [
            "```{toctree}\n:hidden:\n:caption: " + title + "\n\n" + "\n".join(pages) + "\n```"
            for title, pages in NAVIGATION.items()
        ]
        source[0] = "\n\n".join([source[0], *parts])


def _signature(app: Any, what: str, name: str, item: Any, options: Any, arguments: str, returns: str) -> Any:
    """No signature of a validated file's class: its fields stand on a page of their own."""
    return ("", None) if what == "class" and hasattr(item, "model_json_schema") else None


def setup(app: Any) -> None:
    """Register what is special here with Sphinx."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    app.connect("source-read", _completed)
    app.connect("autodoc-process-signature", _signature)
