"""Triangle meshes: metres, z up, resting on z = 0."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pretouch.errors import InvalidInput, Malformed, NotFound
from pretouch.geometry import Array, Pose, frozen_array

SUFFIXES = (".ply", ".obj", ".stl")
MAX_EXTENT = 2.0
"""m; a tabletop object is smaller, a mesh in millimetres is larger."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh.

    Attributes:
        vertices: (n, 3), m.
        faces: (m, 3) indices into `vertices`, counter-clockwise seen from outside.

    Raises:
        InvalidInput: no face, or a face names a vertex that does not exist.
    """

    vertices: Array
    faces: NDArray[np.int64]

    def __post_init__(self) -> None:
        vertices = frozen_array(self.vertices, (None, 3), "mesh vertices")
        faces = np.array(self.faces, dtype=np.int64)
        if faces.ndim != 2 or faces.shape[1:] != (3,) or len(faces) == 0:
            raise InvalidInput("The mesh has no triangles.", "Give a triangle mesh with one face or more.")
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise InvalidInput("A face of the mesh names a vertex that does not exist.", "Mend or re-export the mesh.")
        faces.setflags(write=False)
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)

    @property
    def extents(self) -> Array:
        """(3,), m: the sides of the bounding box."""
        return np.asarray(np.ptp(self.vertices, axis=0), dtype=np.float64)

    @property
    def watertight(self) -> bool:
        """Whether each directed edge has exactly one opposite, vertices at the same place being one."""
        _, index = np.unique(self.vertices.round(7), axis=0, return_inverse=True)
        corners = index.reshape(-1)[self.faces]
        edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
        edges = edges[edges[:, 0] != edges[:, 1]]
        forward, counts = np.unique(edges, axis=0, return_counts=True)
        backward = np.unique(edges[:, ::-1], axis=0)
        return bool((counts == 1).all() and np.array_equal(forward, backward))

    def volume(self) -> float:
        """m^3, by the divergence theorem; meaningful for a watertight mesh, negative if it is inside out."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)

    def moved(self, a_T_mesh: Pose) -> Mesh:
        return Mesh(a_T_mesh.apply(self.vertices), self.faces)

    def resting(self) -> Mesh:
        """The same mesh standing on z = 0, its bounding box centred on x = y = 0."""
        low, high = self.vertices.min(axis=0), self.vertices.max(axis=0)
        return Mesh(self.vertices - [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]], self.faces)

    @staticmethod
    def joined(parts: list[Mesh]) -> Mesh:
        """The parts side by side in one mesh; they may overlap."""
        starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
        return Mesh(
            np.concatenate([part.vertices for part in parts]),
            np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=False)]),
        )


def load_mesh(path: Path) -> Mesh:
    """Reads a PLY, OBJ or STL file, in metres.

    Raises:
        NotFound: no such file.
        InvalidInput: another suffix, or an object larger than `MAX_EXTENT`: probably not in metres.
        Malformed: the file cannot be read, or holds no triangles.
    """
    if not path.is_file():
        raise NotFound(f"There is no mesh {path}.", "Check the path.")
    if path.suffix.lower() not in SUFFIXES:
        raise InvalidInput(
            f"{path.name} is not a mesh that can be read.", f"Give one of {', '.join(SUFFIXES)}, in metres."
        )
    import trimesh

    try:
        read = trimesh.load_mesh(path, process=False)
    except Exception as error:  # trimesh fails in any way on damaged files
        raise Malformed(
            f"{path.name} holds no triangles that can be read: {error}.", "Export it as a triangle mesh."
        ) from error
    if not isinstance(read, trimesh.Trimesh) or not len(read.faces):
        raise Malformed(f"{path.name} holds no triangles.", "Export it as a triangle mesh.")
    mesh = Mesh(read.vertices, read.faces)
    if mesh.extents.max() > MAX_EXTENT:
        raise InvalidInput(
            f"{path.name} is {mesh.extents.max():.3g} m long; a tabletop object is at most {MAX_EXTENT:g} m.",
            "Scale the mesh to metres.",
        )
    return mesh
