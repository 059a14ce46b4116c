"""What is drawn beside the clouds: the table, how uncertain the object's place is, and the regions in the image."""

from __future__ import annotations

import numpy as np
from foxglove_schemas_protobuf.ArrowPrimitive_pb2 import ArrowPrimitive
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.Point2_pb2 import Point2
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive
from foxglove_schemas_protobuf.TextAnnotation_pb2 import TextAnnotation
from foxglove_schemas_protobuf.TriangleListPrimitive_pb2 import TriangleListPrimitive

from pretouch.estimate import Estimate
from pretouch.geometry import Array, Pose
from pretouch_orchestrator.recording import foxglove
from pretouch_orchestrator.sessions.record import Record

_GREY, _BLUE, _ORANGE, _YELLOW = (0.6, 0.6, 0.6), (0.0, 0.45, 0.7), (0.9, 0.6, 0.0), (0.94, 0.89, 0.26)
"""Colours that people tell apart however they see colours (Okabe and Ito)."""
_BESIDE = 0.1
"""m of the table around the object."""
_SIGMAS = float(np.sqrt(7.815))
"""Standard deviations: 95 % quantile of chi with 3 degrees of freedom."""
_MOST_ARROWS = 6
_LEAST_LENGTH = 1e-5
"""m: nothing smaller is drawn."""


def draw_table(record: Record, time: int) -> SceneUpdate:
    """The table around the object, as the camera puts it."""
    scene = record.scene
    normal = scene.table.normal
    middle = scene.centroid + (scene.table.offset - normal @ scene.centroid) * normal
    along = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    along /= np.linalg.norm(along)
    across = np.cross(normal, along)
    half = _BESIDE + float(np.linalg.norm(scene.cloud - scene.centroid, axis=1).max())
    corners = [middle + half * (a * along + b * across) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    square = TriangleListPrimitive(
        pose=foxglove.pose_message(Pose.identity()),
        points=[foxglove.point(corners[k]) for k in (0, 1, 2, 0, 2, 3)],
        color=foxglove.color(_GREY, 0.4),
    )
    return _update(SceneEntity(id="table", triangles=[square]), time)


def draw_uncertainty(estimate: Estimate, time: int) -> SceneUpdate:
    """The ellipsoid in which the object's centroid lies with 95 % probability, and arrows of two standard deviations
    along the weak directions: where they turn the object, as far as they move a point at its radius.
    """
    centre = estimate.base_T_correction.apply(estimate.centroid)
    variances, axes = np.linalg.eigh(estimate.covariance[3:, 3:])
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    lengths = np.maximum(2 * _SIGMAS * np.sqrt(np.maximum(variances, 0)), _LEAST_LENGTH)
    ellipsoid = SpherePrimitive(
        pose=foxglove.pose_message(Pose.of(axes, centre)),
        size=foxglove.vector(lengths),
        color=foxglove.color(_BLUE, 0.4),
    )
    arrows = []
    for weak in estimate.unobservable[:_MOST_ARROWS]:
        turn, shift = np.split(np.asarray(weak.direction, dtype=np.float64), 2)
        for direction, rgb in ((shift, _ORANGE), (turn, _YELLOW)):
            length = 2 * weak.std * float(np.linalg.norm(direction))
            if length > _LEAST_LENGTH:
                arrows.append(_arrow(centre, direction, length, rgb))
    return _update(SceneEntity(id="uncertainty", spheres=[ellipsoid], arrows=arrows), time)


def draw_regions(record: Record, time: int) -> ImageAnnotations:
    """The regions in the depth image, numbered by rank."""
    drawn = ImageAnnotations(timestamp=foxglove.stamp(time))
    for rank, region in enumerate(record.regions, start=1):
        corners = record.to_scene(region.rectangle).corners()
        drawn.points.add(
            timestamp=foxglove.stamp(time),
            type=PointsAnnotation.LINE_LOOP,
            points=[Point2(x=u, y=v) for u, v in corners],
            outline_color=foxglove.color(_ORANGE),
            thickness=1.0,
        )
        u, v = corners[0]
        text = TextAnnotation(
            timestamp=foxglove.stamp(time),
            position=Point2(x=u, y=v),
            text=str(rank),
            font_size=8.0,
            text_color=foxglove.color(_ORANGE),
        )
        drawn.texts.append(text)
    return drawn


def _arrow(start: Array, direction: Array, length: float, rgb: tuple[float, float, float]) -> ArrowPrimitive:
    """Foxglove's arrows point along x."""
    x = direction / np.linalg.norm(direction)
    y = np.cross(x, np.eye(3)[int(np.argmin(np.abs(x)))])
    y /= np.linalg.norm(y)
    return ArrowPrimitive(
        pose=foxglove.pose_message(Pose.of(np.column_stack([x, y, np.cross(x, y)]), start)),
        shaft_length=0.8 * length,
        shaft_diameter=0.05 * length,
        head_length=0.2 * length,
        head_diameter=0.1 * length,
        color=foxglove.color(rgb),
    )


def _update(entity: SceneEntity, time: int) -> SceneUpdate:
    entity.timestamp.CopyFrom(foxglove.stamp(time))
    entity.frame_id = foxglove.BASE
    return SceneUpdate(entities=[entity])
