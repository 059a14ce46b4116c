"""The route of a session's report."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from fastapi import FastAPI
from fastapi.responses import HTMLResponse, Response

from pretouch.calibrated_camera import CalibratedCamera
from pretouch.errors import NotFound
from pretouch.serving import ServiceContext
from pretouch.serving.caller import current_caller
from pretouch_orchestrator.report.document import build_document
from pretouch_orchestrator.report.page import content_security_policy, render_page
from pretouch_orchestrator.rest import openapi
from pretouch_orchestrator.rest.parameters import ReportFormat, SessionId
from pretouch_orchestrator.sessions.manager import SessionManager
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.store.protocol import Event

_BYTES_A_PIXEL = 200
_BYTES_A_SAMPLE = 200
_BYTES = 32 * 1024 * 1024
"""For any report."""


def add_report_route(app: FastAPI, sessions: SessionManager, context: ServiceContext) -> None:
    success = openapi.describe_text("text/html", "The report.", "<!DOCTYPE html>...")
    success["content"]["application/json"] = {"schema": {"type": "object"}, "example": {"id": "5f0c", "scans": []}}

    @app.get(
        "/v1/sessions/{session_id}/report",
        response_class=HTMLResponse,
        summary="Get a session's report",
        responses=openapi.describe_responses(200, success, 401, 404, 422, 429, 503),
    )
    async def get_report(session_id: SessionId, format: ReportFormat = "html") -> Response:
        """Shows what came of the session and why, whatever its state, as one file of at most 3 MB."""
        owner = current_caller().owner
        record, events = await sessions.load_history(owner, session_id)
        camera = await _find_camera(sessions, owner, record)
        samples = sum(map(len, record.measured))
        memory = _BYTES + _BYTES_A_PIXEL * record.scene.mask.size + _BYTES_A_SAMPLE * samples
        text = await context.run_in_thread(_render, record, events, camera, format, memory=memory)
        if format == "json":
            return Response(text, media_type="application/json", headers={"Cache-Control": "no-store"})
        headers = {"Cache-Control": "no-store", "Content-Security-Policy": content_security_policy()}
        return HTMLResponse(text, headers=headers)


async def _find_camera(sessions: SessionManager, owner: str, record: Record) -> CalibratedCamera | None:
    """The camera that the session names, unless it was forgotten."""
    if record.request.camera_id is not None:
        with suppress(NotFound):
            return await sessions.cameras.get(owner, record.request.camera_id)
    return None


def _render(record: Record, events: Sequence[Event], camera: CalibratedCamera | None, format: str) -> str:
    document: dict[str, Any] = build_document(record, events, camera)
    if format == "json":
        return json.dumps(document, separators=(",", ":"), allow_nan=False)
    return render_page(f"Session {record.id}", "", [("What came of it", document)])
