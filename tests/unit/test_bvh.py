"""Rays and closest points of a bounding volume hierarchy agree with a test of every triangle, and rays leak nowhere."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from pretouch_simulation.bvh import NO_FACE, Triangles
from pretouch_simulation.mesh import Mesh
from pretouch_simulation.objects import MAKERS, box

from pretouch.geometry import Array

AXES = np.concatenate([np.eye(3), -np.eye(3)])


def soup(rng: np.random.Generator, count: int, degenerate: bool = False) -> tuple[Array, NDArray[np.int64]]:
    """Triangles of mixed sizes; with `degenerate` every third is a segment and every fifth a point."""
    corners = rng.uniform(-1, 1, (count, 1, 3)) + rng.normal(0, 1, (count, 3, 3)) * rng.choice(
        [0.02, 0.6], (count, 1, 1)
    )
    if degenerate:
        corners[::3, 2] = corners[::3, 0] + 0.3 * (corners[::3, 1] - corners[::3, 0])
        corners[::5] = corners[::5, :1]
    return corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


def moeller_trumbore(corners: Array, origin: Array, direction: Array) -> tuple[float, int, float]:
    """Distance and triangle of the first hit, inf and -1 without one, and how far from any edge the ray stays."""
    edge_1, edge_2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(direction, edge_2)
    determinant = np.einsum("ij,ij->i", edge_1, across)
    offset = (origin - corners[:, 0]) / determinant[:, None]
    u = np.einsum("ij,ij->i", offset, across)
    turned = np.cross(offset, edge_1)
    v = turned @ direction
    distance = np.einsum("ij,ij->i", turned, edge_2)
    inside = np.minimum(np.minimum(u, v), 1 - u - v)
    hit = np.where((inside > 0) & (distance > 0), distance, np.inf)
    nearest = int(hit.argmin())
    return float(hit[nearest]), nearest if hit[nearest] < np.inf else NO_FACE, float(np.abs(inside).min())


def closest_by_hand(corners: Array, point: Array) -> float:
    """The least distance: to each plane where the foot lies inside, and to each side."""
    distances = []
    for triangle in corners:
        for a, b in zip(triangle, np.roll(triangle, -1, axis=0), strict=True):
            share = np.clip((point - a) @ (b - a) / max((b - a) @ (b - a), 1e-300), 0, 1)
            distances.append(np.linalg.norm(point - a - share * (b - a)))
        sides = np.stack([triangle[1] - triangle[0], triangle[2] - triangle[0]], axis=1)
        weights = np.linalg.lstsq(sides, point - triangle[0], rcond=None)[0]
        if weights.min() >= 0 and weights.sum() <= 1:
            distances.append(np.linalg.norm(point - triangle[0] - sides @ weights))
    return float(min(distances))


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 60))
def test_the_first_hit_is_that_of_all_triangles_tested(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    vertices, faces = soup(rng, count)
    origins = rng.uniform(-2, 2, (20, 3))
    directions = np.concatenate([rng.normal(0, 1, (14, 3)), AXES])
    distances, hits = Triangles(vertices, faces).cast(origins, directions)
    for k in range(20):
        distance, face, margin = moeller_trumbore(vertices[faces], origins[k], directions[k])
        assume(margin > 1e-9)
        assert hits[k] == face
        assert distances[k] == pytest.approx(distance, rel=1e-9)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 40), st.booleans())
def test_the_closest_place_is_that_of_all_triangles_tested(seed: int, count: int, degenerate: bool) -> None:
    rng = np.random.default_rng(seed)
    vertices, faces = soup(rng, count, degenerate)
    points = rng.uniform(-2, 2, (8, 3))
    triangles = Triangles(vertices, faces)
    places, found = triangles.closest(points)
    for point, place, face in zip(points, places, found, strict=True):
        distance = closest_by_hand(vertices[faces], point)
        assert np.linalg.norm(point - place) == pytest.approx(distance, abs=1e-9)
        assert closest_by_hand(vertices[faces[face]][None], place) == pytest.approx(0.0, abs=1e-9)


def _inside(mesh: Mesh, face: int) -> Array:
    a, b, c = mesh.vertices[mesh.faces[face]]
    normal = np.cross(b - a, c - a)
    return np.asarray((a + b + c) / 3 - 1e-7 * normal / np.linalg.norm(normal))


@settings(max_examples=40, deadline=None)
@given(st.sampled_from(sorted(MAKERS)), st.integers(0, 2**32 - 1))
def test_no_ray_leaves_a_closed_mesh_through_an_edge_or_a_corner(name: str, seed: int) -> None:
    mesh = MAKERS[name]()
    rng = np.random.default_rng(seed)
    start = _inside(mesh, int(rng.integers(len(mesh.faces))))
    corners = mesh.vertices[mesh.faces]
    share = rng.uniform(0, 1, (len(corners), 1))
    targets = np.concatenate([mesh.vertices, share * corners[:, 0] + (1 - share) * corners[:, 1], corners.mean(axis=1)])
    directions = np.concatenate([targets - start, AXES])
    distances, _ = Triangles(mesh.vertices, mesh.faces).cast(np.tile(start, (len(directions), 1)), directions)
    assert np.isfinite(distances).all()


def test_rays_along_the_sides_and_through_the_edges_of_a_box_meet_it() -> None:
    mesh = box(0.1, 0.06, 0.14)
    x, y = np.meshgrid([-0.05, 0.0, 0.05], [-0.03, 0.0, 0.03])
    origins = np.stack([x.ravel(), y.ravel(), np.full(9, 0.5)], axis=1)
    distances, _ = Triangles(mesh.vertices, mesh.faces).cast(origins, np.tile([0.0, 0.0, -1.0], (9, 1)))
    np.testing.assert_allclose(distances, 0.36, atol=1e-12)


def test_faces_without_area_are_never_met() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0]], dtype=float)
    triangles = Triangles(vertices, [[0, 1, 2], [0, 0, 0], [1, 1, 3]])
    distances, faces = triangles.cast([[0.5, 0, 1], [0, 0, 1], [0.5, 0, 0]], [[0, 0, -1], [0, 0, -1], [1, 0, 0]])
    assert np.isinf(distances).all()
    assert (faces == NO_FACE).all()
    assert (triangles.normals == 0).all()


def test_a_ray_without_direction_and_one_of_nan_meet_nothing() -> None:
    mesh = box()
    distances, _ = Triangles(mesh.vertices, mesh.faces).cast(np.zeros((2, 3)), [[0, 0, 0], [np.nan, 0, 1]])
    assert np.isinf(distances).all()


def test_distances_are_in_lengths_of_the_direction_and_normals_point_outwards() -> None:
    mesh = box(0.1, 0.06, 0.14)
    triangles = Triangles(mesh.vertices, mesh.faces)
    distances, faces = triangles.cast([[0.01, 0.02, 0.5]] * 2, [[0, 0, -1], [0, 0, -4]])
    np.testing.assert_allclose(distances, [0.36, 0.09], atol=1e-12)
    np.testing.assert_allclose(triangles.normals[faces], [[0, 0, 1], [0, 0, 1]], atol=1e-12)


def test_each_ray_has_the_same_answer_alone_and_from_two_threads() -> None:
    rng = np.random.default_rng(0)
    mesh = MAKERS["mug"]()
    triangles = Triangles(mesh.vertices, mesh.faces)
    origins = rng.uniform([-0.1, -0.1, 0.2], [0.1, 0.1, 0.3], (400, 3))
    directions = rng.normal(0, 0.2, (400, 3)) - [0, 0, 1]
    whole, _ = triangles.cast(origins, directions)
    with ThreadPoolExecutor(2) as threads:
        parts = threads.map(lambda k: triangles.cast(origins[k : k + 1], directions[k : k + 1])[0], range(400))
        np.testing.assert_array_equal(whole, np.concatenate(list(parts)))
