"""What beams can meet: rigid bodies and the infinite plane of the table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pretouch.errors import InvalidInput, NotFound
from pretouch.geometry import Array, Plane, Pose
from pretouch_simulation.bvh import Triangles
from pretouch_simulation.mesh import Mesh

TABLE = -1
NOTHING = -2


@dataclass(frozen=True, eq=False)
class Body:
    """A mesh at its place in base."""

    mesh: Mesh
    base_T_mesh: Pose


@dataclass(frozen=True, eq=False)
class Hits:
    """Where rays end.

    Attributes:
        distances: (n,), in lengths of the ray's direction (m for unit directions); inf = nothing.
        normals: (n, 3), unit, in base, towards the ray's origin; zero where nothing was met.
        bodies: (n,) index of the body met, `TABLE` or `NOTHING`.
    """

    distances: Array
    normals: Array
    bodies: NDArray[np.int64]


class World:
    """Rigid bodies on a table, all in base.

    Args:
        bodies: what stands on the table; may be empty.
        table: an infinite plane, normal up.
    """

    def __init__(self, bodies: Sequence[Body], table: Plane) -> None:
        self.bodies = tuple(bodies)
        self.table = table

    @cached_property
    def _triangles(self) -> tuple[Triangles, NDArray[np.int64]]:
        """All bodies' triangles, and (faces,) the body of each."""
        meshes = [body.mesh.moved(body.base_T_mesh) for body in self.bodies]
        joined = Mesh.joined(meshes)
        owners = np.repeat(np.arange(len(meshes)), [len(mesh.faces) for mesh in meshes])
        return Triangles(joined.vertices, joined.faces), owners

    def cast(self, origins: ArrayLike, directions: ArrayLike) -> Array:
        """Distances (n,) along rays from `origins` (n, 3), m, in `directions` (n, 3), both in base; inf = nothing.

        The unit is the length of the ray's direction. Faces stop a ray from either side.
        """
        return self.trace(origins, directions).distances

    def trace(self, origins: ArrayLike, directions: ArrayLike) -> Hits:
        """As `cast`, with what was met."""
        start, way = np.asarray(origins, dtype=np.float64), np.asarray(directions, dtype=np.float64)
        table = self._table_distances(start, way)
        distances, normals = table.copy(), np.tile(self.table.normal, (len(start), 1))
        bodies = np.where(np.isfinite(table), TABLE, NOTHING)
        if self.bodies and len(start):
            triangles, owners = self._triangles
            near, faces = triangles.cast(start, way)
            first = near < table
            distances[first] = near[first]
            normals[first] = triangles.normals[faces[first]]
            bodies[first] = owners[faces[first]]
        normals[bodies == NOTHING] = 0.0
        normals[np.einsum("ij,ij->i", normals, way) > 0] *= -1
        return Hits(distances, normals, bodies)

    def _table_distances(self, origins: Array, directions: Array) -> Array:
        approach = -(directions @ self.table.normal)
        height = self.table.height(origins)
        distances = np.full(len(origins), np.inf)
        np.divide(height, approach, out=distances, where=approach != 0)
        distances[distances <= 0] = np.inf
        return distances

    def save(self, path: Path) -> None:
        """Writes an .npz that `load` reads back to the same world."""
        arrays: dict[str, Any] = {
            "bodies": np.array(len(self.bodies)),
            "table": np.append(self.table.normal, self.table.offset),
        }
        for k, body in enumerate(self.bodies):
            arrays[f"vertices_{k}"] = body.mesh.vertices
            arrays[f"faces_{k}"] = body.mesh.faces
            arrays[f"base_T_mesh_{k}"] = body.base_T_mesh.matrix
        with path.open("wb") as file:
            np.savez_compressed(file, **arrays)

    @staticmethod
    def load(path: Path) -> World:
        """Reads what `save` wrote.

        Raises:
            NotFound: no such file.
            InvalidInput: not a world.
        """
        if not path.is_file():
            raise NotFound(f"There is no world file {path}.", "Write one with World.save.")
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
                bodies = [
                    Body(Mesh(arrays[f"vertices_{k}"], arrays[f"faces_{k}"]), Pose(arrays[f"base_T_mesh_{k}"]))
                    for k in range(int(arrays["bodies"]))
                ]
                return World(bodies, Plane(arrays["table"][:3], arrays["table"][3]))
        except (OSError, EOFError, BadZipFile, ValueError, KeyError, AttributeError, TypeError) as error:
            raise InvalidInput(f"{path.name} is not a world file.", "Write one with World.save.") from error
