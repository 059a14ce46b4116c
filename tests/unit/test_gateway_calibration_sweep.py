"""A sweep over an unknown step tells a module's mount and cone, though its response is not the fit's own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from pretouch_sensor_gateway.calibration import sweep_fit
from pretouch_sensor_gateway.calibration.file import load, save
from pretouch_sensor_gateway.calibration.model import Calibration, ModuleCalibration
from pretouch_sensor_gateway.calibration.mounting import PARAMETERS, Mounting
from pretouch_sensor_gateway.calibration.proto_conversion import calibration_from_proto, calibration_to_proto
from pretouch_sensor_gateway.calibration.sensor import describe_sensor
from pretouch_sensor_gateway.calibration.sweep_fit import OWN, Sweep, fit_sweep
from pretouch_sensor_gateway.calibration.sweep_scene import Profile, Response, Step, predict_ranges
from pretouch_sensor_gateway.command.sweep import sweep_through
from pretouch_simulation.fingers.cone_finger import ConeFinger, Errors
from pretouch_simulation.fingers.cone_response import ConeResponse, Estimator
from pretouch_simulation.fingers.range_curve import RangeCurve
from pretouch_simulation.fingers.spot import Spot

from experiments.sweeps import HEIGHT, draw_truth, fly, make_world
from pretouch.errors import InvalidInput
from pretouch.geometry import Pose, rotation_from_vector
from pretouch.tof import RangeSamples, Sensor
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.wire.common import pose_from_proto, pose_to_proto, samples_to_proto, sensor_to_proto

HALF_ANGLE = float(np.radians(11.0))
SENSOR = Sensor(beam_half_angle=float(np.radians(12.5)), range_std=0.001)
MOUNTING = Mounting(
    Pose.of(rotation_from_vector([0.02, -0.01, 0.3]), [0.001, 0.002, 0.0]),
    0.0011,
    0.012,
    0.21,
    70.0,
    np.eye(len(PARAMETERS)) * 1e-4,
    ("decay",),
)


def finger(estimator: Estimator = Estimator.MEAN) -> ConeFinger:
    errors = Errors(0.001, 0.0003, RangeCurve((0.01, 0.1)), 0.0, 0.01, 0.02, 0.01, 0.01)
    return ConeFinger(SENSOR, ConeResponse(Spot(HALF_ANGLE), 0.015, estimator), errors)


def test_mount_latency_and_width_come_back_within_what_is_stated(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sweep_fit, "MOST_RANGES", 130)
    rng = np.random.default_rng(1)
    truth, mount = draw_truth(finger(), rng)
    found, residual = fit_sweep(fly(finger(), truth, mount, rng), Pose.identity(), 0.001, SENSOR.beam_half_angle)
    turned = found.tip_T_module.rotation[:, 2] - truth.tip_T_module.rotation[:, 2]
    moved = found.tip_T_module.translation - truth.tip_T_module.translation
    off = [-turned[1], turned[0], *moved[:2], found.latency - truth.latency, np.log(found.half_angle / HALF_ANGLE)]
    names = ("tilt_x", "tilt_y", "origin_x", "origin_y", "latency", "log_half_angle")
    stds = [found.stds[name] for name in names]
    assert (np.abs(off) < 3.5 * np.array(stds)).all(), dict(zip(names, zip(off, stds, strict=True), strict=True))
    assert stds[2] < 0.005
    assert stds[0] < np.radians(4)
    assert 0.0005 < residual < 0.003
    assert moved[2] == pytest.approx(0.0, abs=2e-4)  # along the beam it stays where it was given
    assert tuple(OWN) == PARAMETERS


@pytest.mark.parametrize(("nearness", "decay"), [(np.inf, 0.0), (0.015, 1 / 0.015)])
def test_the_fits_model_is_near_a_simulated_module(nearness: float, decay: float) -> None:
    world = make_world()
    poses = np.tile(np.eye(4), (41, 1, 1))
    poses[:, :3, :3] = rotation_from_vector([np.pi, 0.0, 0.0])
    poses[:, :3, 3] = np.column_stack([np.linspace(-0.04, 0.04, 41), np.zeros(41), np.full(41, 0.06)])
    simulated, _ = ConeResponse(Spot(HALF_ANGLE), nearness).read(world, poses, finger().reflectances)
    step = Step(np.eye(3), np.zeros(3), HEIGHT, 1.0)
    predicted = predict_ranges(poses, step, Response(HALF_ANGLE, decay, 1.0, Profile.ROUND))
    assert np.sqrt(np.mean((predicted - simulated) ** 2)) < 0.0012
    np.testing.assert_allclose(predicted[[0, -1]], [0.04, 0.06], atol=2e-4)


def sweep_of(ranges: float, count: int = 300) -> Sweep:
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = rotation_from_vector([np.pi, 0.0, 0.0])
    poses[:, 0, 3], poses[:, 2, 3] = np.linspace(-0.05, 0.05, count), 0.06
    return Sweep(np.arange(count) / 30, poses, np.full(count, ranges))


@pytest.mark.parametrize(
    ("sweep", "said"),
    [(sweep_of(0.06), "shows no step"), (sweep_of(np.nan), "holds 0 ranges"), (sweep_of(0.05, 20), "holds 20 ranges")],
    ids=["flat", "nothing", "short"],
)
def test_a_sweep_that_tells_nothing_is_refused(sweep: Sweep, said: str) -> None:
    with pytest.raises(InvalidInput, match=said):
        fit_sweep(sweep, Pose.identity(), 0.001, 0.2)


def same(one: Mounting | None, other: Mounting | None) -> bool:
    assert one is not None
    assert other is not None
    np.testing.assert_allclose(one.covariance, other.covariance)
    assert one.tip_T_module.is_close(other.tip_T_module)
    plain = [(m.offset, m.latency, m.half_angle, m.decay, m.unobserved) for m in (one, other)]
    return plain[0] == plain[1]


def test_a_mounting_is_kept_in_the_file_and_on_the_wire(tmp_path: Path) -> None:
    calibration = Calibration(modules=(ModuleCalibration(mounting=MOUNTING),))
    save(tmp_path / "c.json", calibration)
    assert same(load(tmp_path / "c.json")[0].modules[0].mounting, MOUNTING)
    assert same(calibration_from_proto(calibration_to_proto(calibration)).modules[0].mounting, MOUNTING)
    text = (tmp_path / "c.json").read_text()
    (tmp_path / "c.json").write_text(text.replace('"half_angle_rad": 0.21', '"half_angle_rad": 21'))
    with pytest.raises(InvalidInput, match=r"modules\[0\]\.mounting: half_angle is 21"):
        load(tmp_path / "c.json")


def test_the_sessions_sensor_is_what_the_calibration_says() -> None:
    module = ModuleCalibration(std=0.0003, residual=0.0004, span=(0.02, 0.12), mounting=MOUNTING)
    sensor = describe_sensor(Calibration(modules=(module,), bias_std=0.0005), (Pose.identity(),), 0.01, 30.0)
    assert (sensor.range_min, sensor.range_max, sensor.beam_half_angle) == (0.02, 0.12, 0.21)
    assert sensor.range_std == pytest.approx(0.0005)
    assert sensor.range_bias_std == 0.0005
    unknown = describe_sensor(None, (Pose.identity(),), 0.004, 15.0)
    assert unknown == replace(Sensor(), range_std=0.004, rate=15.0, tip_T_module=unknown.tip_T_module)
    blind = replace(MOUNTING, unobserved=("log_half_angle",))
    thin = describe_sensor(Calibration(modules=(ModuleCalibration(mounting=blind),)), (Pose.identity(),), 0.004, 15.0)
    assert thin.beam_half_angle == 0.0


class Gateway:
    """A stub of the calls that the command makes."""

    def __init__(self, samples: RangeSamples) -> None:
        self.samples, self.configured = samples, list[pb.ConfigureRequest]()

    def GetStatus(self, request: pb.GetStatusRequest, timeout: float) -> pb.GetStatusResponse:
        pose = pose_to_proto(Pose.identity())
        configuration = pb.DeviceConfiguration(tip_t_module=[pose])
        return pb.GetStatusResponse(configuration=configuration, sensor=sensor_to_proto(SENSOR))

    def GetSamples(self, request: pb.GetSamplesRequest, timeout: float) -> pb.GetSamplesResponse:
        assert (getattr(request, "from"), request.to) == (100.0, 200.0)
        return pb.GetSamplesResponse(samples=samples_to_proto(self.samples))

    def Configure(self, request: pb.ConfigureRequest, timeout: float) -> None:
        self.configured.append(request)


def test_the_command_adds_what_it_finds_to_the_calibration_and_tells_the_gateway(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    sweep = sweep_of(0.05)
    zeros = np.zeros(len(sweep.t), dtype=np.int64)
    gateway = Gateway(RangeSamples(sweep.t, sweep.base_T_tip, sweep.ranges, zeros, zeros))
    with pytest.raises(InvalidInput, match="Module 0: The sweep shows no step"):
        sweep_through(gateway, "", (100.0, 200.0), 0.2, tmp_path / "c.json", False)
    asked = SimpleNamespace(arguments=())

    def found(*arguments: object) -> tuple[Mounting, float]:
        asked.arguments = arguments
        return MOUNTING, 0.001

    monkeypatch.setattr(sweep_fit, "fit_sweep", found)
    save(tmp_path / "c.json", Calibration("0a", 60.0, (ModuleCalibration(offset=0.01, std=0.001),)))
    sweep_through(gateway, "", (100.0, 200.0), 0.2, tmp_path / "c.json", True)
    assert asked.arguments[2:] == (SENSOR.range_std, 0.2)
    calibration, _ = load(tmp_path / "c.json")
    assert calibration.modules[0].offset == 0.01
    assert same(calibration.modules[0].mounting, MOUNTING)
    told = capsys.readouterr().out
    assert "12.0 ms late" in told
    assert "Not told by this sweep: decay." in told
    (configured,) = gateway.configured
    assert same(calibration_from_proto(configured.calibration).modules[0].mounting, MOUNTING)
    placed = pose_from_proto(configured.tip_t_module[0], "placed")
    assert placed.is_close(MOUNTING.tip_T_module)
