"""Real frames are read, put upright and given a hidden error; what is wrong with a file is said."""

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from pretouch_simulation.frames import frame_case, load_frame
from pretouch_simulation.kinect import render
from pretouch_simulation.mesh import Mesh
from pretouch_simulation.objects import box, can
from pretouch_simulation.protocol import PLACE, TABLE, looking_at
from pretouch_simulation.world import Body, World

from pretouch.camera import Camera
from pretouch.errors import InvalidInput, Malformed, NotFound
from pretouch.geometry import Pose

SHARED = Path(os.environ.get("PRETOUCH_SHARED", Path(__file__).parents[3] / "shared"))
REAL = SHARED / "data" / "real_depth" / "ycb_video"


def write_obj(path: Path, mesh: Mesh) -> None:
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices] + [f"f {a} {b} {c}" for a, b, c in mesh.faces + 1]
    path.write_text("\n".join(lines) + "\n")


@pytest.fixture
def frame_file(tmp_path: Path) -> Path:
    """A frame of a box and a can, rendered, in the format of the real ones."""
    camera, base_T_camera = Camera(525, 525, 159.5, 119.5), looking_at(PLACE, 0.7, 0.9)
    meshes = {"box": box(0.08, 0.06, 0.05), "can": can(0.03, 0.06)}
    places = {"box": Pose.identity(), "can": Pose.of(np.eye(3), [0.0, 0.09, 0.0])}
    bodies = [Body(meshes[name], Pose.of(np.eye(3), PLACE) @ places[name]) for name in meshes]
    depth, hit = render(World(bodies, TABLE), camera, base_T_camera, np.random.default_rng(0), (240, 320))
    objects: list[dict[str, Any]] = []
    for k, (name, mesh) in enumerate(meshes.items()):
        write_obj(tmp_path / f"{name}.obj", mesh)
        camera_T_object = base_T_camera.inverse() @ bodies[k].base_T_mesh
        objects.append(
            {"name": name, "label": k + 3, "mesh": f"{name}.obj", "T_cam_obj": camera_T_object.matrix.tolist()}
        )
    Image.fromarray(np.round(depth.metres * 10000).astype(np.uint16)).save(tmp_path / "depth.png")
    Image.fromarray(np.where(hit >= 0, hit + 3, 0).astype(np.uint8)).save(tmp_path / "label.png")
    description = {
        "width": 320,
        "height": 240,
        **{"fx": 525.0, "fy": 525.0, "cx": 159.5, "cy": 119.5},
        "depth_unit_m": 0.0001,
        "files": {"depth": "depth.png", "label": "label.png"},
        "objects": objects,
    }
    path = tmp_path / "frame.json"
    path.write_text(json.dumps(description))
    return path


def changed(path: Path, **members: Any) -> Path:
    path.write_text(json.dumps({**json.loads(path.read_text()), **members}))
    return path


def test_a_frame_stands_upright_with_the_object_ahead(frame_file: Path) -> None:
    case = frame_case(load_frame(frame_file), "can", seed=0)
    table = case.world.table
    np.testing.assert_allclose(table.normal, [0, 0, 1], atol=1e-9)
    assert table.offset == pytest.approx(0, abs=1e-9)
    corrected = case.truth.apply(case.cloud)
    np.testing.assert_allclose(corrected.mean(axis=0)[:2], PLACE[:2], atol=1e-6)
    assert np.quantile(corrected[:, 2], 0.02) > -0.01
    assert np.quantile(corrected[:, 2], 0.98) < 0.07
    assert (case.truth @ case.base_T_camera).translation[2] == pytest.approx(0.7 * np.sin(0.9), abs=0.005)


def test_the_finger_meets_all_objects_of_a_frame_at_their_true_places(frame_file: Path) -> None:
    case = frame_case(load_frame(frame_file), "can", seed=0)
    assert len(case.world.bodies) == 2
    top = case.world.bodies[0].base_T_mesh.apply([0, 0, 0.06])
    height = case.world.cast([top + np.array([0, 0, 0.1])], [[0, 0, -1.0]])[0]
    assert height == pytest.approx(0.1, abs=0.002)
    beside = case.world.bodies[1].base_T_mesh.apply([0, 0, 0.05])
    assert case.world.cast([beside + np.array([0, 0, 0.1])], [[0, 0, -1.0]])[0] == pytest.approx(0.1, abs=0.002)


def test_the_offset_is_fixed_by_seed_and_object(frame_file: Path) -> None:
    frame = load_frame(frame_file)
    first = frame_case(frame, "can", seed=1)
    assert first.error(first.truth) == 0
    assert first.truth.is_close(frame_case(frame, "can", seed=1).truth, 0)
    assert not first.truth.is_close(frame_case(frame, "can", seed=2).truth, 1e-3)
    assert not first.truth.is_close(frame_case(frame, "box", seed=1).truth, 1e-3)


def test_an_unknown_object_names_those_that_exist(frame_file: Path) -> None:
    with pytest.raises(NotFound) as refused:
        frame_case(load_frame(frame_file), "teapot", seed=0)
    assert "box, can" in refused.value.remedy


def test_missing_and_broken_files_are_named(frame_file: Path, tmp_path: Path) -> None:
    with pytest.raises(NotFound, match="no frame"):
        load_frame(tmp_path / "other.json")
    (tmp_path / "text.json").write_text("hello")
    with pytest.raises(Malformed, match=r"text\.json is not JSON"):
        load_frame(tmp_path / "text.json")
    with pytest.raises(NotFound, match=r"names gone\.png"):
        load_frame(changed(frame_file, files={"depth": "gone.png", "label": "label.png"}))


@pytest.mark.parametrize(
    ("members", "what"),
    [
        ({"objects": []}, "names no object"),
        ({"objects": [{"name": "box"}]}, "T_cam_obj"),
        ({"width": 640}, "says"),
        ({"fx": 0}, "focal"),
        ({"files": {}}, "depth"),
    ],
)
def test_a_frame_that_does_not_fit_is_refused(frame_file: Path, members: dict[str, Any], what: str) -> None:
    with pytest.raises(InvalidInput, match=what):
        load_frame(changed(frame_file, **members))


@pytest.mark.skipif(not REAL.is_dir(), reason=f"no real frames at {REAL}; set PRETOUCH_SHARED")
def test_real_frames_agree_with_their_ground_truth() -> None:
    frame = load_frame(REAL / "0000_000001.json")
    for thing in frame.objects:
        case = frame_case(frame, thing.name, seed=0)
        camera = case.truth @ case.base_T_camera
        rays = case.truth.apply(case.cloud) - camera.translation
        hits = case.world.trace(np.broadcast_to(camera.translation, rays.shape), rays)
        assert (hits.bodies == 0).mean() > 0.99
        assert np.median(np.abs(hits.distances - 1) * np.linalg.norm(rays, axis=1)) < 0.0015
        assert 0.001 < case.error(Pose.identity()) < 0.05
