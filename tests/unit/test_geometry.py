"""Poses, planes and rectangles obey the axioms of their groups; bad values are refused with a reason."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pretouch.errors import InvalidInput, Malformed
from pretouch.geometry import (
    Plane,
    Pose,
    interpolate,
    quaternion_from_rotation,
    rotation_from_quaternion,
    rotation_from_vector,
    vector_from_rotation,
)
from pretouch.rectangle import RotatedRectangle
from pretouch.trajectory import Trajectory

vectors = arrays(np.float64, 3, elements=st.floats(-2, 2, allow_subnormal=False))
poses = st.builds(Pose.from_rotation_vector, vectors, vectors)
rectangles = st.builds(
    RotatedRectangle, st.floats(0, 600), st.floats(0, 400), st.floats(1, 200), st.floats(1, 200), st.floats(-10, 10)
)


@given(poses, poses, poses)
def test_poses_form_a_group(a: Pose, b: Pose, c: Pose) -> None:
    assert ((a @ b) @ c).is_close(a @ (b @ c), 1e-9)
    assert (a @ a.inverse()).is_close(Pose.identity(), 1e-9)


@given(poses, poses, arrays(np.float64, (5, 3), elements=st.floats(-1, 1)))
def test_applying_a_product_is_applying_twice(a: Pose, b: Pose, points: np.ndarray) -> None:
    np.testing.assert_allclose((a @ b).apply(points), a.apply(b.apply(points)), atol=1e-9)


@given(vectors.filter(lambda v: np.linalg.norm(v) < 3.1))
def test_exp_and_log_are_inverse(vector: np.ndarray) -> None:
    np.testing.assert_allclose(vector_from_rotation(rotation_from_vector(vector)), vector, atol=1e-7)


@given(poses)
def test_quaternions_give_their_rotation_back(pose: Pose) -> None:
    np.testing.assert_allclose(
        rotation_from_quaternion(quaternion_from_rotation(pose.rotation)), pose.rotation, atol=1e-9
    )
    assert Pose.from_quaternion(pose.translation, pose.quaternion).is_close(pose, 1e-9)


@given(poses, poses, st.floats(0, 1))
def test_interpolation_meets_its_ends_and_turns_evenly(a: Pose, b: Pose, share: float) -> None:
    assert interpolate(a, b, 0).is_close(a, 1e-7)
    assert interpolate(a, b, 1).is_close(b, 1e-7)
    whole = np.linalg.norm(vector_from_rotation(a.rotation.T @ b.rotation))
    part = np.linalg.norm(vector_from_rotation(a.rotation.T @ interpolate(a, b, share).rotation))
    assert part == pytest.approx(share * whole, abs=1e-6)


@given(poses, vectors.filter(lambda v: np.linalg.norm(v) > 0.1), vectors)
def test_a_plane_moves_with_its_points(pose: Pose, normal: np.ndarray, point: np.ndarray) -> None:
    plane = Plane(normal / np.linalg.norm(normal), 0.1)
    assert plane.moved(pose).height(pose.apply(point)) == pytest.approx(plane.height(point), abs=1e-9)
    frame = plane.frame()
    assert plane.height(frame.translation) == pytest.approx(0, abs=1e-9)
    assert plane.height(frame.apply([0.3, -0.2, 0.5])) == pytest.approx(0.5, abs=1e-9)


@pytest.mark.parametrize("norm", [0.99, 1.01, 0.0])
def test_a_quaternion_that_is_not_unit_is_refused(norm: float) -> None:
    with pytest.raises(InvalidInput, match="norm"):
        Pose.from_quaternion([0, 0, 0], [0, 0, 0, norm])


def test_a_nearly_unit_quaternion_is_normalised() -> None:
    pose = Pose.from_quaternion([0, 0, 0], [0, 0, 0, 1.0009])
    assert pose.is_close(Pose.identity())


@pytest.mark.parametrize("bad", [np.full((4, 4), np.nan), np.diag([1.0, 1, -1, 1]), np.diag([2.0, 1, 1, 1])])
def test_a_matrix_that_is_not_rigid_is_refused(bad: np.ndarray) -> None:
    with pytest.raises((InvalidInput, Malformed)):
        Pose(bad)


@given(rectangles)
def test_a_rectangles_perimeter_lies_on_the_rectangle(rectangle: RotatedRectangle) -> None:
    assert -np.pi / 2 <= rectangle.theta < np.pi / 2
    perimeter = rectangle.perimeter(2.0)
    np.testing.assert_allclose(rectangle.distance(perimeter), 0, atol=1e-6)
    np.testing.assert_allclose(perimeter[0], perimeter[-1])
    steps = np.linalg.norm(np.diff(perimeter, axis=0), axis=1)
    assert steps.max() <= 2.0 + 1e-9
    assert steps.sum() == pytest.approx(2 * (rectangle.w + rectangle.h), rel=1e-6)
    assert rectangle.distance((rectangle.x, rectangle.y)) == pytest.approx(-min(rectangle.w, rectangle.h) / 2)


@given(rectangles)
def test_half_a_turn_leaves_a_rectangle_as_it_is(rectangle: RotatedRectangle) -> None:
    turned = RotatedRectangle(rectangle.x, rectangle.y, rectangle.w, rectangle.h, rectangle.theta + np.pi)
    np.testing.assert_allclose(np.abs(turned.distance(rectangle.corners())), 0, atol=1e-6)


@given(st.lists(poses, min_size=2, max_size=6), st.floats(0, 1), st.floats(0, 1))
def test_a_piece_of_a_path_is_at_the_same_place_at_the_same_time(some: list[Pose], one: float, other: float) -> None:
    path = Trajectory(1.0 + np.arange(len(some)) * 0.5, np.stack([pose.matrix for pose in some]))
    start, end = 1.0 + path.duration * min(one, other), 1.0 + path.duration * max(one, other)
    piece = path.between(start, end)
    assert (piece.t[0], piece.t[-1]) == (start, end)
    times = np.linspace(start, end, 7)
    np.testing.assert_allclose(piece.at(times)[:, :3, 3], path.at(times)[:, :3, 3], atol=1e-6)
