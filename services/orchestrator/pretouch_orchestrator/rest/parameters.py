"""The parameters of the REST routes, described for OpenAPI."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import Header, Path, Query

from pretouch_orchestrator.sessions.manager import MAX_KEY, MAX_PAGE

SessionId = Annotated[str, Path(description="Name of the session.")]
ScanId = Annotated[str, Path(description="Name of the scan: `scan_id` of the session's `next_scan`.")]
IdempotencyKey = Annotated[
    str,
    Header(
        alias="Idempotency-Key",
        max_length=MAX_KEY,
        description="A repeated key returns the session that the first call created.",
    ),
]
CameraId = Annotated[str, Path(description="Name of the camera: `camera.id` of its sessions.")]
CameraFormat = Annotated[
    Literal["json", "yaml", "urdf"],
    Query(description="`json` or `yaml`: the pose with its covariance; `urdf`: a fixed joint with its `origin`."),
]
DeviceName = Annotated[str, Path(description="Name of the gateway's device.")]
ClockOffset = Annotated[
    float | None,
    Query(
        allow_inf_nan=False,
        description="The clock of the poses' times minus that of the gateway's host, in seconds, "
        "which `GET /v1/devices/{name}` tells as `now`; left out: they are the same clock.",
    ),
]
LastEventId = Annotated[str, Header(alias="Last-Event-ID", description="Only events after the one with this id.")]
Limit = Annotated[int, Query(ge=1, le=MAX_PAGE, description="Largest number of sessions on the page.")]
Cursor = Annotated[
    str, Query(pattern=r"^\d{0,18}$", description="`next` of the previous page; left out: the first page.")
]
ReportFormat = Annotated[
    Literal["html", "json"], Query(description="`html`: a page that needs nothing else; `json`: what it shows.")
]
Purge = Annotated[
    bool,
    Query(
        description="Whether the session is also removed, with all that is stored of it but what its camera "
        "has learned."
    ),
]
