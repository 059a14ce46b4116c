"""Rigid poses in SE(3), planes, and the interpolation between poses.

`a_T_b` maps a point in frame b to frame a. Metres, radians, right-handed; quaternions are `xyzw`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pretouch.errors import InvalidInput, Malformed

Array = NDArray[np.float64]
Vector3 = Annotated[Array, (3,)]
Vector6 = Annotated[Array, (6,)]
Matrix6 = Annotated[Array, (6, 6)]
Matrix12 = Annotated[Array, (12, 12)]
Points3 = Annotated[Array, (None, 3)]
"""Arrays whose shape is part of the contract: `pretouch.wire` reads it from the annotation. None: any length."""

QUATERNION_NORM_TOLERANCE = 1e-3
"""A quaternion whose norm is within this of 1 is normalised; any other is refused."""
MAX_DISTANCE = 1e6
"""m: largest distance from a frame's origin; farther away, rounding errors would exceed the precision needed."""
_ORTHONORMAL_TOLERANCE = 1e-4
_UNIT_TOLERANCE = 1e-12
"""A normal whose length is within this of 1 is left as it is."""


def frozen_array(values: ArrayLike, shape: tuple[int | None, ...], name: str, limit: float = np.inf) -> Array:
    """A read-only float64 copy of `values`, checked.

    Args:
        values: anything numpy can turn into numbers.
        shape: the shape wanted; None stands for any length.
        name: what the values are called in the error.
        limit: the largest magnitude that makes sense.

    Raises:
        Malformed: not numbers, or not finite.
        InvalidInput: of another shape, or beyond the limit.
    """
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise Malformed(f"{name} is not made of numbers.", f"Send {name} as numbers.") from error
    if array.ndim != len(shape) or any(want not in (None, got) for want, got in zip(shape, array.shape, strict=True)):
        wanted = " x ".join("n" if n is None else str(n) for n in shape)
        raise InvalidInput(f"{name} has shape {list(array.shape)}, not {wanted}.", f"Send {name} as {wanted} numbers.")
    if not np.isfinite(array).all():
        raise Malformed(f"{name} holds NaN or infinity.", f"Send finite numbers for {name}.")
    if limit < np.inf and (np.abs(array) > limit).any():
        raise InvalidInput(
            f"{name} holds {array.flat[np.abs(array).argmax()]:g}; the limit is {limit:g}.",
            f"Check the units of {name}.",
        )
    array.setflags(write=False)
    return array


def rotation_from_vector(rotation_vector: ArrayLike) -> Array:
    """exp: rotation vector (3,), rad, to a 3x3 matrix."""
    return np.asarray(rotations_from_vectors(np.asarray(rotation_vector, dtype=np.float64)[None])[0], dtype=np.float64)


def rotations_from_vectors(rotation_vectors: ArrayLike) -> Array:
    """exp: rotation vectors (n, 3), rad, to matrices (n, 3, 3) (Rodrigues' formula)."""
    vectors = np.asarray(rotation_vectors, dtype=np.float64)
    x, y, z = vectors.T
    zero = np.zeros(len(vectors))
    k = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    half = angle / 2
    rotations = np.eye(3) + np.sinc(angle / np.pi) * k + 0.5 * np.sinc(half / np.pi) ** 2 * (k @ k)
    return np.asarray(rotations, dtype=np.float64)


def vector_from_rotation(rotation: ArrayLike) -> Array:
    """log: 3x3 rotation matrix to its rotation vector (3,), rad, of length at most pi."""
    x, y, z, w = quaternion_from_rotation(rotation)
    if w < 0:
        x, y, z, w = -x, -y, -z, -w
    sine = float(np.sqrt(x * x + y * y + z * z))
    if sine < 1e-9:
        return 2.0 * np.array([x, y, z])
    return np.asarray(2.0 * np.arctan2(sine, w) / sine * np.array([x, y, z]), dtype=np.float64)


def rotation_from_quaternion(xyzw: ArrayLike) -> Array:
    """Unit quaternion (4,) `xyzw` to a 3x3 matrix."""
    x, y, z, w = np.asarray(xyzw, dtype=np.float64)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_from_rotation(rotation: ArrayLike) -> Array:
    """3x3 rotation matrix to its unit quaternion (4,) `xyzw` (Shepperd's method: the largest element first)."""
    m = np.asarray(rotation, dtype=np.float64)
    squares = np.array(
        [
            1 + m[0, 0] - m[1, 1] - m[2, 2],
            1 - m[0, 0] + m[1, 1] - m[2, 2],
            1 - m[0, 0] - m[1, 1] + m[2, 2],
            1 + m[0, 0] + m[1, 1] + m[2, 2],
        ]
    )
    largest = int(np.argmax(squares))
    products = np.array(
        [
            [squares[0], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[2, 1] - m[1, 2]],
            [m[0, 1] + m[1, 0], squares[1], m[1, 2] + m[2, 1], m[0, 2] - m[2, 0]],
            [m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], squares[2], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], squares[3]],
        ]
    )
    quaternion: Array = products[largest] / np.linalg.norm(products[largest])
    return quaternion


def is_rigid(matrices: Array) -> NDArray[np.bool_]:
    """(...,) True where a matrix (..., 4, 4) is a right-handed rotation and translation with last row 0 0 0 1."""
    rotations = matrices[..., :3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        gram = rotations @ np.swapaxes(rotations, -1, -2)
        orthonormal = np.abs(gram - np.eye(3)).max(axis=(-1, -2)) <= _ORTHONORMAL_TOLERANCE
        right_handed = np.linalg.det(rotations) > 0
    last_row = np.abs(matrices[..., 3, :] - (0, 0, 0, 1)).max(axis=-1) <= 1e-9
    return np.asarray(orthonormal & right_handed & last_row)


def check_poses(matrices: Array, name: str) -> None:
    """Raises `InvalidInput` if a matrix of (n, 4, 4) is no pose; `name` with its number is what the error calls it."""
    crooked = np.flatnonzero(~is_rigid(matrices))
    if len(crooked):
        raise InvalidInput(
            f"{name}[{crooked[0]}].base_T_tip is not a rigid transform.",
            "Send the tip's pose in base, z along the beam.",
        )


@dataclass(frozen=True, eq=False)
class Pose:
    """A rigid transform `a_T_b`.

    Attributes:
        matrix: 4x4 row-major homogeneous matrix, read-only.

    Raises:
        InvalidInput: not a rigid transform.
    """

    matrix: Array

    def __post_init__(self) -> None:
        matrix = frozen_array(self.matrix, (4, 4), "pose matrix")
        if not is_rigid(matrix):
            raise InvalidInput(
                "The pose matrix is not a rigid transform.",
                "Send a 4x4 row-major matrix with a right-handed orthonormal rotation and last row 0 0 0 1.",
            )
        object.__setattr__(self, "matrix", matrix)

    @staticmethod
    def identity() -> Pose:
        return Pose(np.eye(4))

    @staticmethod
    def of(rotation: ArrayLike, translation: ArrayLike) -> Pose:
        """From a 3x3 rotation and a translation (3,), m."""
        matrix = np.eye(4)
        matrix[:3, :3] = rotation
        matrix[:3, 3] = translation
        return Pose(matrix)

    @staticmethod
    def from_quaternion(translation: ArrayLike, xyzw: ArrayLike) -> Pose:
        """From a translation (3,), m, and a quaternion (4,) `xyzw` of norm 1 +- 1e-3.

        Raises:
            InvalidInput: the quaternion's norm is off.
        """
        quaternion = frozen_array(xyzw, (4,), "rotation")
        norm = float(np.linalg.norm(quaternion))
        if abs(norm - 1.0) > QUATERNION_NORM_TOLERANCE:
            raise InvalidInput(
                f"The rotation {quaternion.tolist()} has norm {norm:.6g}, not 1.",
                "Send a unit quaternion in the order x, y, z, w.",
            )
        return Pose.of(rotation_from_quaternion(quaternion / norm), frozen_array(translation, (3,), "translation"))

    @staticmethod
    def from_rotation_vector(rotation_vector: ArrayLike, translation: ArrayLike) -> Pose:
        """From a rotation vector (3,), rad, and a translation (3,), m."""
        return Pose.of(rotation_from_vector(rotation_vector), translation)

    @property
    def rotation(self) -> Array:
        """3x3."""
        return self.matrix[:3, :3]

    @property
    def translation(self) -> Array:
        """(3,), m."""
        return self.matrix[:3, 3]

    @property
    def quaternion(self) -> Array:
        """(4,) `xyzw`, unit."""
        return quaternion_from_rotation(self.rotation)

    def __matmul__(self, other: Pose) -> Pose:
        """`a_T_b @ b_T_c` is `a_T_c`; the product is made orthonormal again."""
        u, _, vt = np.linalg.svd(self.rotation @ other.rotation)
        return Pose.of(u @ vt, self.rotation @ other.translation + self.translation)

    def inverse(self) -> Pose:
        return Pose.of(self.rotation.T, -self.rotation.T @ self.translation)

    def apply(self, points: ArrayLike) -> Array:
        """Points (..., 3) in frame b, to frame a."""
        moved: Array = np.asarray(points, dtype=np.float64) @ self.rotation.T + self.translation
        return moved

    def rotate(self, vectors: ArrayLike) -> Array:
        """Directions (..., 3) in frame b, to frame a."""
        turned: Array = np.asarray(vectors, dtype=np.float64) @ self.rotation.T
        return turned

    def is_close(self, other: Pose, tolerance: float = 1e-9) -> bool:
        return bool(np.abs(self.matrix - other.matrix).max() <= tolerance)


def interpolate(start: Pose, end: Pose, share: float) -> Pose:
    """Straight line and slerp: `start` at share 0, `end` at share 1."""
    turn = vector_from_rotation(start.rotation.T @ end.rotation)
    rotation = start.rotation @ rotation_from_vector(share * turn)
    return Pose.of(rotation, (1.0 - share) * start.translation + share * end.translation)


@dataclass(frozen=True, eq=False)
class Plane:
    """The plane of all p with normal . p = offset.

    Attributes:
        normal: unit normal (x, y, z) in the plane's frame, which is base for a table; it points away from the table.
        offset: distance of the plane from the frame's origin along the normal, in metres.

    Raises:
        Malformed: a value is not finite.
        InvalidInput: the normal is not of unit length.
    """

    normal: Vector3
    offset: float

    def __post_init__(self) -> None:
        normal = frozen_array(self.normal, (3,), "plane normal")
        norm = float(np.linalg.norm(normal))
        if abs(norm - 1.0) > 1e-3:
            raise InvalidInput(f"The plane normal {normal.tolist()} has norm {norm:.6g}, not 1.", "Send a unit normal.")
        if abs(norm - 1.0) > _UNIT_TOLERANCE:  # what is read back stays equal to the bit, and its hash with it
            normal = frozen_array(normal / norm, (3,), "plane normal")
        object.__setattr__(self, "normal", normal)
        object.__setattr__(self, "offset", float(frozen_array(self.offset, (), "plane offset")))

    def height(self, points: ArrayLike) -> Array:
        """Signed distance (...,), m, of points (..., 3); positive on the normal's side."""
        return np.asarray(np.asarray(points, dtype=np.float64) @ self.normal - self.offset, dtype=np.float64)

    def moved(self, a_T_b: Pose) -> Plane:
        """This plane, given in frame b, in frame a."""
        normal = a_T_b.rotate(self.normal)
        return Plane(normal, float(self.offset + normal @ a_T_b.translation))

    def frame(self) -> Pose:
        """`base_T_plane`: origin at the foot of base's origin, z along the normal, x as near to base x as can be."""
        z = self.normal
        x = np.array([1.0, 0.0, 0.0]) if abs(z[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
        x = x - z * (x @ z)
        x = x / np.linalg.norm(x)
        return Pose.of(np.stack([x, np.cross(z, x), z], axis=1), z * self.offset)
