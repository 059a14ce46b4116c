"""Logging in with a browser, which keeps the token in a cookie that no script and no other site can use."""

from __future__ import annotations

from html import escape
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, quote, unquote, urlencode

from fastapi import FastAPI, Request
from fastapi.responses import HTMLResponse, RedirectResponse, Response
from starlette.requests import ClientDisconnect
from starlette.types import Scope

from pretouch.errors import PretouchError, wire_of
from pretouch.serving import ServiceContext
from pretouch_orchestrator.rest.docs_page import PAGE_POLICY, STYLE

LOGIN_PATH, LOGOUT_PATH = "/login", "/logout"
_COOKIE = "pretouch_token"
_MAX_FORM = 16 * 1024  # bytes
_HEADERS = {"Cache-Control": "no-store", "Content-Security-Policy": PAGE_POLICY}
_HOME = "/"
"""Where a browser goes that asked for no page in particular."""


def get_cookie_authorization(scope: Scope) -> bytes:
    """The `authorization` that a logged-in browser's cookie stands for; b"" without one."""
    for name, value in scope["headers"]:
        if name == b"cookie":
            try:
                cookies = SimpleCookie(value.decode("latin-1"))
            except CookieError:
                continue
            if _COOKIE in cookies:
                return b"Bearer " + unquote(cookies[_COOKIE].value, "latin-1").encode("latin-1")
    return b""


def wants_page(scope: Scope) -> bool:
    """Whether a browser asks for a page, so that a login form helps it more than a problem document."""
    accepted = dict(scope["headers"]).get(b"accept", b"")
    return scope["method"] in ("GET", "HEAD") and b"text/html" in accepted


def redirect_to_login(scope: Scope) -> Response:
    """Sends a browser to the form, and back here afterwards."""
    query = scope["query_string"].decode("latin-1")
    return RedirectResponse(f"{LOGIN_PATH}?{urlencode({'next': scope['path'] + ('?' + query if query else '')})}", 303)


def add_login_routes(app: FastAPI, context: ServiceContext) -> None:
    """Adds the form, what it sends, and the way out."""

    @app.get(LOGIN_PATH, include_in_schema=False)
    async def show_form(next: str = _HOME) -> Response:
        return HTMLResponse(_render(next), headers=_HEADERS)

    @app.post(LOGIN_PATH, include_in_schema=False)
    async def log_in(request: Request) -> Response:
        form = parse_qs((await _read_form(request)).decode("latin-1"))
        token, target = form.get("token", [""])[0].strip(), form.get("next", [_HOME])[0]
        authorization = f"Bearer {token}".encode() if token else b""
        if context.token_check.identify(authorization) is None:
            error = context.token_check.refuse(authorization, request.client.host if request.client else "")
            return HTMLResponse(_render(target, error), wire_of(error).http_status, _HEADERS)
        response = RedirectResponse(target if _is_local(target) else _HOME, 303, {"Cache-Control": "no-store"})
        secure = request.url.scheme == "https"
        response.set_cookie(_COOKIE, quote(token, safe=""), secure=secure, httponly=True, samesite="strict")
        return response

    @app.post(LOGOUT_PATH, include_in_schema=False)
    async def log_out() -> Response:
        response = RedirectResponse(LOGIN_PATH, 303)
        response.delete_cookie(_COOKIE, httponly=True, samesite="strict")
        return response


async def _read_form(request: Request) -> bytes:
    """The body; of one that is longer than any form, or cut off, its beginning."""
    body = b""
    try:
        async for chunk in request.stream():
            body += chunk
            if len(body) > _MAX_FORM:
                break
    except ClientDisconnect:
        pass
    return body


def _is_local(target: str) -> bool:
    """Whether a redirection to `target` stays with this service, however a browser reads it."""
    return target.startswith("/") and not target.startswith(("//", "/\\")) and target.isprintable()


def _render(target: str, error: PretouchError | None = None) -> str:
    said = "" if error is None else f"<p role='alert'>{escape(error.detail)}</p>"
    return (
        f"<!doctype html><html lang='en'><meta charset='utf-8'><title>pretouch</title>"
        f"<meta name='viewport' content='width=device-width'><style>{STYLE}</style><h1>pretouch</h1>{said}"
        f"<form method='post' action='{LOGIN_PATH}'><input type='hidden' name='next' value='{escape(target)}'>"
        "<p><label>Token <input type='password' name='token' autocomplete='current-password' required autofocus>"
        "</label> <button>Log in</button></p></form></html>"
    )
