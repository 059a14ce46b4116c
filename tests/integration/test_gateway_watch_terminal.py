"""`pretouch gateway watch` as a person and as a log meet it: a real process, in a real terminal or at a pipe."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import termios
from collections.abc import Iterator

import pytest
from helpers.terminals import Terminal
from helpers.watched_gateway import FakeGateway, device, ranges, status

TIMEOUT = 60
T0 = 1.7e9
ENVIRONMENT = {key: value for key, value in os.environ.items() if not key.startswith("PRETOUCH_")}
SHOWN, RESTORED = b"\x1b[?1049h", b"\x1b[?1049l"
CURSOR_HIDDEN, CURSOR_SHOWN = b"\x1b[?25l", b"\x1b[?25h"
TIME = r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d[+-]\d\d:\d\d"


@pytest.fixture
def gateway() -> Iterator[FakeGateway]:
    with FakeGateway(status(device("thumb")), status(device("index"), epoch=9)) as fake:
        yield fake


def watching(address: str, *arguments: str, **variables: str) -> Terminal:
    return Terminal("gateway", "watch", "--gateway", address, *arguments, variables=variables)


def is_restored(terminal: Terminal) -> None:
    """The screen is the one before, the cursor is seen, and keys are echoed and taken line by line again."""
    said = terminal.said
    assert said.count(SHOWN) == said.count(RESTORED) == 1
    assert said.index(SHOWN) < said.index(RESTORED)
    assert CURSOR_SHOWN in said[said.rindex(CURSOR_HIDDEN) :]
    assert terminal.now == terminal.before


def test_a_person_sees_the_ranges_changes_the_device_and_quits(gateway: FakeGateway) -> None:
    with watching(gateway.address) as terminal:
        gateway.send("thumb", ranges([T0], [[0.0345, 0.02]], [[0, 7]]))
        screen = terminal.wait_for("34.5")
        assert f"gateway {gateway.address}" in screen[0]
        assert any("● streaming" in line and "epoch 3" in line for line in screen)
        assert any(line.split()[:4] == ["1", "-", "no", "target"] for line in screen)
        assert not terminal.now[3] & (termios.ECHO | termios.ICANON)
        gateway.send("index", ranges([T0], [[0.0777]]))
        terminal.type(b"\t")
        terminal.wait_for("epoch 9")
        terminal.wait_for("77.7")
        terminal.type(b"\t")
        terminal.wait_for("epoch 3")
        gateway.statuses["thumb"] = status(device("thumb", lost_frames=3))
        terminal.wait_for("thumb: 3 lost")
        gateway.statuses["thumb"].recent_lines.append("'23 mm'")
        terminal.type(b"r")
        terminal.wait_for("'23 mm'")
        terminal.type(b"q")
        assert terminal.ended() == 0
        is_restored(terminal)


@pytest.mark.parametrize("way", ["ctrl-c", signal.SIGTERM, signal.SIGHUP])
def test_however_it_is_ended_the_terminal_is_as_before(gateway: FakeGateway, way: str | signal.Signals) -> None:
    with watching(gateway.address, "--device", "index") as terminal:
        terminal.wait_for("epoch 9")
        if isinstance(way, signal.Signals):
            terminal.tell(way)
        else:
            terminal.type(b"\x03")
        assert terminal.ended() == 0
        is_restored(terminal)


def test_a_window_that_is_closed_ends_it(gateway: FakeGateway) -> None:
    with watching(gateway.address) as terminal:
        terminal.wait_for("● streaming")
        assert terminal.hang_up() == 0


def test_it_ends_by_itself_after_the_seconds_given(gateway: FakeGateway) -> None:
    with watching(gateway.address, "--seconds", "0.5") as terminal:
        assert terminal.ended() == 0
        is_restored(terminal)


def test_a_gateway_that_goes_and_comes_is_told_and_found_again(gateway: FakeGateway) -> None:
    with watching(gateway.address) as terminal:
        terminal.wait_for("● streaming")
        gateway.stop()
        terminal.wait_for("No gateway answers at")
        terminal.wait_for("Trying again")
        gateway.start()
        terminal.wait_for("is back")
        gateway.send("thumb", ranges([T0], [[0.0345]]))
        terminal.wait_for("34.5")
        terminal.type(b"q")
        assert terminal.ended() == 0


def test_the_view_fits_itself_to_the_terminal(gateway: FakeGateway) -> None:
    with watching(gateway.address) as terminal:
        gateway.send("thumb", ranges([T0], [[0.0345] * 6]))
        terminal.wait_for("34.5")
        for columns, lines in ((140, 50), (60, 16), (80, 24)):
            terminal.resize(columns, lines)
            screen = terminal.wait_for(lambda screen: "gateway" in screen[0] and "34.5" in " ".join(screen))
            assert len(screen) == lines
        terminal.type(b"q")
        assert terminal.ended() == 0


def test_what_waiting_would_not_mend_is_said_after_the_terminal_is_restored() -> None:
    with FakeGateway(status(), token="secret") as gateway:
        with watching(gateway.address, PRETOUCH_TOKEN="guess") as terminal:
            assert terminal.ended() == 2
            is_restored(terminal)
            told = terminal.said[terminal.said.index(RESTORED) :].decode()
            assert "wrong token" in told
            assert "Traceback" not in told
        with watching(gateway.address, "--token", "secret") as terminal:
            terminal.wait_for("● streaming")
            terminal.type(b"q")
            assert terminal.ended() == 0


def piped(*arguments: str, **variables: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "pretouch", "gateway", "watch", *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=ENVIRONMENT | variables,
    )


def test_at_a_pipe_each_device_has_a_line_a_second(gateway: FakeGateway) -> None:
    process = piped("--gateway", gateway.address, "--seconds", "2.5")
    gateway.send("thumb", ranges([T0], [[0.0345, 0.02]], [[0, 7]]))
    said, errors = process.communicate(timeout=TIMEOUT)
    assert errors == ""
    assert process.returncode == 0
    assert "\x1b" not in said
    lines = said.splitlines()
    assert len(lines) in (5, 6)  # at 1, 2 and 2.5 s; at the first the gateway may not have answered yet
    assert re.fullmatch(TIME + r" thumb streaming, 30.0 Hz, 34.5 \(7\) mm, lost 0, refused 0, .*", lines[-2])
    assert re.fullmatch(TIME + r" index streaming, .*", lines[-1])


def test_a_log_that_is_closed_ends_it(gateway: FakeGateway) -> None:
    process = piped("--gateway", gateway.address)
    assert process.stdout is not None
    assert process.stderr is not None
    assert process.stdout.readline()
    process.stdout.close()
    assert process.wait(TIMEOUT) == 0
    assert process.stderr.read() == ""
    process.stderr.close()


def test_a_gateway_that_was_never_heard_fails_what_runs_for_some_seconds(gateway: FakeGateway) -> None:
    gateway.stop()
    process = piped("--gateway", gateway.address, "--seconds", "0.5")
    _, errors = process.communicate(timeout=TIMEOUT)
    assert process.returncode == 1
    assert "No gateway answers" in errors
    assert "Traceback" not in errors
    gateway.start()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--gateway", "nonsense"), "not a gRPC address"),
        (("--port", "/dev/null", "--gateway", "127.0.0.1:50053"), "without a running gateway"),
        (("--port", "/dev/null", "--device", "finger"), "without a running gateway"),
    ],
)
def test_what_cannot_be_is_refused(arguments: tuple[str, ...], told: str) -> None:
    process = piped(*arguments)
    _, errors = process.communicate(timeout=TIMEOUT)
    assert process.returncode == 2
    assert told in errors
    assert len(errors.strip().splitlines()) == 2
