"""One span for each REST request, below that of the robot program which sent it."""

from __future__ import annotations

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from pretouch.tracing import server_span

_POLLED = ("/healthz", "/readyz", "/metrics")


class TracingMiddleware:
    """Makes the spans of `app`'s work children of the request's."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or scope["path"] in _POLLED:
            await self._app(scope, receive, send)
            return
        method, path, status = scope["method"], scope["path"], 500

        async def send_and_note_status(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
            await send(message)

        headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}
        with server_span(method, headers, {"http.request.method": method, "url.path": path}) as span:
            try:
                await self._app(scope, receive, send_and_note_status)
            finally:
                route = getattr(scope.get("route"), "path", None)
                span.end_with(
                    {"http.response.status_code": status} | ({} if route is None else {"http.route": route}),
                    name=f"{method} {route}" if route else None,
                    failed=status >= 500,
                )
