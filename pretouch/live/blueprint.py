"""What Rerun shows of a recording at first; `deploy/foxglove/session.json` is the same for Foxglove."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rerun.blueprint import Blueprint

CLOUDS = {
    "/camera/surroundings": (150, 150, 150),
    "/object/before": (230, 159, 0),
    "/object/after": (0, 114, 178),
    "/scan/hits": (0, 158, 115),
    "/scan/misses": (204, 121, 167),
}
"""Topics of clouds and their colours, which people tell apart however they see colours (Okabe and Ito)."""
_KEPT = ("/scan/hits", "/scan/misses")
"""Clouds of which all messages so far are shown, not only the last."""


def make_blueprint() -> Blueprint:
    """The blueprint, which `deploy/rerun/session.rbl` holds for recordings that are opened as files."""
    import rerun
    import rerun.blueprint as views

    begin, now = views.TimeRangeBoundary.infinite(), views.TimeRangeBoundary.cursor_relative()
    so_far = rerun.VisibleTimeRange("message_log_time", start=begin, end=now)
    overrides: dict[Any, Any] = {topic: [rerun.Points3D.from_fields(colors=[rgb])] for topic, rgb in CLOUDS.items()}
    for topic in _KEPT:
        overrides[topic].append(views.VisibleTimeRanges(so_far))
    scene = views.Spatial3DView(
        name="Before and after",
        overrides=overrides,
        spatial_information=views.SpatialInformation(target_frame="base"),
    )
    depth = views.Spatial2DView(name="Depth image", origin="/camera/depth")
    events = views.TextLogView(name="Events", origin="/events")
    return views.Blueprint(
        views.Horizontal(scene, views.Vertical(depth, events, row_shares=[3, 2]), column_shares=[3, 2]),
        collapse_panels=True,
    )
