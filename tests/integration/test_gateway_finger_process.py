"""The simulated finger as a process: its port, its world, its end."""

from __future__ import annotations

import asyncio
import math
import signal
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import serial
import structlog
from pretouch_sensor_gateway.range_batch import RangeBatch
from pretouch_sensor_gateway.serial_source import SerialSource
from pretouch_sensor_gateway.wire_formats.binary import BinaryParser
from pretouch_simulation.finger_link import FingerProcess
from pretouch_simulation.world import World

from pretouch.errors import Unavailable
from pretouch.geometry import Plane, Pose
from pretouch.trajectory import Trajectory

BLIND = """
import numpy as np
from pretouch_simulation.finger_process import run
run(lambda poses: (np.full(len(poses), np.nan), np.full(len(poses), 7)), rate=200.0, seed=3)
"""


def test_it_ends_with_its_input_and_takes_its_port_along() -> None:
    with FingerProcess([sys.executable, "-c", BLIND]) as finger:
        process = finger._process
        assert process is not None
        port = Path(finger.port)
        assert port.is_char_device()
    assert process.returncode == 0
    with pytest.raises(Unavailable):
        finger.play(Trajectory(np.zeros(1), np.eye(4)[None]))


def read_until_it_fails(port: serial.Serial) -> None:
    while True:
        port.read(1)


def test_it_ends_on_sigterm_and_its_host_sees_an_unplugged_port() -> None:
    with FingerProcess([sys.executable, "-c", BLIND]) as finger:
        process = finger._process
        assert process is not None
        port = serial.Serial(finger.port, timeout=30)
        assert port.read(10)
        process.send_signal(signal.SIGTERM)
        assert process.wait(30) == 0
        with pytest.raises(serial.SerialException):
            read_until_it_fails(port)
        port.close()


def test_a_finger_that_cannot_start_says_why(tmp_path: Path) -> None:
    with pytest.raises(Unavailable, match="no world file"):
        FingerProcess.in_world(tmp_path / "none.npz").start()
    with pytest.raises(Unavailable, match="rate"):
        FingerProcess.in_world(tmp_path / "none.npz", rate=0).start()


def test_an_announcement_that_cannot_be_read_is_said_and_survived() -> None:
    with FingerProcess([sys.executable, "-c", BLIND]) as finger:
        process = finger._process
        assert process is not None
        assert process.stdin is not None
        process.stdin.write(b"nonsense\n{}\n")
        process.stdin.flush()
        finger.play(Trajectory(np.zeros(1), np.eye(4)[None]))
        with serial.Serial(finger.port, timeout=30) as port:
            assert port.read(500)
        assert process.poll() is None


@pytest.mark.parametrize("sensor", ["ideal", "vl6180x", "cone", "random"])
async def test_it_measures_a_world_and_keeps_up_with_200_hz(sensor: str, tmp_path: Path) -> None:
    World([], Plane(np.array([0.0, 0.0, 1.0]), 0.0)).save(tmp_path / "world.npz")
    down = Pose.from_rotation_vector([math.pi, 0, 0], [0, 0, 0.05]).matrix
    still = Trajectory(np.array([0.0, 1.0]), np.stack([down, down]))
    with FingerProcess.in_world(tmp_path / "world.npz", sensor, seed=1, rate=200.0) as finger:
        batches: list[RangeBatch] = []
        start = time.time() + 0.2
        all_heard = asyncio.Event()

        def deliver(batch: RangeBatch) -> None:
            batches.append(batch)
            if batch.t[-1] >= start + 1.1:
                all_heard.set()

        source = SerialSource(
            finger.port, BinaryParser(), 115_200, None, None, deliver, lambda text: None, structlog.get_logger()
        )
        running = asyncio.create_task(source.run())
        finger.play(still, start)
        async with asyncio.timeout(60):
            await all_heard.wait()
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
    t = np.concatenate([batch.t for batch in batches])
    ranges = np.concatenate([batch.range[:, 0] for batch in batches])[(start <= t) & (t <= start + 1.0)]
    assert sum(batch.lost for batch in batches) == 0
    assert 195 <= len(ranges) <= 201
    assert np.isfinite(ranges).mean() > 0.9
    assert abs(np.nanmedian(ranges) - 0.05) < 0.002
    assert 0.0005 < np.nanstd(ranges) < 0.01
