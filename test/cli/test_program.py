"""Executables: one table, help and hints in the words that are typed, what starting one loads, and what is missing."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import pam_antagonist.__main__
from pam_antagonist import __version__
from pam_antagonist.__main__ import COMMANDS, main
from pam_antagonist.errors import BadInput
from pam_antagonist.hardware.serial_device import SerialTransport
from pam_antagonist.program import VARIABLE, program, started, typed
from validation.__main__ import COMMANDS as MEASUREMENTS

ROOT = Path(__file__).resolve().parents[2]


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


@pytest.mark.parametrize("name", sorted({**COMMANDS, **MEASUREMENTS}))
def test_help_shows_it_and_holds_no_other_form(name, monkeypatch, capsys):
    monkeypatch.setenv(VARIABLE, "here/run")
    assert main([name, "--help"], {**COMMANDS, **MEASUREMENTS}) == 0
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


def test_help_lists_every_executable_in_one_line(capsys):
    assert main([]) == 2 and "usage" in capsys.readouterr().out
    assert main(["--help"]) == 0
    lines = capsys.readouterr().out.splitlines()
    for name, command in COMMANDS.items():
        assert [line for line in lines if line.split() == [name, *command.summary.split()]], name


def test_an_unknown_name_lists_the_names(capsys):
    assert main(["repaly"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert all(name in error for name in COMMANDS)
    assert "did you mean replay?" in error


@pytest.mark.parametrize("words", ["--help", "reachable --help", "plant --help", "reachable --rig shin2022"])
def test_a_reader_of_the_output_may_go(words):
    """As ``pam --help | head``: the pipe is closed before anything is written."""
    command, pipe = [sys.executable, "-m", "pam_antagonist", *words.split()], subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.close()
        said = process.stderr.read()
    assert (process.returncode, said) == (0, "")


def test_the_table_needs_the_standard_library_only(python):
    # setup.py reads it where nothing is installed yet.
    code = f"import runpy; print(len(runpy.run_path({pam_antagonist.__main__.__file__!r})['COMMANDS']))"
    done = python("-I", "-S", "-c", code)
    assert done.stdout.strip() == str(len(COMMANDS)), done.stderr


@pytest.mark.parametrize(
    ("name", "arguments", "further"),
    [
        ("replay", "{bag} --no-figures", ["plotly", "matplotlib", "scipy.stats", "scipy.signal", "pandas"]),
        ("simulate", "--duration 1", []),
    ],
)
def test_offline_commands_load_no_ros_and_what_is_slow_only_where_it_is_needed(
    name, arguments, further, python, bag, tmp_path
):
    words = [name, *arguments.format(bag=bag).split(), "--rig", "shin2022", "--out", str(tmp_path / "out")]
    code = f"""
import sys
from pam_antagonist.__main__ import main
status = main({words!r})
ros = ["rclpy", "rcl_interfaces", "pam_antagonist_msgs", "sensor_msgs", "std_msgs"]
found = {{*ros, *{further!r}}} & set(sys.modules)
sys.exit(status or (f"loaded {{found}}" if found else 0))
"""
    done = python("-c", code)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out").is_dir()


def test_they_start_from_a_checkout():
    done = subprocess.run([sys.executable, "-m", "validation"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert all(name in done.stdout for name in MEASUREMENTS)


@pytest.mark.parametrize(
    "arguments",
    [["demo"], ["plant"], ["record", "--out", "bag"], ["faults"], ["benchmark", "--only", "pipeline"]],
    ids=lambda words: words[0],
)
@pytest.mark.parametrize("absent", ["rclpy", "pam_antagonist_msgs"])
def test_without_ros_what_needs_it_says_so(arguments, absent, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, absent, None)
    assert main(arguments, {**COMMANDS, **MEASUREMENTS}) == 2
    said = capsys.readouterr().err
    assert f"needs ROS 2 ({absent} is not installed)" in said and said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_without_plotly_a_report_has_no_figures(bag, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "plotly", None)
    assert main(["replay", str(bag), "--rig", "shin2022", "--out", str(tmp_path / "out")]) == 0
    (said,) = [line for line in capsys.readouterr().err.splitlines() if "plotly" in line]
    assert "pip install 'pam_antagonist[reports]'" in said
    assert "figures.js" not in (page := (tmp_path / "out" / "report.html").read_text(encoding="utf-8"))
    assert "<table" in page


def test_without_pyserial_a_port_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "serial", None)
    with pytest.raises(BadInput, match=r"/dev/ttyACM0: serial is not installed.*'pam_antagonist\[hardware\]'"):
        SerialTransport("/dev/ttyACM0")


def test_without_shtab_completion_says_what_to_install(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "shtab", None)
    assert main(["--completion", "bash"]) == 2
    assert "'pam_antagonist[completion]'" in capsys.readouterr().err


SCRIPTS = ("signal", "queue", "numpy", "yaml", "pam_antagonist")


@pytest.fixture
def stranger(tmp_path: Path) -> Path:
    """A folder of recordings with scripts that must not be run."""
    for name in SCRIPTS:
        text = 'import sys\nsys.stderr.write("a script beside the recordings was run\\n")\n'
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
    return tmp_path


@pytest.mark.slow(5)
def test_scripts_beside_the_recordings_are_not_imported(stranger: Path) -> None:
    """Nor from what PYTHONPATH names for another Python, nor by processes that a command starts."""
    words = started("pam_antagonist", "reachable", "--rig", "shin2022")
    for given in ("", f"{os.pathsep}{os.pathsep}{stranger}"):
        path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]) + given
        environment = {**os.environ, "PYTHONPATH": path}
        done = subprocess.run(words, cwd=stranger, env=environment, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
@pytest.mark.parametrize(
    "words", ["reachable --rig shin2022", "new_rig --help", "replay {bag} --rig shin2022 --no-figures --out {out}"]
)
def test_an_output_that_lacks_marks_gets_plain_ones(words: str, encoding: str, bag: Path, tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONIOENCODING": encoding}
    command = started("pam_antagonist", *words.format(bag=bag, out=tmp_path / "out").split())
    done = subprocess.run(command, env=environment, capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"\\x" not in done.stdout and b"\\u" not in done.stdout
    assert done.stdout.decode(encoding)


_IMPORTS = """
import os, signal, sys
class Finder:
    def find_spec(self, name, path, target=None):
        if name == "pam_antagonist.recording":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
from pam_antagonist.__main__ import main
sys.argv[1:] = ["check", "bag", "--rig", "shin2022"]
sys.exit(main())
"""
_COMPILES = """
import os, signal, sys
from pathlib import Path
from pam_antagonist import program
from pam_antagonist.cli import common
from pam_antagonist.paths import output_folder
def work(arguments):
    with output_folder(Path("out")) as folder:
        (folder / "half").touch()
        # As the compiler's callback does: what is raised there is lost.
        exec("import os, signal\\ntry: os.kill(os.getpid(), signal.SIGINT)\\nexcept BaseException: pass",
             {"__name__": "llvmlite.binding.executionengine"})
        raise RuntimeError("no compiled object yet")
sys.argv[1:] = []
sys.exit(common.run(lambda: common.Parser("thing", "Do a thing."), work))
"""
_DONE = """
import os, signal, sys, threading, time
from pam_antagonist import program
sys.argv[1:] = ["--version"]
from pam_antagonist.__main__ import main
status = main()
os.kill(os.getpid(), signal.SIGINT)
sys.exit(status)
"""


@pytest.mark.parametrize(("code", "status"), [(_IMPORTS, 130), (_COMPILES, 130), (_DONE, 0)])
def test_an_interrupt_at_a_bad_moment_leaves_no_traceback_and_nothing_broken(code, status, tmp_path, python):
    """While modules are imported, while numba compiles, and when all is done."""
    done = python("-c", code, cwd=tmp_path)
    assert done.returncode == status and "Traceback" not in done.stderr, done.stderr
    assert done.stderr == ("interrupted\n" if status else "")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("name", "status"), [("check", 130), ("estimator", 0)])
def test_a_signal_that_came_while_python_started_ends_an_executable(name, status):
    """``./run`` blocks signals until then."""
    code = "import os, signal, sys; signal.pthread_sigmask(signal.SIG_BLOCK, [2]); os.kill(os.getpid(), 2); "
    code += "os.execv(sys.argv[1], sys.argv[1:])"
    done = subprocess.run(
        [sys.executable, "-c", code, *started("pam_antagonist", name)], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (status, "", "interrupted\n" if status else "")
