"""The dashboard at `/`: static files, which ask the public REST API for everything that they show."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

from fastapi import FastAPI
from fastapi.responses import Response

from pretouch.errors import NotFound

_REPORT, _DASHBOARD = "pretouch_orchestrator.report", "pretouch_orchestrator.dashboard"
_PACKAGES = {"views.js": _REPORT, "style.css": _REPORT}
"""Files that the dashboard shares with the reports; the others are its own."""
_TYPES = {"html": "text/html; charset=utf-8", "js": "text/javascript; charset=utf-8", "css": "text/css; charset=utf-8"}
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "form-action 'self'; base-uri 'none'; frame-ancestors 'none'; "
    "require-trusted-types-for 'script'; trusted-types 'none'"
)
"""Nothing from elsewhere, nothing inline, and no text that becomes markup."""
_HEADERS = {
    "Cache-Control": "no-cache",
    "Content-Security-Policy": _POLICY,
    "Referrer-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
}


def add_dashboard_routes(app: FastAPI) -> None:
    """Adds the page, and the files that it loads."""

    @app.get("/", include_in_schema=False)
    async def get_dashboard() -> Response:
        return _serve("index.html")

    @app.get("/dashboard/{name}", include_in_schema=False)
    async def get_dashboard_file(name: str) -> Response:
        return _serve(name)


def _serve(name: str) -> Response:
    content = _read_files().get(name)
    if content is None:
        raise NotFound(f"The dashboard has no file {name!r:.80}.", "Open the dashboard at /.")
    return Response(content, headers=_HEADERS, media_type=_TYPES[name.rpartition(".")[2]])


@cache
def _read_files() -> dict[str, bytes]:
    """The content of each file that may be asked for, by its name."""
    own = [each.name for each in files(_DASHBOARD).iterdir() if each.name.rpartition(".")[2] in _TYPES]
    packages = dict.fromkeys(own, _DASHBOARD) | _PACKAGES
    return {name: (files(package) / name).read_bytes() for name, package in packages.items()}
