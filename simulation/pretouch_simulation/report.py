"""The orchestrator's report of simulated sessions, with what only a simulation knows: the true object and error."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from pretouch_orchestrator.report.document import pack_points
from pretouch_orchestrator.report.page import render_page

from pretouch.errors import Unavailable
from pretouch.geometry import Array
from pretouch_simulation.demo import Recording
from pretouch_simulation.mesh import Mesh
from pretouch_simulation.protocol import Case

_POINTS = 5000
_TIMEOUT = 60.0


def fetch_report(rest: str, session_id: str) -> dict[str, Any]:
    """What the report of a session shows, from the orchestrator at the URL `rest`.

    Raises:
        Unavailable: it does not answer with a report.
    """
    try:
        answer = httpx.get(
            f"{rest}/v1/sessions/{session_id}/report", params={"format": "json"}, timeout=_TIMEOUT, trust_env=False
        )
        answer.raise_for_status()
        return dict(answer.json())
    except (httpx.HTTPError, ValueError) as error:
        raise Unavailable(f"The session's report could not be read: {error}", "Look at the services' log.") from error


def save_report(recordings: Sequence[Recording], about: str, path: Path) -> None:
    """Writes one file of all sessions' reports; `about` is a sentence on their settings."""
    documents = [
        (recording.title, with_truth(recording.report, recording.case, recording.true_errors()))
        for recording in recordings
    ]
    path.write_text(render_page("pretouch demo", about, documents), encoding="utf-8")


def with_truth(document: dict[str, Any], case: Case, errors: Sequence[float]) -> dict[str, Any]:
    """A report's document beside the truth.

    Args:
        errors: m, the true ones: before the first scan, and after each.
    """
    body = case.world.bodies[0]
    points = _sample_surface(body.mesh.moved(body.base_T_mesh), _POINTS)
    return document | {"truth": {"errors": list(errors), "points": pack_points(points, np.array(document["origin"]))}}


def _sample_surface(mesh: Mesh, count: int) -> Array:
    """(count, 3), m: points evenly over the mesh."""
    rng = np.random.default_rng(0)
    corners = mesh.vertices[mesh.faces]
    sides = corners[:, 1:] - corners[:, :1]
    areas = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    chosen = rng.choice(len(areas), count, p=areas / areas.sum())
    weights = rng.random((count, 2, 1))
    weights = np.where(weights.sum(axis=1, keepdims=True) > 1, 1 - weights, weights)
    return np.asarray(corners[chosen, 0] + (weights * sides[chosen]).sum(axis=1), dtype=np.float64)
