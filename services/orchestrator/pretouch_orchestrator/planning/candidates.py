"""The scans to choose the next one from: paths, and the parts of them that may be scanned alone."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pretouch.scene import Scene
from pretouch.session import Region
from pretouch.trajectory import Trajectory
from pretouch_orchestrator.planning.lines import trace_lines
from pretouch_orchestrator.planning.path import PathPlanner
from pretouch_orchestrator.planning.surroundings import trace_surroundings

PIECES = (0.05, 0.10, 0.20)
"""m: lengths of the pieces of a path that may be scanned alone, each half a length after the other."""
FIRST_PIECES = (0.10, 0.20)
"""The same for as long as the sensor has returned nothing: the first scan also shows whether it works at all, and that
takes samples over more than one level surface."""
NEARBY = "nearby"
"""What the ids of paths beside the object begin with."""
MAX_NEARBY = 2
_BEGINNINGS = (1.0, 0.5, 0.25)
"""Shares of a path that are scanned from its start where no pieces are, the first that the budget allows."""


@dataclass(frozen=True, eq=False)
class CandidatePath:
    """A path, and the parts of it that could be scanned next.

    Attributes:
        id: name of what it follows: a region's id, or "line-1", .. across the object, or "nearby-1", .. beside it.
        region_id: the region whose perimeter it follows, if any.
        spans: (start, end) of each part, s within the path.
    """

    id: str
    region_id: str | None
    path: Trajectory
    spans: tuple[tuple[float, float], ...]

    def with_spans(self, spans: Sequence[tuple[float, float]]) -> CandidatePath:
        """The same path with other spans."""
        return replace(self, spans=tuple(spans))


def plan_object_paths(
    planner: PathPlanner,
    regions: Sequence[Region],
    pieces: Sequence[float],
    closed: Collection[str] = (),
) -> list[CandidatePath]:
    """Paths over the object: along the regions' perimeters and, where pieces are scanned, straight across.

    Without pieces, whole perimeters are scanned, as in the paper, or their beginnings if the budget allows no more.

    Args:
        regions: in the pixels of the planner's scene.
        pieces: m, lengths of the pieces that may be scanned alone.
        closed: ids of paths that are not planned any more.
    """
    candidates = []
    for region in regions:
        path = planner.follow_perimeter(region.rectangle) if region.id not in closed else None
        if path is not None:
            candidates.append(CandidatePath(region.id, region.id, path, _cut(path, pieces)))
    if pieces:
        for k, line in enumerate(trace_lines(planner.surface), start=1):
            if f"line-{k}" not in closed:
                path = planner.follow_line(line)
                candidates.append(CandidatePath(f"line-{k}", None, path, _cut(path, pieces)))
    return candidates


def plan_nearby_paths(
    scene: Scene, planner: PathPlanner, range_max: float, closed: Collection[str] = ()
) -> list[CandidatePath]:
    """Short paths over table and things beside the object: see `surroundings`."""
    candidates = []
    for k, line in enumerate(trace_surroundings(scene, planner, range_max), start=1):
        if f"{NEARBY}-{k}" not in closed:
            path = planner.follow_line(line)
            candidates.append(CandidatePath(f"{NEARBY}-{k}", None, path, ((0.0, path.duration),)))
    return candidates


def _cut(path: Trajectory, pieces: Sequence[float]) -> tuple[tuple[float, float], ...]:
    """The whole path, and its pieces of each of the lengths, m, or else its beginnings."""
    if not pieces:
        return tuple((0.0, share * path.duration) for share in _BEGINNINGS)
    spans = [(0.0, path.duration)]
    for length in pieces:
        duration = length / path.length * path.duration
        if duration < 0.8 * path.duration:
            starts = np.linspace(0.0, path.duration - duration, int(np.ceil(2 * (path.duration / duration - 1))) + 1)
            spans += [(float(start), min(float(start + duration), path.duration)) for start in starts]
    return tuple(spans)
