"""`pretouch gateway calibrate` against a gateway: what is asked, what is taken, what comes out."""

from __future__ import annotations

import io
import json
import sys
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import typer
from helpers.plate_gateway import SERIAL, PlateGateway
from helpers.processes import free_port
from pretouch_sensor_gateway.calibration import picture
from pretouch_sensor_gateway.calibration.file import load, save
from pretouch_sensor_gateway.calibration.model import UNCALIBRATED, Calibration, ModuleCalibration
from pretouch_sensor_gateway.calibration.proto_conversion import calibration_from_proto
from pretouch_sensor_gateway.command.calibrate import calibrate

from pretouch.errors import InvalidInput, NotFound, PretouchError, Unavailable

PLAIN = ModuleCalibration(0.003, 1.02, 0.0, 0.0007, 0.01)
GLASS = ModuleCalibration(-0.01, 0.96, 12.0, 0.0007, 0.01)
DISTANCES = (15, 20, 30, 40, 50, 60, 80, 100)
ENTER = ""


class Hands(io.TextIOBase):
    """A person at stdin: before each answer something may be done; when nothing is left, stdin ends.

    A step is an answer, or an answer and what to do before it; an answer may be an exception.
    """

    def __init__(self, steps: list[Any]) -> None:
        self._steps = [step if isinstance(step, tuple) else (step, lambda: None) for step in steps]

    def readline(self, size: int | None = -1, /) -> str:
        if not self._steps:
            return ""
        answer, do = self._steps.pop(0)
        do()
        if isinstance(answer, str):
            return answer + "\n"
        raise answer

    @property
    def left(self) -> int:
        return len(self._steps)


@dataclass
class Bench:
    """A finger before a plate, and the folder where results go."""

    gateway: PlateGateway
    folder: Path
    monkeypatch: pytest.MonkeyPatch
    capsys: pytest.CaptureFixture[str]

    @property
    def out(self) -> Path:
        return self.folder / "calibration.json"

    def at(self, millimetres: float, **changes: Any) -> tuple[str, Callable[[], None]]:
        """Puts the plate there, changes the gateway, and presses Enter."""

        def do() -> None:
            for name, value in ({"plate": millimetres / 1000, "slide": 0.0} | changes).items():
                setattr(self.gateway, name, value)

        return ENTER, do

    def calibrate(self, steps: list[Any], *options: str, left: int = 0) -> tuple[int, str]:
        """Exit code and output, both streams."""
        hands = Hands(steps)
        self.monkeypatch.setattr(sys, "stdin", hands)
        self.monkeypatch.chdir(self.folder)
        app = typer.Typer()
        app.command()(calibrate)
        self.capsys.readouterr()
        arguments = ["--gateway", self.gateway.address, "--warm-up", "0", *options]
        code = app(arguments, standalone_mode=False)
        assert hands.left == left
        told = self.capsys.readouterr()
        return code or 0, told.out + told.err


@pytest.fixture
def gateway() -> Iterator[PlateGateway]:
    with PlateGateway(PLAIN, GLASS) as gateway:
        yield gateway


@pytest.fixture
def drawing_bench(
    gateway: PlateGateway, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Bench:
    monkeypatch.setenv("COLUMNS", "200")
    return Bench(gateway, tmp_path, monkeypatch, capsys)


@pytest.fixture
def bench(drawing_bench: Bench) -> Bench:
    """Without the picture, which takes longer than all the rest."""
    drawing_bench.monkeypatch.setattr(picture, "write_picture", lambda *_: None)
    return drawing_bench


def test_a_finger_is_calibrated_from_start_to_end(drawing_bench: Bench) -> None:
    bench = drawing_bench
    bench.gateway.outliers = 0.02
    code, told = bench.calibrate([*map(bench.at, DISTANCES), ENTER], "--warm-up", "0.01")
    assert code == 0
    calibration, record = load(bench.out)
    assert (calibration.serial, calibration.warm_up) == (SERIAL, 0.01)
    assert record is not None
    assert record.device == "left"
    for true, module, fit in zip((PLAIN, GLASS), calibration.modules, record.modules, strict=True):
        assert abs(module.offset - true.offset) < 4 * fit.errors.offset < 0.003
        assert abs(module.scale - true.scale) < 4 * fit.errors.scale < 0.06
        assert abs(module.crosstalk - true.crosstalk) <= 4 * fit.errors.crosstalk
        assert [point.distance for point in fit.points] == [each / 1000 for each in DISTANCES]
        assert all(40 < point.samples + len(point.outliers) <= 60 for point in fit.points)
        assert fit.step == pytest.approx(0.001)
        assert any(point.outliers for point in fit.points)
    assert calibration.modules[0].crosstalk == 0 < calibration.modules[1].crosstalk
    assert (bench.folder / "calibration.png").read_bytes().startswith(b"\x89PNG")
    for millimetres in DISTANCES:
        assert f"Put the plate at {millimetres} mm in front of all modules, square to the beams" in told
    assert "Saved calibration.json" in told
    configured = tomllib.loads(told[told.index("[devices") :])
    assert configured == {"devices": {"left": {"calibration": str(bench.out.resolve())}}}
    assert not bench.gateway.configured
    assert "Configure" in told


def test_apply_sends_it_to_the_gateway(bench: Bench) -> None:
    code, told = bench.calibrate([*map(bench.at, (20, 40, 80)), ENTER], "--distances", "20,40,80", "--apply")
    assert code == 0
    (request,) = bench.gateway.configured
    assert request.device == "left"
    assert calibration_from_proto(request.calibration) == load(bench.out)[0]
    assert not request.tip_t_module
    assert not request.HasField("recording")
    assert "The gateway uses it for left until it ends" in told


def test_a_distance_is_skipped_repeated_and_mistyped(bench: Bench) -> None:
    steps = [
        "r",  # there is nothing to repeat yet
        bench.at(20),
        bench.at(60),  # meant to be at 40
        "r",
        bench.at(40),
        "x",
        "s",  # 60
        bench.at(80),
        "r",
        bench.at(80),
        ENTER,
    ]
    code, told = bench.calibrate(steps, "--distances", "20,40,60,80")
    assert code == 0, told
    record = load(bench.out)[1]
    assert record is not None
    points = record.modules[0].points
    assert [point.distance for point in points] == [0.02, 0.04, 0.08]
    assert all(abs(point.residual) < 0.001 for point in points)
    assert told.count("is none of these") == 2
    assert "r: repeat 40 mm" in told


def test_a_plate_that_moves_is_refused_and_measured_again(bench: Bench) -> None:
    steps = [bench.at(20), bench.at(40, slide=0.0002), bench.at(40), bench.at(80), ENTER]
    code, told = bench.calibrate(steps, "--distances", "20,40,80")
    assert code == 0
    assert "Not taken, was the plate moved? Module 0: its readings moved by" in told.replace("\n", " ")
    record = load(bench.out)[1]
    assert record is not None
    assert all(abs(point.residual) < 0.001 for fit in record.modules for point in fit.points)


def test_a_shaken_plate_is_refused_once_and_noise_that_stays_is_the_modules_own(bench: Bench) -> None:
    loud = (ModuleCalibration(0.003, 1.02, 0.0, 0.008), GLASS)
    steps = [bench.at(20), bench.at(40, modules=loud), bench.at(40), bench.at(80), ENTER]
    code, told = bench.calibrate(steps, "--distances", "20,40,80")
    assert code == 0
    assert told.count("Not taken") == 1
    assert "elsewhere" in told
    record = load(bench.out)[1]
    assert record is not None
    assert len(record.modules[0].points) == 3


def test_a_module_that_sees_nothing_is_named_and_left_out_there(bench: Bench) -> None:
    far_blind = bench.at(80, modules=(PLAIN, None))
    steps = [*(bench.at(each, modules=(PLAIN, GLASS)) for each in (20, 40, 60)), far_blind, ENTER]
    code, told = bench.calibrate(steps, "--distances", "20,40,60,80")
    assert code == 0
    assert "left out at 80 mm: module 1" in told
    record = load(bench.out)[1]
    assert record is not None
    assert [len(fit.points) for fit in record.modules] == [4, 3]


def test_a_module_that_never_sees_anything_stays_uncalibrated(bench: Bench) -> None:
    bench.gateway.modules = (None, PLAIN)
    code, told = bench.calibrate([*map(bench.at, (20, 40, 80)), ENTER], "--distances", "20,40,80")
    assert code == 0
    assert "Module 0 is not calibrated" in told
    calibration, _ = load(bench.out)
    assert calibration.modules[0] == UNCALIBRATED != calibration.modules[1]


def test_a_distance_where_nobody_sees_the_plate_is_asked_for_again(bench: Bench) -> None:
    steps = [bench.at(20), bench.at(40, modules=(None, None)), bench.at(40, modules=(PLAIN, GLASS)), ENTER]
    code, told = bench.calibrate(steps, "--distances", "20,40")
    assert code == 0
    assert "No module saw the plate" in told
    assert "two distances tell offset and scale alone" in told


def test_what_interrupts_the_device_costs_one_distance_only(bench: Bench) -> None:
    steps = [
        bench.at(20),
        bench.at(40, cut=20),
        bench.at(40, cut=None, epoch=2),
        bench.at(80, modules=(PLAIN,)),
        bench.at(80, modules=(PLAIN, GLASS)),
        ENTER,
    ]
    code, told = bench.calibrate(steps, "--distances", "20,40,80")
    assert code == 0
    assert "The gateway is shutting down" in told
    assert told.count("can be repeated") == 1
    assert told.count("restarted") == 1
    assert "1 modules now, 2 before" in told
    assert load(bench.out)[1] is not None


@pytest.mark.parametrize("end", [KeyboardInterrupt, EOFError])
def test_what_was_measured_before_an_interruption_is_fitted(bench: Bench, end: type[BaseException]) -> None:
    code, told = bench.calibrate([*map(bench.at, (15, 20, 30)), end])
    assert code == 0
    assert "3 of 8 distances were measured" in told
    record = load(bench.out)[1]
    assert record is not None
    assert len(record.modules[0].points) == 3


@pytest.mark.parametrize("measured", [(), (15,)])
def test_too_little_before_an_interruption_is_lost_and_this_is_said(bench: Bench, measured: tuple[int, ...]) -> None:
    code, told = bench.calibrate([*map(bench.at, measured), KeyboardInterrupt])
    assert code == 130
    assert f"{len(measured)} of 8 distances were measured" in told
    assert "nothing was saved" in told
    assert list(bench.folder.iterdir()) == []


def test_stdin_that_ends_after_the_last_distance_is_an_end_like_any(bench: Bench) -> None:
    code, told = bench.calibrate([bench.at(30)], "--distances", "30")
    assert code == 0
    assert "one distance tells the offset alone" in told
    assert load(bench.out)[0].modules[0].scale == 1.0


def test_nothing_measured_is_refused(bench: Bench) -> None:
    with pytest.raises(InvalidInput, match="No distance was measured"):
        bench.calibrate(["s", "s", ENTER], "--distances", "20,40")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--distances", ""], "are not valid"),
        (["--distances", "20,thirty"], "are not valid"),
        (["--distances", "20,-30"], "are not valid"),
        (["--distances", "nan"], "are not valid"),
        (["--distances", "20,20.0"], "names one twice"),
        (["--report", "a.gif"], r"no \.png"),
        (["--out", "/dev/null/c.json"], "cannot be written"),
        (["--out", "."], "cannot be written"),
        (["--report", "/proc/c.png"], "cannot be written"),
        (["--gateway", "nowhere"], "not a gRPC address"),
        (["--port", "/dev/ttyACM0"], "without a running gateway"),
    ],
)
def test_what_cannot_work_is_refused_before_anything_is_measured(bench: Bench, options: list[str], said: str) -> None:
    with pytest.raises(InvalidInput, match=said) as caught:
        bench.calibrate([ENTER], *options)
    assert caught.value.remedy
    assert bench.gateway.asked == []


def test_no_gateway_no_device_and_no_ranges_are_told_apart(bench: Bench) -> None:
    def refused(*options: str) -> PretouchError:
        with pytest.raises(PretouchError) as caught:
            bench.calibrate([ENTER], *options)
        return caught.value

    absent = refused("--gateway", f"127.0.0.1:{free_port()}")
    assert isinstance(absent, Unavailable)
    assert absent.remedy
    unknown = refused("--device", "right")
    assert isinstance(unknown, NotFound)
    assert "'right'" in unknown.detail
    bench.gateway.state, bench.gateway.problem = 1, "No such file or directory"
    silent = refused("--device", "left")
    assert isinstance(silent, Unavailable)
    assert "left sends no ranges: No such file" in silent.detail


@pytest.mark.parametrize("package", ["scipy", "matplotlib"])
def test_a_missing_package_is_named_before_anything_is_measured(bench: Bench, package: str) -> None:
    prefix = "pretouch_sensor_gateway.calibration."
    for module in ("fit", "picture"):
        bench.monkeypatch.delitem(sys.modules, prefix + module, raising=False)
    for name in [name for name in sys.modules if name.split(".")[0] == package]:
        bench.monkeypatch.delitem(sys.modules, name)
    bench.monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(Unavailable, match=package) as caught:
        bench.calibrate([ENTER])
    assert caught.value.remedy == "Run: pip install 'pretouch[calibrate]'"
    assert bench.gateway.asked == []


def test_a_name_that_toml_does_not_take_bare_is_quoted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / 'an "odd" folder'
    folder.mkdir()
    with PlateGateway(PLAIN, device="left.1") as gateway:
        bench = Bench(gateway, folder, monkeypatch, capsys)
        _, told = bench.calibrate([bench.at(20), bench.at(80)], "--distances", "20,80", "--device", "left.1")
    configured = tomllib.loads(told[told.index("[devices") :])
    assert configured == {"devices": {"left.1": {"calibration": str(bench.out.resolve())}}}
    assert json.loads(bench.out.read_text())["made"]["device"] == "left.1"


def test_drift_is_added_to_the_calibration_and_stays_when_the_modules_are_calibrated_again(bench: Bench) -> None:
    bench.gateway.rate = 10.0
    code, told = bench.calibrate([], "--drift", "--minutes", "2", "--apply")
    assert code == 0
    assert "Module 1: noise" in told
    assert "run this command without --drift, too" in told
    drift, record = load(bench.out)
    assert (drift.serial, drift.modules, record) == (SERIAL, (UNCALIBRATED,) * 2, None)
    assert drift.bias_std is not None
    assert drift.bias_std < 0.0005
    assert [calibration_from_proto(each.calibration) for each in bench.gateway.configured] == [drift]
    bench.calibrate([*map(bench.at, DISTANCES), ENTER])
    both, record = load(bench.out)
    assert both.bias_std == drift.bias_std
    assert UNCALIBRATED not in both.modules
    bench.gateway.plate = 0.05
    bench.calibrate([], "--drift", "--minutes", "2")
    again, kept = load(bench.out)
    assert (again.modules, kept) == (both.modules, record)


def test_drift_of_another_board_or_of_a_module_without_a_target_is_refused(bench: Bench) -> None:
    bench.gateway.rate = 10.0
    save(bench.out, Calibration("0a", 0.0, (ModuleCalibration(),) * 2))
    with pytest.raises(InvalidInput, match="is the calibration of board 0a"):
        bench.calibrate([], "--drift", "--minutes", "2")
    save(bench.out, Calibration(SERIAL, 0.0, (ModuleCalibration(),) * 3))
    with pytest.raises(InvalidInput, match="describes 3 modules, the device has 2"):
        bench.calibrate([], "--drift", "--minutes", "2")
    bench.out.unlink()
    bench.gateway.modules = (None, None)
    with pytest.raises(InvalidInput, match="too few ranges for the drift"):
        bench.calibrate([], "--drift", "--minutes", "2")
    assert not bench.out.exists()
