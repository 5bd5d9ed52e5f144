"""Documents as self-contained pages: one file that says the same in ten years, on a laptop without a network.

The templates hold all of the HTML. The style sheet, the script and, where there are figures, plotly's library are
written into the file, once. A content security policy keeps a browser from loading anything else.
"""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from pam_antagonist import strict_json
from pam_antagonist.errors import BadInput
from pam_antagonist.report.document import Block, Columns, Document, FigureBlock, Section

Figure = FigureBlock


def render(document: Document) -> str:
    """The whole page.

    Args:
        document: the report.

    Raises:
        BadInput: the document has figures and plotly is not installed.
    """
    library = _plotly() if any(_has_figure(block) for block in document.blocks) else ""
    sections = [block for block in document.blocks if isinstance(block, Section) and block.anchor]
    page = _environment().get_template("page.html.j2")
    return page.render(document=document, sections=sections, library=library, serial=itertools.count(1))


def write(folder: Path, document: Document, numbers: Any) -> None:
    """Write ``report.json`` and ``report.html`` into a folder that exists.

    Args:
        folder: where to.
        document: the page.
        numbers: what goes into ``report.json``, see :func:`pam_antagonist.strict_json.plain`.
    """
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
    environment.globals["next"] = next
    return environment


def _unbroken(text: str) -> str:
    """A number is not torn from its unit at the end of a line."""
    return text.replace(" %", "\u00a0%").replace(" N m", "\u00a0N\u00a0m")


def _json(value: Any) -> str:
    """JSON for a script element, which ``</script>`` inside a string would end."""
    return strict_json.dumps(value, indent=None).replace("<", "\\u003c")


def _has_figure(block: Block) -> bool:
    if isinstance(block, Section):
        return any(_has_figure(inner) for inner in block.blocks)
    if isinstance(block, Columns):
        return _has_figure(block.left) or _has_figure(block.right)
    return isinstance(block, FigureBlock)


def _plotly() -> str:
    """plotly's library as text, read from the installed package."""
    try:
        from plotly.offline import get_plotlyjs
    except ImportError:
        raise BadInput(
            "plotly is not installed: install python3-plotly (or plotly by pip), or give --no-figures"
        ) from None
    return str(get_plotlyjs()).replace("</script", "<\\/script")
