"""Models of the JSON documents of cameras, for OpenAPI."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import BaseModel, Field

from pretouch import calibrated_camera
from pretouch_orchestrator.rest.derived_model import derive_model

_Matrix6 = Annotated[list[Annotated[list[float], Field(min_length=6, max_length=6)]], Field(min_length=6, max_length=6)]

CalibrationResidual = derive_model(calibrated_camera.CalibrationResidual, BaseModel)
CalibrationDrift = derive_model(
    calibrated_camera.CalibrationDrift,
    BaseModel,
    state=Literal["steady", "suspected", "moved"],
    since=str | None,
)
CameraSession = derive_model(calibrated_camera.CameraSession, BaseModel)
LeftOutSession = derive_model(calibrated_camera.LeftOutSession, BaseModel)
CameraSummary = derive_model(calibrated_camera.CameraSummary, BaseModel)
CalibratedCamera = derive_model(calibrated_camera.CalibratedCamera, BaseModel, base_T_camera_covariance=_Matrix6 | None)


class CameraList(BaseModel):
    """The cameras."""

    cameras: list[CameraSummary] = Field(description="The cameras, in the order of their names.")  # type: ignore[valid-type]


MODELS: Sequence[type[BaseModel]] = (CalibratedCamera, CameraList)
"""Those of responses."""
