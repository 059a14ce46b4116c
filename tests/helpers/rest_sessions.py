"""Sessions over plain HTTP, as a robot in any language would run them."""

from __future__ import annotations

from typing import Any

import httpx

from helpers import box_view


def opened(rest: httpx.Client, **changes: Any) -> dict[str, Any]:
    """A new session with three scans before it converges."""
    changes = {"budget": {"fraction": 1.0}} | changes
    response = rest.post("/v1/sessions", files=box_view.multipart(**changes))
    assert response.status_code == 201, response.text
    return dict(response.json())


def scan_path(session: dict[str, Any]) -> str:
    return f"/v1/sessions/{session['id']}/scans/{session['next_scan']['scan_id']}"


def scanned(rest: httpx.Client, session: dict[str, Any]) -> dict[str, Any]:
    response = rest.post(scan_path(session), json=box_view.samples(session["next_scan"]))
    assert response.status_code == 200, response.text
    return dict(response.json())


def assert_problem(response: httpx.Response, status: int, *words: str) -> None:
    """A complete problem document of this status whose detail or remedy holds the words."""
    assert response.status_code == status, response.text
    assert response.headers["content-type"] == "application/problem+json"
    problem = response.json()
    assert problem["status"] == status
    assert all(problem[member] for member in ("type", "title", "detail", "remedy")), problem
    for word in words:
        assert word in problem["detail"] + problem["remedy"], problem
