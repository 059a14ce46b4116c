"""The route of a session's recording."""

from __future__ import annotations

from fastapi import FastAPI
from fastapi.responses import Response

from pretouch.serving import ServiceContext
from pretouch.serving.caller import current_caller
from pretouch_orchestrator.recording.file import write_recording
from pretouch_orchestrator.rest import openapi
from pretouch_orchestrator.rest.parameters import SessionId
from pretouch_orchestrator.sessions.manager import SessionManager

MEDIA_TYPE = "application/octet-stream"
_BYTES_A_PIXEL = 100
_BYTES_A_SAMPLE = 200
_BYTES = 16 * 1024 * 1024
"""For any recording."""


def add_recording_route(app: FastAPI, sessions: SessionManager, context: ServiceContext) -> None:
    content = {MEDIA_TYPE: {"schema": {"type": "string", "format": "binary"}, "example": "\x89MCAP0\r\n..."}}

    @app.get(
        "/v1/sessions/{session_id}/recording.mcap",
        response_class=Response,
        summary="Get a session's recording",
        responses=openapi.describe_responses(
            200, {"description": "The recording, an MCAP file.", "content": content}, 401, 404, 422, 429, 503
        ),
    )
    async def get_recording(session_id: SessionId) -> Response:
        """Holds what the session saw, planned, measured and answered, whatever its state, as an MCAP file.

        Foxglove and Rerun show it; `pretouch session replay` registers its scans again.
        """
        record, events = await sessions.load_history(current_caller().owner, session_id)
        samples = sum(map(len, record.measured))
        memory = _BYTES + _BYTES_A_PIXEL * record.scene.mask.size + _BYTES_A_SAMPLE * samples
        file = await context.run_in_thread(write_recording, record, events, memory=memory)
        headers = {
            "Cache-Control": "no-store",
            "Content-Disposition": f'attachment; filename="session-{record.id}.mcap"',
        }
        return Response(file, media_type=MEDIA_TYPE, headers=headers)
