"""Help and hints show the words that work where they are printed; ``pam`` completes in a shell."""

from __future__ import annotations

import shutil
import subprocess
import sys

import pytest

from pam_antagonist import __version__
from pam_antagonist.__main__ import COMMANDS, main
from pam_antagonist.program import VARIABLE, program, typed


@pytest.mark.parametrize(
    ("given", "started", "expected"),
    [
        ("./run", "/clone/pam_antagonist/__main__.py", "./run"),
        ("", "/usr/local/bin/pam", "pam"),
        ("", "/ws/install/pam_antagonist/lib/pam_antagonist/replay", "ros2 run pam_antagonist"),
        ("", "/clone/pam_antagonist/__main__.py", "python -m pam_antagonist"),
        ("", "my_script.py", "pam"),
        ("", "", "pam"),
    ],
)
def test_a_command_is_shown_as_it_is_typed(monkeypatch, given, started, expected):
    monkeypatch.setenv(VARIABLE, given)
    monkeypatch.setattr(sys, "argv", [started])
    assert program() == expected
    assert typed("check --help") == f"{expected} check --help"


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_help_shows_it_and_holds_no_other_form(name, monkeypatch, capsys):
    monkeypatch.setenv(VARIABLE, "here/run")
    assert main([name, "--help"]) == 0
    said = capsys.readouterr().out
    assert said.startswith(f"usage: here/run {name} ")
    assert "{run}" not in said
    examples = said.partition("\nexamples:\n")[2].partition("\n\n")[0]
    for line in examples.splitlines():
        assert line.startswith("  here/run ") or not line.startswith("  "), line


def test_refused_arguments_name_the_help(monkeypatch, capsys):
    monkeypatch.setenv(VARIABLE, "ros2 run pam_antagonist")
    assert main(["replay", "bag"]) == 2
    assert capsys.readouterr().err.endswith("(see ros2 run pam_antagonist replay --help)\n")


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"pam_antagonist {__version__}\n"


def test_bash_completes_names_options_choices_and_files(tmp_path, capsys):
    bash = shutil.which("bash")
    pytest.importorskip("shtab", reason="the extra [completion] is not installed")
    assert bash is not None and main(["--completion", "bash"]) == 0
    (tmp_path / "completion.bash").write_text(capsys.readouterr().out, encoding="utf-8")
    (tmp_path / "my_bag").mkdir()

    def completed(*words: str) -> list[str]:
        listed = " ".join(f"'{word}'" for word in ("pam", *words))
        code = f"source ./completion.bash; COMP_WORDS=({listed}); COMP_CWORD={len(words)}; _shtab_pam; " + (
            'echo "${COMPREPLY[@]}"'
        )
        return subprocess.run(
            [bash, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True
        ).stdout.split()

    assert completed("re") == ["replay", "reachable", "record"]
    assert completed("replay", "--tun") == ["--tuning"]
    assert completed("identify", "bag", "--joint", "") == ["auto", "free", "locked"]
    assert completed("replay", "my_") == ["my_bag"]
    assert completed("plant", "--ros") == ["--ros-args"]


def test_an_unknown_shell_is_refused_in_one_line(capsys):
    assert main(["--completion", "dos"]) == 2
    said = capsys.readouterr().err
    assert "expected one of bash, zsh" in said and said.count("\n") == 1
