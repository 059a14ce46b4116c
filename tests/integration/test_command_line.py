"""What all commands have in common: completion, a narrow terminal without colours, interrupts, exit codes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.terminals import Terminal

from pretouch import cli
from pretouch.errors import Conflict, DeadlineExceeded, InvalidInput, NotFound, PretouchError, Unavailable

TIMEOUT = 120
PLAIN = {key: value for key, value in os.environ.items() if not key.startswith("PRETOUCH_")}
INTERRUPTED_AT_IMPORT = """
import importlib.abc, os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
class Interrupt(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == wanted:
            os.kill(os.getpid(), signal.SIGINT)
wanted = sys.argv[1]
sys.meta_path.insert(0, Interrupt())
from pretouch.__main__ import main
sys.argv = ["pretouch", *sys.argv[2:]]
main()
"""
INTERRUPTED_IN_A_DESTRUCTOR = """
import os, signal, sys, time
signal.signal(signal.SIGINT, signal.default_int_handler)
from pretouch import cli
class Late:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        for _ in range(1000):
            pass
def healthcheck():
    sys.excepthook(KeyboardInterrupt, KeyboardInterrupt(), None)  # as Cython's code does first
    Late()
    time.sleep(600)
cli._healthcheck = healthcheck
sys.argv = ["pretouch", "healthcheck"]
cli.main()
"""


def run(*words: str, **variables: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *words], capture_output=True, text=True, timeout=TIMEOUT, env=PLAIN | variables, check=False
    )


def pretouch(*arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    return run("-m", "pretouch", *arguments, **variables)


@pytest.mark.parametrize(
    ("line", "wanted"),
    [
        ("pretouch ev", {"evaluate"}),
        ("pretouch up --gate", {"--gateway-port"}),
        ("pretouch scan register --vi", {"--viewpoint"}),
    ],
)
def test_a_shell_completes_commands_and_their_options(line: str, wanted: set[str]) -> None:
    count = str(len(line.split()) - 1)
    done = pretouch(_PRETOUCH_COMPLETE="complete_bash", COMP_WORDS=line, COMP_CWORD=count)
    assert (set(done.stdout.split()), done.stderr) == (wanted, "")


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_completion_can_be_installed(shell: str) -> None:
    done = pretouch(_PRETOUCH_COMPLETE=f"source_{shell}")
    assert "_PRETOUCH_COMPLETE" in done.stdout


@pytest.mark.parametrize("command", ["", "up", "scan register", "gateway calibrate", "evaluate"])
def test_help_is_not_cut_in_sixty_columns(command: str) -> None:
    wide, narrow = (pretouch(*command.split(), "--help", COLUMNS=columns).stdout for columns in ("300", "60"))
    assert max(map(len, narrow.splitlines())) <= 60
    assert "…" not in narrow
    options = {word for word in wide.split() if word.startswith("--") and word.strip("-.,;:")}
    assert options
    for option in options:
        assert option.rstrip(".,;:)") in narrow


def test_colours_can_be_turned_off() -> None:
    coloured, plain = {}, {"NO_COLOR": "1"}
    said = []
    for variables in (coloured, plain):
        with Terminal("healthcheck", "nowhere", variables=variables) as terminal:
            assert terminal.ended() == 2
            said.append(terminal.said)
    assert b"31m" in said[0]
    assert b"31m" not in said[1]


@pytest.mark.parametrize("module", ["typer", "numpy", "pretouch_registrar.report_picture"])
def test_an_interrupt_is_told_in_one_line_while_loading_and_while_running(tmp_path: Path, module: str) -> None:
    files = [str(tmp_path / name) for name in ("a.ply", "b.ply", "c.png")]
    done = run("-c", INTERRUPTED_AT_IMPORT, module, "scan", "register", *files[:2], "--report", files[2])
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "Interrupted.\n")


def test_an_interrupt_where_none_can_be_raised_is_raised_afterwards() -> None:
    done = run("-c", INTERRUPTED_IN_A_DESTRUCTOR)
    assert (done.returncode, done.stderr) == (130, "Interrupted.\n")


@pytest.mark.parametrize(
    ("error", "code"),
    [(InvalidInput, 2), (NotFound, 2), (Conflict, 2), (Unavailable, 1), (DeadlineExceeded, 1)],
)
def test_an_error_of_the_user_has_another_exit_code_than_a_failure(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], error: type[PretouchError], code: int
) -> None:
    def fail() -> None:
        raise error("It is wrong.", "Put it right.")

    monkeypatch.setattr(cli, "_healthcheck", fail)
    monkeypatch.setattr(sys, "argv", ["pretouch", "healthcheck"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == code
    assert capsys.readouterr().err == "It is wrong.\nPut it right.\n"


def test_standard_output_that_is_full_is_told_in_one_line() -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "pretouch", "--help"], stdout=full, stderr=subprocess.PIPE, text=True, env=PLAIN
        )
    assert done.returncode == 1
    assert done.stderr == "The output cannot be written: No space left on device.\n"
