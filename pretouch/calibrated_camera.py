"""What is known of a camera whose sessions name it: its calibration error, and how it became known."""

from __future__ import annotations

import re
from dataclasses import dataclass

from pretouch.errors import InvalidInput
from pretouch.geometry import Matrix6, Matrix12, Pose

_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")


def check_camera_id(id: str) -> str:
    """The name of a camera, which is also a part of addresses.

    Raises:
        InvalidInput: not 1 to 64 letters, digits, dots, underscores and hyphens, or "." or "..".
    """
    if not isinstance(id, str) or _ID.fullmatch(id) is None or id in (".", ".."):
        raise InvalidInput(
            f"camera.id is {id!r:.80}.", "Name the camera by 1 to 64 of A-Z, a-z, 0-9, '.', '_' and '-'."
        )
    return id


@dataclass(frozen=True)
class CalibrationResidual:
    """The part of the calibration error that is another one in each session.

    Attributes:
        translation_std: standard deviation of the translation along each axis, in metres.
        rotation_std: standard deviation of the rotation about each axis, in radians.
    """

    translation_std: float
    rotation_std: float


@dataclass(frozen=True)
class CalibrationDrift:
    """Whether a camera is still where it was.

    Attributes:
        state: "steady", "suspected" where the last session contradicts those before, or "moved" where the camera was
            knocked: what was learned before is not used.
        since: name of the first session that found the camera elsewhere; null if it is steady.
    """

    state: str = "steady"
    since: str | None = None


@dataclass(frozen=True)
class CameraSession:
    """A session that counts.

    Attributes:
        session: name of the session, which may be removed by now.
        at: when it ended, in seconds since the Unix epoch.
        error: mean distance in metres by which the camera misplaced the object's points, as the session found.
        expected_error: what was expected, in metres, to be left of that error by the prediction with which the session
            began.
    """

    session: str
    at: float
    error: float
    expected_error: float


@dataclass(frozen=True)
class LeftOutSession:
    """A session that does not count.

    Attributes:
        session: name of the session, which may be removed by now.
        at: when it ended, in seconds since the Unix epoch.
        reason: why it does not count, in one sentence.
    """

    session: str
    at: float
    reason: str


@dataclass(frozen=True, eq=False)
class CameraSummary:
    """A camera in the list of all.

    Attributes:
        id: name of the camera.
        sessions: number of sessions that counted.
        camera_T_camera: the part of the calibration error on the camera's side.
        base_T_base: the part of the calibration error on the base's side.
        residual: by how much the calibration error differs from session to session.
        drift: whether the calibration error is still the one that was learned.
    """

    id: str
    sessions: int
    camera_T_camera: Pose
    base_T_base: Pose
    residual: CalibrationResidual
    drift: CalibrationDrift


@dataclass(frozen=True, eq=False)
class CalibratedCamera:
    """What is known of a camera.

    The camera's true pose is base_T_base * (believed base_T_camera) * camera_T_camera, up to the residual.

    Attributes:
        id: name of the camera.
        sessions: number of sessions that counted.
        base_T_camera: the camera in base as the latest session believed it, corrected; the camera frame has x right, y
            down, z forward.
        camera_T_camera: the part of the calibration error on the camera's side.
        base_T_base: the part of the calibration error on the base's side.
        covariance: 12 x 12, row-major, of both parts, `camera_T_camera` first, each in the order (rotation vector,
            translation); rad^2, rad m, m^2.
        residual: by how much the calibration error differs from session to session.
        drift: whether the calibration error is still the one that was learned.
        base_T_camera_covariance: 6 x 6, row-major, order (rotation vector, translation), base axes, of the error
            (log(R_true R^T), t_true - t) of the corrected pose, rad^2, rad m, m^2; null while nothing is known.
        history: the sessions that count, the oldest first; at most 200.
        left_out: the sessions that do not count, the oldest first, with the reason.
    """

    id: str
    sessions: int
    base_T_camera: Pose
    camera_T_camera: Pose
    base_T_base: Pose
    covariance: Matrix12
    residual: CalibrationResidual
    drift: CalibrationDrift
    base_T_camera_covariance: Matrix6 | None = None
    history: tuple[CameraSession, ...] = ()
    left_out: tuple[LeftOutSession, ...] = ()
