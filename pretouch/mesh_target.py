"""A known shape at its believed pose: the registrar's target instead of a depth image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pretouch.errors import InvalidInput, TooLarge
from pretouch.geometry import MAX_DISTANCE, Array, Plane, Pose, frozen_array

MAX_FACES = 1_000_000
MAX_EXTENT = 2.0
"""m: objects on a table are smaller; a mesh in millimetres is larger."""
_LEAST_AREA = 1e-8
"""m^2 that all triangles together must have: a tenth of a millimetre squared."""


@dataclass(frozen=True, eq=False)
class MeshTarget:
    """A triangle mesh on a table.

    Attributes:
        vertices: (n, 3), m, in the object's frame.
        faces: (m, 3) indices into `vertices`; either side may be outside.
        base_T_object: the object's believed pose; its error is what is estimated.
        table: in base, believed along with the object, normal away from the table.

    Raises:
        Malformed: a number is not finite.
        InvalidInput: no triangle with an area, a face that names a vertex that does not exist, or a size that no object
            on a table has.
        TooLarge: more than MAX_FACES faces, or three times as many vertices.
    """

    vertices: Array
    faces: NDArray[np.int64]
    base_T_object: Pose
    table: Plane

    def __post_init__(self) -> None:
        given = np.asarray(self.faces)
        if given.ndim != 2 or given.shape[1:] != (3,) or len(given) == 0 or given.dtype.kind not in "iu":
            raise InvalidInput(
                f"The mesh's faces are {given.dtype} numbers of shape {list(given.shape)}.",
                "Send a triangle mesh: m x 3 whole numbers, m at least 1.",
            )
        if len(given) > MAX_FACES or len(self.vertices) > 3 * MAX_FACES:
            raise TooLarge(
                f"The mesh has {len(given)} faces and {len(self.vertices)} vertices; the limit is {MAX_FACES} faces.",
                "Simplify the mesh: a millimetre is fine enough.",
            )
        vertices = frozen_array(self.vertices, (None, 3), "mesh vertices", MAX_DISTANCE)
        faces = given.astype(np.int64)
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise InvalidInput(
                f"A face of the mesh names vertex {faces.max() if faces.min() >= 0 else faces.min()}; "
                f"there are {len(vertices)}, the first is 0.",
                "Mend or re-export the mesh.",
            )
        corners = vertices[faces]
        extent = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
        if extent > MAX_EXTENT:
            raise InvalidInput(
                f"The mesh is {extent:.4g} m long; the limit is {MAX_EXTENT:g} m.", "Scale the mesh to metres."
            )
        crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        if 0.5 * np.linalg.norm(crosses, axis=1).sum() < _LEAST_AREA:
            raise InvalidInput(
                "The mesh's triangles have no area.", "Check that the mesh is in metres and not flattened to a line."
            )
        faces.setflags(write=False)
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)
