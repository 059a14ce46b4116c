"""A device is calibrated through the real gateway, and what the gateway then says is where the plate is."""

from __future__ import annotations

import io
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import typer
from pretouch_sensor_gateway.calibration.file import load
from pretouch_sensor_gateway.command.calibrate import calibrate
from pretouch_sensor_gateway.command.local_gateway import DEVICE, run_local_gateway
from pretouch_simulation.finger_link import FingerProcess

from pretouch.channel import open_sync_channel
from pretouch.geometry import Pose
from pretouch.trajectory import Trajectory
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.v1.sensor_gateway_pb2_grpc import SensorGatewayServiceStub
from pretouch.wire.common import array_from_proto

DISTANCES = (20, 40, 60, 100)
# the plate is as far away as the tip is high
FINGER = """
import numpy as np
from pretouch_sensor_gateway.calibration.model import ModuleCalibration
from pretouch_simulation.finger_process import run
module, rng = ModuleCalibration(0.004, 1.03, 10.0), np.random.default_rng(0)
def measured(poses):
    return module.predict_reading(poses[:, 2, 3]) + 0.0006 * rng.standard_normal(len(poses)), np.zeros(len(poses), int)
run(measured, rate=100.0, seed=3)
"""


def put(finger: FingerProcess, millimetres: float) -> None:
    pose = Pose.from_rotation_vector([0, 0, 0], [0, 0, millimetres / 1000]).matrix
    finger.play(Trajectory(np.array([0.0, 600.0]), np.stack([pose] * 2)))


class Hands(io.TextIOBase):
    """Puts the plate where each prompt wants it, and presses Enter."""

    def __init__(self, finger: FingerProcess) -> None:
        self._finger = finger
        self._ahead = list(DISTANCES)

    def readline(self, size: int | None = -1, /) -> str:
        if self._ahead:
            put(self._finger, self._ahead.pop(0))
        return "\n"


@pytest.fixture
def finger() -> Iterator[FingerProcess]:
    with FingerProcess([sys.executable, "-c", FINGER]) as process:
        put(process, 50)
        yield process


def run(finger: FingerProcess, folder: Path, monkeypatch: pytest.MonkeyPatch, *options: str) -> None:
    monkeypatch.setattr(sys, "stdin", Hands(finger))
    app = typer.Typer()
    app.command()(calibrate)
    files = ["--out", str(folder / "c.json"), "--report", str(folder / "c.png")]
    distances = ["--warm-up", "0", "--distances", ",".join(map(str, DISTANCES))]
    app([*files, *distances, *options], standalone_mode=False)


def test_ranges_are_distances_once_it_is_applied(
    finger: FingerProcess, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with run_local_gateway(finger.port) as address, open_sync_channel(address) as channel:
        run(finger, tmp_path, monkeypatch, "--gateway", address, "--apply")
        calibration, record = load(tmp_path / "c.json")
        assert record is not None
        assert record.device == DEVICE
        assert abs(calibration.modules[0].offset - 0.004) < 4 * record.modules[0].errors.offset < 0.004
        assert calibration.modules[0].crosstalk > 0

        put(finger, 70)
        stub = SensorGatewayServiceStub(channel)
        ranges: list[float] = []
        for response in stub.StreamRanges(pb.StreamRangesRequest(device=DEVICE), timeout=60):
            ranges += array_from_proto(response.batch.range, "range").ravel().tolist()
            if len(ranges) >= 80:
                break
        assert np.median(ranges) == pytest.approx(0.070, abs=0.0008)

        run(finger, tmp_path, monkeypatch, "--gateway", address)  # calibrated anew from what the device itself says
        again, _ = load(tmp_path / "c.json")
        assert again.modules[0].offset == pytest.approx(calibration.modules[0].offset, abs=0.002)


def test_a_device_without_a_gateway_is_calibrated_at_its_port(
    finger: FingerProcess, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run(finger, tmp_path, monkeypatch, "--port", finger.port)
    told = capsys.readouterr().out
    configured = tomllib.loads(told[told.index("[devices") :])
    assert configured == {"devices": {DEVICE: {"address": finger.port, "calibration": str(tmp_path / "c.json")}}}
    calibration, record = load(tmp_path / "c.json")
    assert record is not None
    assert abs(calibration.modules[0].offset - 0.004) < 4 * record.modules[0].errors.offset
