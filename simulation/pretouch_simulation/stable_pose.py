"""How an object stands on a table."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from pretouch.errors import InvalidInput
from pretouch.geometry import Array, Pose
from pretouch_simulation.mesh import Mesh

_CONTACT = 0.0015
"""m; vertices this near to the lowest one carry the object: scans are not perfectly flat below."""
_SLACK = 0.001
"""m by which the centre of mass may stand outside its support."""
_SAME_WAY = float(np.cos(np.radians(20.0)))
"""Cosine of the angle between two faces up to which resting on the one or the other is the same."""
_MOST_VERTICES = 20_000
"""A mesh with more vertices is reduced to its outermost ones."""
_FINENESS = 15
"""Fineness of the directions in which vertices are outermost: there are about 3000."""


def stand(mesh: Mesh) -> Mesh:
    """The mesh on z = 0, centred on x = y = 0: as it is if that is stable, else in its likeliest resting pose.

    The mass is assumed to fill the convex hull evenly. In the likeliest pose the mesh rests on the face of the hull
    that supports the centre of mass and has the largest solid angle seen from it: that approximates the probability
    that a dropped object comes to rest on the face.

    Raises:
        InvalidInput: the mesh is flat or a line.
    """
    vertices = _outermost(mesh.vertices)
    try:
        hull = ConvexHull(vertices)
    except QhullError as error:
        raise InvalidInput("The mesh has no volume.", "Give a mesh with extent in all three directions.") from error
    centre = _centre_of_mass(vertices, hull)
    if _stands(vertices, centre, np.array([0.0, 0.0, -1.0])):
        return mesh.resting()
    return _rest_on(mesh, _find_resting_faces(vertices, hull, centre)[0])


def find_resting_poses(mesh: Mesh, most: int) -> list[Mesh]:
    """The mesh in up to `most` resting poses: that of `stand` first, then the likeliest after a drop.

    Poses that differ by a turn about the vertical alone, or by less than 20 degrees, count once.

    Raises:
        InvalidInput: the mesh is flat or a line.
    """
    first = stand(mesh)
    vertices = _outermost(first.vertices)
    hull = ConvexHull(vertices)
    ways = [np.array([0.0, 0.0, -1.0])]
    for down in _find_resting_faces(vertices, hull, _centre_of_mass(vertices, hull)):
        if len(ways) < most and all(down @ way < _SAME_WAY for way in ways):
            ways.append(down)
    return [first, *(_rest_on(first, down) for down in ways[1:])][:most]


def _rest_on(mesh: Mesh, down: Array) -> Mesh:
    return mesh.moved(Pose.of(_rotate_down(down), np.zeros(3))).resting()


def _outermost(vertices: Array) -> Array:
    """(k, 3) of the vertices (n, 3): all of them, or of very many the outermost in each of about 3000 directions."""
    if len(vertices) <= _MOST_VERTICES:
        return vertices
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    out = (2.0 * vertices - low - high) / np.maximum(high - low, np.finfo(float).tiny)
    radii = np.linalg.norm(out, axis=1)
    cells = np.floor(_FINENESS * out / np.maximum(radii, np.finfo(float).tiny)[:, None]) @ [1.0, 1e3, 1e6]
    order = np.lexsort((radii, cells))
    return np.asarray(vertices[order[np.append(np.diff(cells[order]) != 0, True)]])


def _find_resting_faces(vertices: Array, hull: ConvexHull, centre: Array) -> list[Array]:
    """Unit directions (3,) of the hull's faces on which the mesh stands, the largest solid angle first."""
    share: dict[tuple[float, ...], float] = {}
    faces: dict[tuple[float, ...], Array] = {}
    for simplex, equation in zip(hull.simplices, hull.equations, strict=True):
        down = equation[:3]
        if _stands(vertices, centre, down):
            facet = tuple(np.round(down, 3))
            faces.setdefault(facet, down)
            share[facet] = share.get(facet, 0.0) + _solid_angle(vertices[simplex] - centre)
    return [faces[facet] for facet in sorted(share, key=lambda facet: -share[facet])]


def _centre_of_mass(vertices: Array, hull: ConvexHull) -> Array:
    """(3,), m: of the hull filled evenly, as a sum of tetrahedra from its vertices' mean."""
    middle = vertices[hull.vertices].mean(axis=0)
    corners = vertices[hull.simplices] - middle
    volumes = np.abs(np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])))
    return np.asarray(
        middle + (volumes[:, None] * corners.sum(axis=1)).sum(axis=0) / (4.0 * volumes.sum()), dtype=float
    )


def _stands(vertices: Array, centre: Array, down: Array) -> bool:
    """Whether the centre of mass is above the support polygon of the vertices that are lowest towards `down`."""
    depth = vertices @ down
    to_plane = _rotate_down(down)
    foot = (vertices[depth > depth.max() - _CONTACT] @ to_plane.T)[:, :2]
    mass = (to_plane @ centre)[:2]
    try:
        support = ConvexHull(foot)
    except (QhullError, ValueError):
        return False
    return bool((support.equations[:, :2] @ mass + support.equations[:, 2] < _SLACK).all())


def _rotate_down(down: Array) -> Array:
    """A rotation that takes the unit vector `down` to -z."""
    z = -down
    x = np.array([1.0, 0.0, 0.0]) if abs(z[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    x = x - z * (x @ z)
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def _solid_angle(triangle: Array) -> float:
    """sr: of a triangle (3, 3) seen from the origin (van Oosterom and Strackee, 1983)."""
    a, b, c = triangle
    la, lb, lc = np.linalg.norm(triangle, axis=1)
    scale = la * lb * lc + (a @ b) * lc + (b @ c) * la + (c @ a) * lb
    return float(abs(2.0 * np.arctan2(a @ np.cross(b, c), scale)))
