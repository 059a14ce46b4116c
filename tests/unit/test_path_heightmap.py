"""The believed surface contains what the camera saw, and bounds what it could not see."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.scenes import KINECT, Box, View, World, looking
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_orchestrator.perception.heightmap import HeightMap, build_height_map
from pretouch_orchestrator.perception.shadow import compute_shadow_ceiling
from scipy import ndimage

from pretouch.camera import DepthImage
from pretouch.geometry import Array, Plane, Pose
from pretouch.scene import Scene

REACH = 0.1


def at(covered: HeightMap, values: Array, x: float, y: float) -> float:
    return float(values[covered.index(np.array([x, y]))])


@settings(max_examples=20, deadline=None)
@given(
    sides=st.tuples(st.floats(0.03, 0.1), st.floats(0.03, 0.1), st.floats(0.02, 0.15)),
    hidden=st.tuples(st.floats(0.01, 0.06), st.floats(0.01, 0.06), st.floats(0.01, 0.15)),
    place=st.tuples(st.floats(-0.12, 0.12), st.floats(-0.12, 0.12)),
    yaw=st.floats(-3, 3),
    down=st.floats(25, 85),
    azimuth=st.floats(-180, 180),
)
def test_nothing_on_the_table_is_higher_than_believed_seen_or_not(
    sides: tuple[float, ...],
    hidden: tuple[float, ...],
    place: tuple[float, float],
    yaw: float,
    down: float,
    azimuth: float,
) -> None:
    world = World((Box.standing(sides, yaw=yaw), Box.standing(hidden, place, yaw / 2)))
    view = View(looking((0, 0, 0.02), 0.8, down, azimuth), KINECT.camera, KINECT.width, KINECT.height)
    depth, mask = world.depth(view)
    if mask.sum() < 60:
        return
    covered = build_height_map(Scene(depth, view.camera, view.base_T_camera, mask, world.table), REACH)
    x, y = covered.places()
    above = np.stack(np.broadcast_arrays(x, y, 1.0), axis=-1)
    down_beam = np.broadcast_to([0.0, 0.0, -1.0], above.shape)
    truth = 1.0 - world.cast(above, down_beam)[0]
    believed = ndimage.maximum_filter(covered.believed, 5)  # the pixel that shows a cell's edge may lie beside it
    assert (believed - truth).min() > -0.004


def test_behind_an_object_the_sight_line_over_its_edge_bounds_what_may_be_there() -> None:
    world = World((Box.standing((0.06, 0.1, 0.08)),))
    covered = build_height_map(world.scene(KINECT), REACH)
    camera = KINECT.base_T_camera.translation
    for behind in (0.02, 0.05, 0.09):
        x = 0.03 + behind
        sight = camera[2] - (camera[2] - 0.08) * (x - camera[0]) / (0.03 - camera[0])
        assert at(covered, covered.believed, x, 0.0) == pytest.approx(max(sight, 0.0), abs=0.006)
    assert at(covered, covered.believed, -0.08, 0.0) < 0.002
    assert at(covered, covered.believed, 0.0, -0.09) < 0.002
    assert np.isnan(at(covered, covered.seen, 0.06, 0.0))
    assert at(covered, covered.seen, 0.0, 0.0) == pytest.approx(0.08, abs=0.001)


def test_a_hole_is_as_high_as_what_surrounds_it() -> None:
    whole = World((Box.standing((0.1, 0.1, 0.06)),)).scene(KINECT)
    metres = whole.depth.metres.copy()
    u0, v0, u1, _ = whole.bounds()
    metres[v0 + 5 : v0 + 25, u0 + 10 : u1 - 10] = 0
    metres[v0 + 30 : v0 + 60, u0 - 50 : u0 - 20] = 0
    scene = Scene(DepthImage(metres), whole.camera, whole.base_T_camera, whole.mask, whole.table)
    covered, sound = build_height_map(scene, REACH), build_height_map(whole, REACH)
    np.testing.assert_allclose(covered.believed, sound.believed, atol=0.006)


def test_the_map_is_the_same_wherever_the_scene_stands_in_base() -> None:
    world = World((Box.standing((0.09, 0.05, 0.07), yaw=0.4),))
    depth, mask = world.depth(KINECT)
    here = Scene(depth, KINECT.camera, KINECT.base_T_camera, mask, world.table)
    there_T_here = Pose.from_rotation_vector((0.5, -1.0, 2.0), (1.0, -3.0, 0.5))
    there = Scene(depth, KINECT.camera, there_T_here @ KINECT.base_T_camera, mask, world.table.moved(there_T_here))
    a, b = build_height_map(here, REACH), build_height_map(there, REACH)
    for scene, covered in ((here, a), (there, b)):
        places = covered.base_T_table.inverse().apply(scene.cloud)
        assert (covered.object_distance[covered.index(places[:, :2])] == 0).all()
        assert (covered.believed[covered.index(places[:, :2])] >= places[:, 2] - 1e-9).all()
    assert a.believed.max() == pytest.approx(b.believed.max(), abs=1e-4)
    assert a.believed.mean() == pytest.approx(b.believed.mean(), rel=0.2)


def test_a_large_object_gets_larger_cells() -> None:
    world = World((Box.standing((0.6, 0.5, 0.05)),))
    view = View(looking((0, 0, 0.02), 1.5, 60))
    covered = build_height_map(world.scene(view), REACH)
    assert max(covered.believed.shape) <= 257
    assert covered.cell > 0.002


@pytest.mark.parametrize("height", [-0.3, 0.02, 0.05])
def test_a_camera_below_the_top_of_things_sees_nothing_higher_behind_them(height: float) -> None:
    heights = np.zeros((40, 40))
    heights[15:20, 10:30] = 0.1
    ceiling = compute_shadow_ceiling(heights, 0.005, np.array([-0.5, 0.1, height]))
    assert ceiling.shape == heights.shape
    assert ceiling.max() <= 0.1
    assert (ceiling[22:, 15:25] == pytest.approx(0.1)) or height < 0


def test_a_camera_straight_above_casts_shadows_outwards() -> None:
    heights = np.zeros((81, 81))
    heights[8:12, 30:51] = 0.1
    ceiling = compute_shadow_ceiling(heights, 0.002, np.array([0.08, 0.08, 0.5]))
    assert ceiling[6, 40] == pytest.approx(0.5 - 0.068 * 0.4 / 0.065, abs=0.004)
    assert ceiling[14, 40] <= 0.0


def test_a_table_in_any_attitude_is_borne() -> None:
    scene = World((Box.standing((0.08, 0.08, 0.05)),)).scene()
    for normal in ([0, 0, -1.0], [1.0, 0, 0], [0, 1.0, 0]):
        tilted = Scene(scene.depth, scene.camera, scene.base_T_camera, scene.mask, Plane(np.array(normal), 0.1))
        assert np.isfinite(build_height_map(tilted, REACH).believed).all()
