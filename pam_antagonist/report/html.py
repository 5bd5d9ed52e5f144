"""Documents as self-contained HTML pages, which need no network and stay readable in ten years.

The templates contain all HTML. The style sheet, the script and, for figures, plotly's library are written into the
file. A content security policy keeps a browser from loading anything else.
"""

from __future__ import annotations

import itertools
import re
from html import escape
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from jinja2.filters import do_mark_safe

from pam_antagonist import strict_json
from pam_antagonist.report import plotly_renderer
from pam_antagonist.report.document import Document, Section, figures_of, with_unit
from pam_antagonist.report.figure import DARK

_OPTION = re.compile(r"(?<!\S)--[a-z][a-z-]*")
_CHECKSUM = re.compile(r"\b[0-9a-f]{64}\b")


def render(document: Document) -> str:
    """The whole page."""
    library = plotly_renderer.library() if any(figures_of(document.blocks)) else ""
    sections = [block for block in document.blocks if isinstance(block, Section) and block.anchor]
    page = _environment().get_template("page.html.j2")
    return page.render(document=document, sections=sections, library=library, dark=DARK, serial=itertools.count(1))


def write(folder: Path, document: Document, numbers: Any) -> None:
    """Write ``report.json``, with these numbers, and ``report.html`` into an existing folder."""
    strict_json.write_json(folder / "report.json", numbers)
    (folder / "report.html").write_text(render(document), encoding="utf-8")


def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("pam_antagonist.report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=StrictUndefined,
    )
    environment.filters["unbroken"] = _unbroken
    environment.filters["kind"] = lambda block: type(block).__name__
    environment.filters["json"] = _json
    environment.filters["packed"] = plotly_renderer.packed
    environment.filters["plotly"] = plotly_renderer.text
    environment.globals["next"] = next
    return environment


def _unbroken(text: str) -> str:
    """Forbid line breaks between a number and its unit, in units and options; allow them in checksums."""
    shown = _CHECKSUM.sub(lambda found: "<wbr>".join(re.findall(".{8}", found[0])), escape(with_unit(text)))
    return do_mark_safe(_OPTION.sub(r'<span class="option">\g<0></span>', shown))


def _json(value: Any) -> str:
    """JSON for a script element, with ``<`` escaped because ``</script>`` in a string would end the element."""
    return strict_json.dumps(value, indent=None).replace("<", "\\u003c")
