"""A device is watched, with a running gateway and without one, from its serial port to the screen."""

from __future__ import annotations

import socket
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from helpers.gateway_recordings import files_in, measured, series_in
from helpers.processes import Service, free_port
from helpers.terminals import Terminal
from pretouch_sensor_gateway.command import local_gateway
from pretouch_sensor_gateway.command.local_gateway import DEVICE, run_local_gateway
from pretouch_sensor_gateway.recording.queue_items import StopItem
from pretouch_simulation.finger_link import FingerProcess

from pretouch.channel import open_sync_channel
from pretouch.errors import InvalidInput, Unavailable
from pretouch.geometry import Pose
from pretouch.trajectory import Trajectory
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.v1.sensor_gateway_pb2_grpc import SensorGatewayServiceStub
from pretouch.wire.common import array_from_proto

TIMEOUT = 60.0
STILL_FINGER = """
import numpy as np
from pretouch_simulation.finger_process import run
run(lambda poses: (np.full(len(poses), 0.0423), np.zeros(len(poses), int)), rate=30.0, seed=3)
"""


@pytest.fixture(scope="module")
def finger() -> Iterator[FingerProcess]:
    """A finger that measures 42.3 mm for as long as the tests last."""
    with FingerProcess([sys.executable, "-c", STILL_FINGER]) as process:
        process.play(Trajectory(np.array([0.0, 600.0]), np.stack([Pose.identity().matrix] * 2)))
        yield process


def sees_the_finger(terminal: Terminal, port: str) -> None:
    terminal.wait_for("42.3")
    terminal.wait_for("simulated finger")
    screen = terminal.wait_for("round trip")
    assert any("● streaming at" in line for line in screen)
    assert any(line.split() == ["port", port] for line in screen)
    assert any("binary" in line and "modules 1" in line and "30 Hz" in line for line in screen)
    assert any("clock" in line and "synchronised" in line and "round trip" in line for line in screen)
    assert any("frames" in line and " 0 lost " in line for line in screen)


def test_a_device_is_watched_straight_at_its_port(finger: FingerProcess) -> None:
    with Terminal("gateway", "watch", "--port", finger.port) as terminal:
        sees_the_finger(terminal, finger.port)
        terminal.type(b"q")
        assert terminal.ended() == 0
        assert terminal.now == terminal.before
        assert terminal.said.endswith(b"\x1b[?25h\x1b[?1049l"), "the gateway's log stays off the terminal"


def test_a_device_of_a_running_gateway_is_watched(finger: FingerProcess) -> None:
    service = Service("gateway", free_port(), {"PRETOUCH_GATEWAY_DEVICES": f"thumb={finger.port}"})
    service.start()
    try:
        with Terminal("gateway", "watch", "--gateway", service.address) as terminal:
            sees_the_finger(terminal, finger.port)
            assert service.stop() == 0
            terminal.wait_for("No gateway answers")
            service.start()
            terminal.wait_for("is back")
            terminal.type(b"q")
            assert terminal.ended() == 0
    finally:
        service.stop()


def test_a_port_that_is_not_there_is_told_and_waited_for(tmp_path: Path, finger: FingerProcess) -> None:
    port = tmp_path / "port"
    with Terminal("gateway", "watch", "--port", str(port), "--format", "binary") as terminal:
        terminal.wait_for("There is no device at")
        port.symlink_to(finger.port)
        terminal.wait_for("42.3")
        terminal.type(b"\x03")
        assert terminal.ended() == 0


def test_a_port_that_never_was_there_is_a_failure() -> None:
    with Terminal("gateway", "watch", "--port", "/dev/none", "--format", "binary") as terminal:
        terminal.wait_for("There is no device at")
        terminal.type(b"q")
        assert terminal.ended() == 1
        assert "There is no device at /dev/none" in terminal.said.decode().rpartition("\x1b[?1049l")[2]


def test_a_recording_is_watched_as_if_it_were_the_device(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    series_in(tmp_path).write([*map(measured, range(3000)), StopItem()], 0.0)
    (recording,) = files_in(tmp_path)
    monkeypatch.chdir(recording.parent)
    with Terminal("gateway", "watch", "--port", f"replay:{recording.name}") as terminal:
        terminal.wait_for("● streaming")
        screen = terminal.wait_for("50.0")
        assert any(line.split()[:2] == ["5", "-"] for line in screen)
        terminal.type(b"q")
        assert terminal.ended() == 0


def test_a_local_gateway_serves_its_device_and_ends_with_the_block(
    finger: FingerProcess, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PRETOUCH_TOKEN", "of another gateway")
    with run_local_gateway(finger.port) as address:
        assert address.startswith("127.0.0.1:")
        with open_sync_channel(address) as channel:
            stub = SensorGatewayServiceStub(channel)
            stream = stub.StreamRanges(pb.StreamRangesRequest(), timeout=TIMEOUT)
            batch = next(stream).batch
            stream.cancel()
            assert array_from_proto(batch.range, "range")[0, 0] == pytest.approx(0.0423)
            assert stub.GetStatus(pb.GetStatusRequest(device=DEVICE), timeout=TIMEOUT).format == "binary"
    host, _, port = address.partition(":")
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection((host, int(port)), TIMEOUT)
    assert capfd.readouterr().out == ""


def test_a_local_gateway_ends_when_the_program_fails(finger: FingerProcess) -> None:
    where = ""

    def fail() -> None:
        nonlocal where
        with run_local_gateway(finger.port) as where:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    host, _, port = where.partition(":")
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection((host, int(port)), TIMEOUT)


def test_a_local_gateway_that_does_not_start_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local_gateway, "_GATEWAY", (sys.executable, "-c", "raise SystemExit('There is no room.')"))
    with pytest.raises(Unavailable, match="There is no room"), run_local_gateway("/dev/ttyUSB0"):
        pass


def test_what_the_gateway_logs_as_an_error_is_told_afterwards(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    script = """
import sys
print('{"event": "ready", "host": "127.0.0.1", "port": 7, "level": "info"}', file=sys.stderr)
print('{"event": "defect", "level": "error"}', file=sys.stderr, flush=True)
sys.stdin.read()
"""
    monkeypatch.setattr(local_gateway, "_GATEWAY", (sys.executable, "-c", script))
    with run_local_gateway("/dev/ttyUSB0") as address:
        assert address == "127.0.0.1:7"
        assert capsys.readouterr().err == ""
    assert capsys.readouterr().err == '{"event": "defect", "level": "error"}\n'


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("ttyUSB0",), "absolute path"),
        (("/dev/ttyUSB0", "morse"), "no wire format 'morse'"),
        (("/dev/ttyUSB0", "auto", 3), "baud rate 3"),
    ],
)
def test_what_cannot_be_is_refused(arguments: tuple[str | int, ...], told: str) -> None:
    with pytest.raises(InvalidInput, match=told), run_local_gateway(*arguments):  # type: ignore[arg-type]
        pass
