"""A release: both packages side by side, each with a changelog that bloom reads."""

from __future__ import annotations

import runpy
import shutil
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pages
import pytest

import pam_antagonist

PACKAGES = {"pam_antagonist", "pam_antagonist_msgs"}
TEXT = """# Changelog

Words before.

## [Unreleased]

### Added

- Not yet.

## [0.2.0] - 2026-12-01

An introduction.

### Added

- Command `record_it` with `*`, see [the guide](a_guide.md#part),
  and *more* of x_ and |y|.

### Fixed

- A second one.

## [0.1.0] - 2026-11-21

- The first.
"""


@pytest.fixture(scope="module")
def release() -> dict[str, Any]:
    return runpy.run_path(str(pages.ROOT / "docs" / "release.py"))


def test_a_changelog_is_what_bloom_reads(release: dict[str, Any], tmp_path: Path) -> None:
    parsed = pytest.importorskip("catkin_pkg.changelog", reason="catkin_pkg comes with colcon")
    pytest.importorskip("docutils")
    text = release["changelog"]("pam_antagonist", TEXT)
    assert "Forthcoming" not in text and "Not yet" not in text
    log = parsed.populate_changelog_from_rst(parsed.Changelog("pam_antagonist"), text)
    assert {version for version, _, _ in log.foreach_version()} == {"0.2.0", "0.1.0"}
    first = [str(item) for item in log.get_content_of_version("0.2.0")]
    assert "record_it" in first[0] and "the guide" in first[0] and "a_guide" not in first[0]
    assert len(log.get_content_of_version("0.2.0")) in (1, 2) and "A second one." in " ".join(first)
    assert log.get_date_of_version("0.1.0").year == 2026
    draft = release["changelog"]("pam_antagonist", TEXT, True)
    assert "Forthcoming\n-----------\n* Added: Not yet.\n" in draft
    parsed.populate_changelog_from_rst(parsed.Changelog("pam_antagonist"), draft)


def test_the_changelog_of_this_repository_can_be_read(release: dict[str, Any]) -> None:
    parsed = pytest.importorskip("catkin_pkg.changelog", reason="catkin_pkg comes with colcon")
    docutils = pytest.importorskip("docutils.core")
    text = release["changelog"]("pam_antagonist", (pages.ROOT / "CHANGELOG.md").read_text(), True)
    docutils.publish_doctree(text, settings_overrides={"halt_level": 2, "report_level": 5})  # no warning in it
    log = parsed.populate_changelog_from_rst(parsed.Changelog("pam_antagonist"), text)
    assert pam_antagonist.__version__ in [version for version, _, _ in log.foreach_version()]


def test_both_packages_stand_side_by_side(release: dict[str, Any], tmp_path: Path) -> None:
    found = pytest.importorskip("catkin_pkg.packages", reason="catkin_pkg comes with colcon")
    if shutil.which("git") is None or subprocess.run(["git", "-C", str(pages.ROOT), "status"], check=False).returncode:
        pytest.skip("a release is made of what git tracks")
    out = tmp_path / "tree"
    assert release["main"](["--out", str(out), "--draft"]) == 0
    assert {path.name for path in out.iterdir()} == PACKAGES
    packages = found.find_packages(str(out))
    assert {package.name for package in packages.values()} == PACKAGES
    licence = (pages.ROOT / "LICENSE").read_bytes()
    for name in PACKAGES:
        assert (out / name / "LICENSE").read_bytes() == licence
        assert f"Changelog for package {name}" in (out / name / "CHANGELOG.rst").read_text()
    assert not (out / "pam_antagonist" / "pam_antagonist_msgs").exists()
    assert (out / "pam_antagonist_msgs" / "CMakeLists.txt").is_file()
    assert (out / "pam_antagonist" / "setup.py").is_file()


def test_manifests_name_one_maintainer_version_and_licence(release: dict[str, Any]) -> None:
    roots = [ET.parse(path).getroot() for path in release["MANIFESTS"].values()]
    for path in ("version", "maintainer", "license"):
        assert len({root.findtext(path) for root in roots}) == 1
    assert len({str(root.find("maintainer").attrib) for root in roots}) == 1  # type: ignore[union-attr]
    assert all(root.find("license").attrib == {"file": "LICENSE"} for root in roots)  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("address", "good"),
    [
        ("lab@uni-somewhere.edu", True), ("maintainers@pam-antagonist.invalid", False), ("me@example.org", False),
        ("me@host.example", False), ("me@localhost", False), ("nobody", False),
    ],
)  # fmt: skip
def test_a_release_needs_an_address_where_somebody_reads_mail(
    release: dict[str, Any], tmp_path: Path, address: str, good: bool
) -> None:
    check = release["check"]
    manifests = {}
    for name, path in release["MANIFESTS"].items():
        manifests[name] = tmp_path / f"{name}.xml"
        root = ET.parse(path).getroot()
        root.find("maintainer").attrib["email"] = address  # type: ignore[union-attr]
        manifests[name].write_text(ET.tostring(root, encoding="unicode"))
    before, check.__globals__["MANIFESTS"] = check.__globals__["MANIFESTS"], manifests
    try:
        wrong = check()
    finally:
        check.__globals__["MANIFESTS"] = before
    assert (wrong == "") is good
    assert good or wrong.startswith(f"maintainer {address}: expected an address")
