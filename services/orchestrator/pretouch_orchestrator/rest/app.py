"""The REST contract: routes over the session manager."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator
from contextlib import aclosing
from functools import cache
from typing import Any

from fastapi import FastAPI, Request
from fastapi.responses import HTMLResponse, JSONResponse, PlainTextResponse, Response, StreamingResponse
from prometheus_client import CONTENT_TYPE_LATEST, generate_latest

from pretouch.errors import Conflict, Malformed
from pretouch.serving import ServiceContext
from pretouch.serving.caller import current_caller
from pretouch.session import Submission, Telling
from pretouch.wire.json import (
    progress_to_json,
    scan_plan_to_json,
    session_to_json,
    submission_from_json,
    telling_from_json,
)
from pretouch_orchestrator.readiness import Readiness
from pretouch_orchestrator.rest import examples, models, openapi
from pretouch_orchestrator.rest.admission import AdmissionMiddleware
from pretouch_orchestrator.rest.body_limit import BodyLimit
from pretouch_orchestrator.rest.cameras import add_camera_routes
from pretouch_orchestrator.rest.dashboard import add_dashboard_routes
from pretouch_orchestrator.rest.decoding import hold_creation, read_document
from pretouch_orchestrator.rest.devices import add_device_routes
from pretouch_orchestrator.rest.docs_page import PAGE_POLICY, render_docs_page
from pretouch_orchestrator.rest.head import HeadAsGet
from pretouch_orchestrator.rest.hosts import HostCheck
from pretouch_orchestrator.rest.login import add_login_routes
from pretouch_orchestrator.rest.overview import add_overview_routes
from pretouch_orchestrator.rest.parameters import Cursor, IdempotencyKey, LastEventId, Limit, Purge, ScanId, SessionId
from pretouch_orchestrator.rest.problems import answer_errors_as_problems
from pretouch_orchestrator.rest.recording import add_recording_route
from pretouch_orchestrator.rest.report import add_report_route
from pretouch_orchestrator.rest.tracing import TracingMiddleware
from pretouch_orchestrator.sessions.manager import DEFAULT_PAGE, SessionManager
from pretouch_orchestrator.upstream.devices import Devices

HEARTBEAT = 15.0
"""s without an event after which a comment is sent on an event stream."""
_DESCRIPTION = (
    "Corrects an object's pose with a range sensor in the fingertip. Metres, radians, seconds; right-handed frames; "
    "`a_T_b` maps a point in b to a; quaternions are x, y, z, w. `base` is the robot's base; the `tip` frame is that "
    "of the fingertip sensor, z along its beam; the `camera` frame has x right, y down, z forward. Every error is an "
    "RFC 9457 problem document that says what to do."
)


def create_rest_app(
    sessions: SessionManager,
    context: ServiceContext,
    readiness: Readiness,
    hosts: HostCheck | None = None,
    devices: Devices | None = None,
) -> FastAPI:
    """The application.

    Args:
        readiness: of the store and the upstream services.
        devices: of the sensor gateway; None where there is none.
        hosts: names by which it may be called; None: those of the loopback interface.
    """
    app = FastAPI(
        title="pretouch",
        description=_DESCRIPTION,
        docs_url=None,
        openapi_url=None,
        redoc_url=None,
        redirect_slashes=False,
        generate_unique_id_function=lambda route: route.name,
    )
    app.add_middleware(HeadAsGet)
    app.add_middleware(AdmissionMiddleware, context=context, hosts=hosts or HostCheck())
    app.add_middleware(BodyLimit)
    app.add_middleware(TracingMiddleware)  # the outermost, so that the log of a request names its trace
    answer_errors_as_problems(app, context)
    _add_session_routes(app, sessions, context)
    _add_event_route(app, sessions)
    add_report_route(app, sessions, context)
    add_recording_route(app, sessions, context)
    add_camera_routes(app, sessions)
    add_device_routes(app, devices, context)
    add_overview_routes(app, readiness, token=context.token_check.required)
    _add_service_routes(app, context, readiness)
    add_login_routes(app, context)
    add_dashboard_routes(app)
    openapi.install_document(app, token=context.token_check.required)
    return app


def _add_session_routes(app: FastAPI, sessions: SessionManager, context: ServiceContext) -> None:
    @app.post(
        "/v1/sessions",
        status_code=201,
        summary="Create a session",
        responses=openapi.describe_responses(
            201,
            openapi.describe_json(models.Session, "The new session."),
            *(400, 401, 409, 413, 415, 422, 429, 503, 504),
        ),
        openapi_extra=openapi.describe_creation_body(),
    )
    async def create_session(request: Request, idempotency_key: IdempotencyKey = "") -> Response:
        """Takes a depth image; returns regions, the first estimate and the path of the first scan.

        Repeating a request with the same `Idempotency-Key` returns the session that the first call created.
        """
        sessions.check_room()
        async with hold_creation(request, context) as (wanted, values, mask):
            session = await sessions.create(current_caller().owner, wanted, values, mask, idempotency_key or None)
        return JSONResponse(session_to_json(session), 201, {"Location": f"/v1/sessions/{session.id}"})

    @app.get(
        "/v1/sessions",
        summary="List sessions",
        responses=openapi.describe_responses(
            200,
            openapi.describe_json(models.SessionList, "The newest first."),
            *(401, 422, 429, 503),
        ),
    )
    async def list_sessions(limit: Limit = DEFAULT_PAGE, cursor: Cursor = "") -> Response:
        """Lists all sessions of this orchestrator in pages."""
        page, following = await sessions.list_page(current_caller().owner, limit, cursor)
        page_json = await context.run_briefly(lambda: [session_to_json(session) for session in page])
        return JSONResponse({"sessions": page_json, "next": following or None})

    @app.get(
        "/v1/sessions/{session_id}",
        summary="Get a session",
        responses=openapi.describe_responses(
            200,
            openapi.describe_json(models.Session, "The session."),
            *(401, 404, 503),
        ),
    )
    async def get_session(session_id: SessionId) -> Response:
        """Returns the session's present state."""
        return JSONResponse(session_to_json(await sessions.get(current_caller().owner, session_id)))

    @app.delete(
        "/v1/sessions/{session_id}",
        status_code=204,
        summary="Cancel a session",
        responses=openapi.describe_responses(204, {"description": "The session has ended."}, 401, 404, 422, 503),
    )
    async def cancel_session(session_id: SessionId, purge: Purge = False) -> Response:
        """Cancels the session at once, whatever step is under way; one that has already ended keeps its state."""
        await sessions.cancel(current_caller().owner, session_id, purge)
        return Response(status_code=204)

    @app.get(
        "/v1/sessions/{session_id}/next-scan",
        summary="Get the next scan's path",
        responses=openapi.describe_responses(
            200,
            openapi.describe_json(models.ScanPlan, "The path."),
            *(401, 404, 409, 503),
        ),
    )
    async def get_next_scan(session_id: SessionId) -> Response:
        """Returns the path that the fingertip should follow next."""
        session = await sessions.get(current_caller().owner, session_id)
        if session.next_scan is None:
            raise Conflict(
                f"The session is {session.state.value}: there is no next scan.", "Read its estimate, or open a new one."
            )
        return JSONResponse(scan_plan_to_json(session.next_scan))

    @app.post(
        "/v1/sessions/{session_id}/scans/{scan_id}",
        summary="Submit a scan",
        responses=openapi.describe_responses(
            200,
            openapi.describe_json(models.Session, "The session after the scan."),
            *(400, 401, 404, 409, 413, 415, 422, 429, 503, 504),
        ),
        openapi_extra=openapi.describe_json_body("Submission"),
    )
    async def submit_scan(request: Request, session_id: SessionId, scan_id: ScanId) -> Response:
        """Takes what the finger measured along the planned path. Repeating a scan returns the present session."""

        async def read() -> Submission:
            return await read_document(request, context, submission_from_json)

        return JSONResponse(session_to_json(await sessions.submit(current_caller().owner, session_id, scan_id, read)))

    @app.post(
        "/v1/sessions/{session_id}/scans/{scan_id}/samples",
        summary="Tell samples while the robot moves",
        responses=openapi.describe_responses(
            200,
            openapi.describe_json(models.ScanProgress, "The scan's progress."),
            *(400, 401, 404, 409, 413, 415, 422, 429, 503, 504),
        ),
        openapi_extra=openapi.describe_json_body("Telling"),
    )
    async def tell_samples(request: Request, session_id: SessionId, scan_id: ScanId) -> Response:
        """Takes samples of a scan under way, and says whether they are enough: then the robot may leave the path.

        What was told before counts once. The scan is closed by submitting it with the rest of its samples, or none.
        """

        async def read() -> Telling:
            return await read_document(request, context, telling_from_json)

        return JSONResponse(progress_to_json(await sessions.tell(current_caller().owner, session_id, scan_id, read)))


def _add_event_route(app: FastAPI, sessions: SessionManager) -> None:
    event_stream = openapi.describe_text("text/event-stream", "Server-sent events; their data is JSON.", examples.EVENT)

    @app.get(
        "/v1/sessions/{session_id}/events",
        response_class=StreamingResponse,
        summary="Stream a session's events",
        responses=openapi.describe_responses(200, event_stream, 400, 401, 404, 503),
    )
    async def stream_events(
        session_id: SessionId,
        last_event_id: LastEventId = "",
    ) -> Response:
        """Streams the events `session`, `scan`, `estimate`, `camera` and `end`, from the session's start to its end.

        `camera` comes before the `end` of a session that named one: whether the session counts, whether it has moved.
        """
        if not (last_event_id.isascii() and (last_event_id or "0").isdigit() and len(last_event_id) < 19):
            raise Malformed(f"Last-Event-ID is {last_event_id!r:.80}.", "Send the id of an event of this session.")
        await sessions.get(current_caller().owner, session_id)
        return StreamingResponse(
            _stream_events(sessions, current_caller().owner, session_id, int(last_event_id or 0)),
            media_type="text/event-stream",
            headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"},
        )


async def _stream_events(sessions: SessionManager, owner: str, session_id: str, after: int) -> AsyncIterator[str]:
    async with aclosing(sessions.follow(owner, session_id, after, HEARTBEAT)) as events:
        async for event in events:
            if event is None:
                yield ": still here\n\n"
            else:
                yield f"id: {event.id}\nevent: {event.type}\ndata: {json.dumps(event.data)}\n\n"


def _add_service_routes(app: FastAPI, context: ServiceContext, readiness: Readiness) -> None:
    @app.get(
        "/healthz",
        summary="Is it alive?",
        responses=openapi.describe_responses(200, openapi.describe_json(models.Health, "It answers.")),
    )
    async def get_health() -> dict[str, Any]:
        """The service answers."""
        return {"status": "ok"}

    @app.get(
        "/readyz",
        summary="Is it ready?",
        responses=openapi.describe_responses(200, openapi.describe_json(models.Health, "It can serve sessions."), 503),
    )
    async def get_readiness() -> dict[str, Any]:
        """The store is writable, and the upstream services are ready."""
        await readiness()
        return {"status": "ready"}

    @app.get(
        "/metrics",
        response_class=PlainTextResponse,
        summary="Metrics",
        responses=openapi.describe_responses(
            200, openapi.describe_text("text/plain", "Prometheus text.", examples.METRIC)
        ),
    )
    async def get_metrics() -> Response:
        """Returns the metrics in the text format of Prometheus."""
        return Response(generate_latest(context.metrics.registry), media_type=CONTENT_TYPE_LATEST)

    @app.get(
        "/docs",
        response_class=HTMLResponse,
        summary="This API's description",
        responses=openapi.describe_responses(200, openapi.describe_text("text/html", "A page.", "<!doctype html>...")),
    )
    async def get_docs() -> Response:
        """Shows the OpenAPI document as a self-contained page."""
        return HTMLResponse(get_page(), headers={"Content-Security-Policy": PAGE_POLICY})

    @app.get("/openapi.json", include_in_schema=False)
    async def get_document() -> Response:
        return Response(get_document_text(), media_type="application/json")

    @cache  # both are large, and asked for by anybody who may: made once, they cost the others no time
    def get_page() -> str:
        return render_docs_page(app.openapi())

    @cache
    def get_document_text() -> str:
        return json.dumps(app.openapi(), separators=(",", ":"))
