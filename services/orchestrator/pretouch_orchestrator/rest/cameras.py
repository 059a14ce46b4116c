"""The routes of cameras whose calibration is learned."""

from __future__ import annotations

import json

from fastapi import FastAPI
from fastapi.responses import JSONResponse, PlainTextResponse, Response

from pretouch.camera_export import ExportFormat, export_camera
from pretouch.serving.caller import current_caller
from pretouch.wire.json import camera_list_to_json, camera_to_json
from pretouch_orchestrator.rest import camera_models as models
from pretouch_orchestrator.rest import openapi
from pretouch_orchestrator.rest.camera_examples import EXPORTS
from pretouch_orchestrator.rest.parameters import CameraFormat, CameraId
from pretouch_orchestrator.sessions.manager import SessionManager

_MEDIA_TYPES = {
    ExportFormat.JSON: "application/json",
    ExportFormat.YAML: "application/yaml",
    ExportFormat.URDF: "application/xml",
}


def add_camera_routes(app: FastAPI, sessions: SessionManager) -> None:
    """Adds the routes to `app`."""
    contents = {
        "application/json": {"schema": {"type": "object"}, "example": json.loads(EXPORTS[ExportFormat.JSON])},
        "application/yaml": {"schema": {"type": "string"}, "example": EXPORTS[ExportFormat.YAML]},
        "application/xml": {"schema": {"type": "string"}, "example": EXPORTS[ExportFormat.URDF]},
    }
    exported = {"description": "The pose.", "content": contents}

    @app.get(
        "/v1/cameras",
        summary="List cameras",
        responses=openapi.describe_responses(
            200, openapi.describe_json(models.CameraList, "The cameras."), *(401, 503)
        ),
    )
    async def list_cameras() -> Response:
        """Lists the cameras that sessions have named by `camera.id`, and whether each is where it was."""
        return JSONResponse(camera_list_to_json(await sessions.cameras.list(current_caller().owner)))

    @app.get(
        "/v1/cameras/{camera_id}",
        summary="Get a camera",
        responses=openapi.describe_responses(
            200, openapi.describe_json(models.CalibratedCamera, "The camera."), *(401, 404, 429, 503)
        ),
    )
    async def get_camera(camera_id: CameraId) -> Response:
        """Returns what is known of a camera: its calibration error, whether it has moved, and its sessions."""
        return JSONResponse(camera_to_json(await sessions.cameras.get(current_caller().owner, camera_id)))

    @app.delete(
        "/v1/cameras/{camera_id}",
        status_code=204,
        summary="Forget a camera",
        responses=openapi.describe_responses(204, {"description": "The camera is forgotten."}, 401, 404, 503),
    )
    async def forget_camera(camera_id: CameraId) -> Response:
        """Forgets all that was learned of a camera; its sessions stay, and those under way teach nothing."""
        await sessions.cameras.forget(current_caller().owner, camera_id)
        return Response(status_code=204)

    @app.get(
        "/v1/cameras/{camera_id}/export",
        summary="Export a camera's pose",
        responses=openapi.describe_responses(200, exported, *(401, 404, 409, 422, 429, 503)),
    )
    async def export_pose(camera_id: CameraId, format: CameraFormat = "json") -> Response:
        """Returns the camera's corrected pose in base with its covariance, for the robot's own configuration."""
        camera = await sessions.cameras.get(current_caller().owner, camera_id)
        return PlainTextResponse(
            export_camera(camera, ExportFormat(format)), media_type=_MEDIA_TYPES[ExportFormat(format)]
        )
