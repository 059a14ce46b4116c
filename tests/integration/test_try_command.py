"""`pretouch try` as a user calls it, on a depth image of a box on a table."""

from __future__ import annotations

import re
import tomllib
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
import typer
from helpers.scenes import KINECT, Box, View, World
from PIL import Image
from pretouch_simulation.try_command import try_image
from pretouch_simulation.try_session import OwnImage, level_base
from typer.testing import CliRunner, Result

from pretouch.camera import DepthImage
from pretouch.errors import PretouchError
from pretouch.geometry import Pose

CAMERA = Pose.from_quaternion([-0.6, 0.0, 0.6], [-0.653, 0.653, -0.271, 0.271])
INTRINSICS = [part for name in ("fx", "fy", "cx", "cy") for part in (f"--{name}", str(getattr(KINECT.camera, name)))]


@pytest.fixture(scope="module")
def depth() -> DepthImage:
    view = View(CAMERA, KINECT.camera, KINECT.width, KINECT.height)
    return World((Box.standing((0.10, 0.07, 0.06), yaw=0.3),)).depth(view, np.random.default_rng(0))[0]


@pytest.fixture
def image(depth: DepthImage, tmp_path: Path) -> Path:
    """The depth image in millimetres."""
    path = tmp_path / "depth.png"
    Image.fromarray(np.round(1000 * depth.metres).astype(np.uint16)).save(path)
    return path


def call(*arguments: object) -> Result:
    app = typer.Typer()
    app.command()(try_image)
    return CliRunner().invoke(app, [str(argument) for argument in arguments], env={"COLUMNS": "200"})


def test_it_says_what_it_found_and_draws_it(image: Path) -> None:
    picture = image.with_name("out.png")
    done = call(image, *INTRINSICS, "--out", picture)
    assert done.exit_code == 0, done.output
    size = [float(number) for number in re.findall(r"[\d.]+", _row(done, "size as seen"))]
    assert size == pytest.approx([10, 7, 6], abs=1)
    assert "found: 0.60 m below the camera, seen 45 degrees down" in _row(done, "table")
    assert 10 < float(_row(done, "error expected now").split()[0]) < 30
    assert 30 <= float(_row(done, "expected returns").split("%")[0]) <= 100
    assert "Warning" not in done.output
    with Image.open(picture) as drawn:
        assert drawn.size == (1700, 800)
        assert len(np.unique(np.asarray(drawn.convert("L")))) > 100
    report = picture.with_suffix(".html").read_text()
    assert "Under way without a scan" in report
    assert "<td>region-1</td>" in report


def test_a_float_image_with_mask_and_roi_is_in_metres(depth: DepthImage, tmp_path: Path) -> None:
    np.save(tmp_path / "depth.npy", depth.metres)
    mask = np.zeros(depth.metres.shape, dtype=np.uint8)
    mask[200:300, 200:460] = 255
    Image.fromarray(mask).save(tmp_path / "mask.png")
    options = ["--mask", tmp_path / "mask.png", "--roi", 250, 0, 400, 480, "--out", tmp_path / "out.png"]
    done = call(tmp_path / "depth.npy", *INTRINSICS, *options)
    assert done.exit_code == 0, done.output
    assert "as masked: 14999 pixels in 250 200 400 300" in _row(done, "object")
    assert "of the object's pixels lie on the table" in done.output


def _row(done: Result, name: str) -> str:
    row = next(line for line in done.output.splitlines() if f" {name} " in line)
    return row.split("│")[2].strip()


def test_the_base_is_one_in_which_the_table_is_level(depth: DepthImage) -> None:
    base_T_camera = level_base(OwnImage(depth, KINECT.camera))
    np.testing.assert_allclose(base_T_camera.rotation[2], CAMERA.rotation[2], atol=0.005)
    np.testing.assert_allclose(base_T_camera.translation, [0, 0, 0.6], atol=0.003)


def test_a_wrong_scale_is_suspected_before_anything_is_looked_for(image: Path, tmp_path: Path) -> None:
    done = call(image, *INTRINSICS, "--depth-scale", "0.1", "--out", tmp_path / "out.png")
    assert "Warning: with a depth scale of 0.1 the image is 8" in done.output


@pytest.mark.parametrize(
    ("changes", "wrong", "remedy"),
    [
        ({"--cy": None}, "--cy", "camera_info"),
        ({"--mask": "small.png"}, "[10, 20] pixels", "depth image's size"),
        ({"--mask": "depth.npz"}, "not a readable PNG", "PNG"),
        ({"--roi": "700 0 800 10"}, "outside the image", "pixels"),
        ({"--table": "0 0 2 1"}, "norm 2", "unit normal"),
        ({"--depth-scale": "0"}, "depth_scale is 0", "metres"),
        ({"--out": "out.jpg"}, "no .png", "--out"),
        ({"--out": "folder.png"}, "cannot be written", "place"),
        ({"depth": "colour.png"}, "not 16-bit greyscale", "16-bit"),
        ({"depth": "missing.png"}, "There is no file", "path"),
        ({"depth": "empty.png"}, "no depth", "0 means no data"),
        ({"depth": "flat.png"}, "Nothing stands on the table", "mask"),
    ],
)
def test_what_cannot_be_used_is_named(image: Path, changes: dict[str, str | None], wrong: str, remedy: str) -> None:
    folder = image.parent
    Image.fromarray(np.ones((10, 20), dtype=np.uint8)).save(folder / "small.png")
    Image.fromarray(np.zeros((48, 64, 3), dtype=np.uint8)).save(folder / "colour.png")
    Image.fromarray(np.zeros((480, 640), dtype=np.uint16)).save(folder / "empty.png")
    Image.fromarray(np.full((480, 640), 800, dtype=np.uint16)).save(folder / "flat.png")
    np.savez(folder / "depth.npz", np.zeros(3))
    (folder / "folder.png").mkdir()
    options: dict[str, str | None] = dict(zip(INTRINSICS[::2], INTRINSICS[1::2], strict=True))
    options |= {"depth": "depth.png", "--out": "out.png"} | changes
    files = {name: str(folder / options[name]) for name in ("depth", "--out", "--mask") if options.get(name)}
    arguments = [files.pop("depth")]
    for name, value in options.items():
        if name != "depth" and value is not None:
            arguments += [name, *([files[name]] if name in files else value.split())]
    done = call(*arguments)
    assert isinstance(done.exception, PretouchError), done.output
    assert wrong in done.exception.detail
    assert remedy in done.exception.remedy
    assert not (folder / "out.png").exists()


def test_the_command_line_knows_it() -> None:
    project = tomllib.loads((Path(__file__).resolve().parents[2] / "pyproject.toml").read_text())
    module, _, rest = project["project"]["entry-points"]["pretouch.commands"]["try"].partition(":")
    assert getattr(import_module(module), rest.split()[0]) is try_image
