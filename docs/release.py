"""Write a release of the two packages side by side: ``./run python docs/release.py --out DIR``.

bloom, which makes the Debian packages of ROS, does not look for a package inside a package, and reads ``CHANGELOG.rst``
beside each ``package.xml``. This repository has the messages inside and one ``CHANGELOG.md``. So a release goes into a
repository of its own: a folder a package, each with its changelog and the licence. Nothing is kept there by hand.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

from pam_antagonist.errors import BadInput
from pam_antagonist.paths import output_folder

ROOT = Path(__file__).resolve().parents[1]
OUTER, INNER = "pam_antagonist", "pam_antagonist_msgs"
MANIFESTS = {OUTER: ROOT / "package.xml", INNER: ROOT / INNER / "package.xml"}
RESERVED = re.compile(r"[@.](invalid|example|test|localhost|example\.(com|net|org))$")
"""Ends of addresses at which nobody can be (RFC 2606)."""


def changelog(package: str, text: str, forthcoming: bool = False) -> str:
    """The changelog of a package as bloom wants it (REP 132), of the text of ``CHANGELOG.md``.

    Args:
        package: its name.
        text: Markdown, a section a version, bullets in sections below.
        forthcoming: whether what is not released yet is in it.
    """
    title = f"Changelog for package {package}"
    out = ["^" * len(title), title, "^" * len(title), ""]
    for section in re.split(r"^## ", text, flags=re.MULTILINE)[1:]:
        head, _, body = section.partition("\n")
        name = re.fullmatch(r"\[([^]]+)\](?: - (\d{4}-\d{2}-\d{2}))?", head.strip())
        if name is None:
            raise BadInput(f"CHANGELOG.md: {head!r}: expected '[version] - date' or '[Unreleased]'")
        if name[1] == "Unreleased" and not forthcoming:
            continue
        heading = "Forthcoming" if name[1] == "Unreleased" else f"{name[1]} ({name[2]})"
        out += [heading, "-" * len(heading), *_bullets(body), ""]
    return "\n".join(out)


def _bullets(body: str) -> list[str]:
    """Bullets of a version, each on one line, with the section that it stands in."""
    out, kind, open_bullet = [], "", False
    for line in body.splitlines():
        if line.startswith("### "):
            kind, open_bullet = line[4:].strip(), False
        elif line.startswith("- "):
            out.append(f"* {kind}: {line[2:].strip()}" if kind else f"* {line[2:].strip()}")
            open_bullet = True
        elif line.startswith("  ") and open_bullet:
            out[-1] += f" {line.strip()}"
        else:
            open_bullet = False
    return [_restructured(line) for line in out]


def _restructured(line: str) -> str:
    """Markdown of one bullet as reStructuredText: code stays code, of a link its text."""
    parts = re.split(r"(`[^`]*`)", re.sub(r"\[([^]]+)\]\([^)]*\)", r"\1", line[2:]))
    for k, part in enumerate(parts):
        parts[k] = f"`{part}`" if k % 2 else re.sub(r"([*|\\]|_(?=\W|$))", r"\\\1", part)
    return "* " + "".join(parts)


def check() -> str:
    """What is wrong with the manifests for a release, in words; empty if nothing is."""
    roots = {name: ET.parse(path).getroot() for name, path in MANIFESTS.items()}
    versions = {root.findtext("version") for root in roots.values()}
    if len(versions) != 1:
        return f"the two package.xml have versions {' and '.join(sorted(map(str, versions)))}, expected one"
    (version,) = versions
    if f"## [{version}] - " not in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"):
        return f"CHANGELOG.md has no section of version {version} with a date"
    addresses = {str(item.attrib.get("email", "")) for root in roots.values() for item in root.iter("maintainer")}
    if len(addresses) != 1:
        return f"the two package.xml have maintainers {' and '.join(sorted(addresses))}, expected one"
    (address,) = addresses
    if "@" not in address or RESERVED.search(address):
        return f"maintainer {address}: expected an address where somebody reads mail, in both package.xml and setup.py"
    return ""


def write(folder: Path, forthcoming: bool = False) -> None:
    """Write both packages into a folder, side by side.

    Args:
        folder: an empty one.
        forthcoming: whether the changelogs have what is not released yet.
    """
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    for name in _tracked():
        inner = name.parts[0] == INNER
        target = folder / INNER / name.relative_to(INNER) if inner else folder / OUTER / name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, target)
    for package in MANIFESTS:
        (folder / package / "CHANGELOG.rst").write_text(changelog(package, text, forthcoming), encoding="utf-8")


def _tracked() -> list[Path]:
    done = subprocess.run(["git", "-C", str(ROOT), "ls-files", "-z"], capture_output=True, check=False)
    if done.returncode != 0:
        raise BadInput(f"{ROOT}: a release is made of what git tracks, and git says: {done.stderr.decode().strip()}")
    return [Path(name) for name in done.stdout.decode().split("\0") if name]


def main(argv: Sequence[str] | None = None) -> int:
    """Write a release, or say in one line why not."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder for the two packages; a new one")
    parser.add_argument(
        "--draft", action="store_true", help="write it whatever is wrong, with what is not released yet as Forthcoming"
    )
    given = parser.parse_args(argv)
    try:
        wrong = check()
        if wrong and not given.draft:
            raise BadInput(wrong)
        with output_folder(given.out) as folder:
            write(folder, given.draft)
    except BadInput as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"{given.out}: {OUTER} and {INNER}, side by side" + (f" (draft: {wrong})" if wrong else ""))
    return 0


if __name__ == "__main__":
    sys.exit(main())
