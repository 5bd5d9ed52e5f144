"""The report as Markdown with pictures: a file, and beside it a folder of the same name that holds its figures."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

from pam_antagonist.errors import BadInput
from validation.paper import page
from validation.paper.result import Result
from validation.paper.scenario import Scenario
from validation.pictures import made_here, picture


def folder_of(path: Path) -> Path:
    """Where the pictures of a Markdown file are."""
    return path.with_suffix("")


def check(path: Path, experiments: Sequence[str]) -> None:
    """Refuse to write over what this command has not written, before minutes are spent.

    Args:
        path: of the Markdown file.
        experiments: names of those that will have pictures.

    Raises:
        BadInput: such a file, a folder that is not there, or a path that leaves no name for the pictures' folder.
    """
    if not path.parent.is_dir():
        raise BadInput(f"{path}: the folder {path.parent} does not exist")
    if not path.suffix:
        raise BadInput(
            f"{path}: expected a name that ends in .md; the figures go into a folder of that name without it"
        )
    if path.exists():
        if not path.is_file() or not path.read_text(encoding="utf-8", errors="replace").startswith(page.MARK):
            raise BadInput(f"{path}: exists and was not written by this command; nothing is overwritten")
    folder = folder_of(path)
    if folder.exists() and not folder.is_dir():
        raise BadInput(f"{folder}: exists and is no folder; the figures of {path} would go there")
    own = set(_own(folder))
    for other in sorted(folder.glob("*.png")):
        if other.name.startswith(tuple(experiments)) and other not in own:
            raise BadInput(f"{other}: exists and was not written by this command; nothing is overwritten")


def write(path: Path, results: Sequence[Result], scenario: Scenario, seeds: Sequence[int]) -> None:
    """Write the Markdown file and its pictures; those of an earlier run that it no longer shows are deleted.

    Args:
        path: of the Markdown file; its folder is there.
        results: of the experiments.
        scenario: what the virtual rigs are.
        seeds: of the virtual rigs.

    Raises:
        BadInput: a figure that cannot be drawn; then nothing is written.
    """
    folder = folder_of(path)
    names = {result.name: file_names(result) for result in results}
    drawn = {
        name: picture(figure)
        for result in results
        for name, figure in zip(names[result.name], result.figures, strict=True)
    }
    for old in _own(folder):
        old.unlink()
    if drawn:
        folder.mkdir(exist_ok=True)
        for name, content in drawn.items():
            (folder / name).write_bytes(content)
    elif folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()
    places = {name: [f"{quote(folder.name)}/{file}" for file in files] for name, files in names.items()}
    path.write_text(page.markdown(results, scenario, seeds, places), encoding="utf-8")


def file_names(result: Result) -> list[str]:
    """Names of an experiment's pictures: the experiment and what the figure is of, the same in every run."""
    stems = []
    for figure in result.figures:
        ascii_ = unicodedata.normalize("NFKD", figure.link).encode("ascii", "ignore").decode().lower()
        words = [word for word in re.findall(r"[a-z0-9]+", ascii_) if word != result.name]
        stems.append("_".join([result.name, *words]))
    out = []
    for k, stem in enumerate(stems):
        out.append(f"{stem}_{stems[: k + 1].count(stem)}.png" if stems.count(stem) > 1 else f"{stem}.png")
    return out


def _own(folder: Path) -> list[Path]:
    """Pictures in a folder that this package has made."""
    files = sorted(folder.glob("*.png")) if folder.is_dir() else []
    return [file for file in files if file.is_file() and made_here(file.read_bytes())]
