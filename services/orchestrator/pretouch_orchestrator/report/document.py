"""What a report shows of a session, as one bounded JSON document made from its record and events alone.

Numbers are finite. Points are flat lists of whole tenths of a millimetre, in base, about `origin` (m); everything else
is in metres, seconds and pixels of the picture's scene.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pretouch import __version__
from pretouch.calibrated_camera import CalibratedCamera
from pretouch.geometry import Array, Pose, vector_from_rotation
from pretouch.prior import AnyPrior
from pretouch.session import ScanSummary
from pretouch.tof import Scan
from pretouch.wire.json import camera_to_json, pose_from_json, request_to_json
from pretouch_orchestrator.perception.believed_ranges import Surface
from pretouch_orchestrator.report.outcome import (
    describe_correction,
    describe_forecast,
    describe_outcome,
    describe_points,
)
from pretouch_orchestrator.report.picture import draw_scene
from pretouch_orchestrator.sessions.history import list_estimates
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.store.protocol import NewEvent

UNIT = 1e-4
"""m: of the points' whole numbers."""
_MOST_POINTS = 6000
_MOST_BEAMS = 24_000
"""Of all scans together: so many hits, misses and places of the tip are kept, evenly chosen."""
_MOST_BEAMS_OF_A_SCAN = 1500
_LIFT = 0.05
"""m above a hit from which its beam is followed to the believed surface."""
_ELLIPSOID = float(np.sqrt(7.815))
"""Standard deviations: 95 % quantile of chi with 3 degrees of freedom."""
_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


def build_document(
    record: Record, events: Iterable[NewEvent], camera: CalibratedCamera | None = None
) -> dict[str, Any]:
    """The document of a session, in whatever state.

    Args:
        events: those of types `scan` and `estimate`, the oldest first; others are passed over.
        camera: what is known by now of the camera that the request names.
    """
    origin = np.round(record.scene.centroid, 4)
    surface = _believe_surface(record)
    share = max(1, min(_MOST_BEAMS_OF_A_SCAN, _MOST_BEAMS // max(1, len(record.scans))))
    scans = [
        _describe_scan(record, summary, scan, surface, origin, share)
        for summary, scan in zip(record.scans, record.measured, strict=True)
    ]
    plan = record.next_scan
    return {
        "id": record.id,
        "state": record.state.value,
        "created": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="seconds"),
        "version": __version__,
        "outcome": describe_outcome(record),
        "facts": _list_facts(record),
        "warnings": [{"code": w.code, "detail": w.detail, "remedy": w.remedy} for w in record.warnings],
        "tolerance": {"error": record.request.tolerance.error, "confidence": record.request.tolerance.confidence},
        "range_std": record.request.sensor.range_std,
        "picture": _describe_picture(record),
        "regions": [_describe_region(record, k) for k in range(len(record.regions))],
        "origin": origin.tolist(),
        "unit": UNIT,
        "cloud": pack_points(_thin(record.scene.cloud, _MOST_POINTS), origin),
        "estimates": [_describe_estimate(estimate, origin) for estimate in list_estimates(record, events)],
        "scans": scans,
        "next_path": [] if plan is None else pack_points(_thin(plan.path.base_T_tip[:, :3, 3], share), origin),
        "camera": None if camera is None else _describe_camera(camera),
        "request": request_to_json(replace(record.request, prior=record.prior)),
    }


def _describe_camera(camera: CalibratedCamera) -> dict[str, Any]:
    """Its errors over the sessions, and whether it was moved."""
    document = camera_to_json(camera)
    return {name: document[name] for name in ("id", "sessions", "drift", "history")}


def _list_facts(record: Record) -> list[list[str]]:
    """Pairs of a name and a value."""
    used, budget, estimate = record.budget_used, record.request.budget, record.estimate
    forecast = [] if record.forecast is None else [["Forecast", describe_forecast(record.forecast)]]
    return [
        ["Correction", describe_correction(estimate)],
        ["The error counts at", describe_points(record.request.tolerance)],
        ["Expected error", f"{1000 * estimate.expected_error:.2f} mm"],
        ["Error, at most (95 %)", f"{1000 * estimate.error_quantile:.2f} mm"],
        ["Scans", f"{used.scans} of {budget.scans}"],
        ["Robot time", f"{used.seconds:.1f} of {budget.seconds:,.6g} s"],
        ["Share of the object scanned", f"{used.fraction:.1%} of {budget.fraction:.1%} allowed"],
        ["Samples that agree", f"{estimate.inliers} of {estimate.samples}"],
        ["Fit (p-value)", f"{estimate.fit:.3g}"],
        ["Paths that could not be reached", str(len(record.skipped))],
        ["Prior", _describe_prior(record.prior, estimate.centroid)],
        ["Proposer, planner", f"{record.proposer.value}, {record.request.planner.value}"],
        *forecast,
    ]


def _describe_prior(prior: AnyPrior, centroid: Array) -> str:
    shift = np.linalg.norm(prior.mean.apply(centroid) - centroid)
    turn = np.linalg.norm(vector_from_rotation(prior.mean.rotation))
    moved = f"moved by {1000 * shift:.1f} mm and {np.degrees(turn):.1f}°, " if shift > 0 or turn > 0 else ""
    return f"{moved}std up to {1000 * prior.translation_std:.3g} mm and {np.degrees(prior.rotation_std):.2g}°"


def _describe_picture(record: Record) -> dict[str, Any]:
    picture = draw_scene(record.scene)
    return {"data": picture.data, "window": picture.window, "near": picture.near, "far": picture.far}


def _describe_region(record: Record, index: int) -> dict[str, Any]:
    region = record.regions[index]
    r = record.to_scene(region.rectangle)
    return {
        "id": region.id,
        "corners": np.round(r.corners(), 1).tolist(),
        "confidence": region.confidence,
        "expected_error": region.expected_error,
        "scans": [k + 1 for k, scan in enumerate(record.scans) if scan.region_id == region.id],
    }


def _describe_scan(
    record: Record, summary: ScanSummary, scan: Scan, surface: Surface, origin: Array, most: int
) -> dict[str, Any]:
    hit = scan.returned
    hits, directions = _thin(scan.points(), most), _thin(scan.directions[hit], most)
    missed = _thin(scan.origins[~hit] + record.request.sensor.range_max * scan.directions[~hit], most // 2)
    has_beams = bool((scan.ranges[hit] > 0).any()) or not hit.any()
    tip = _thin(scan.origins, most // 2) if has_beams else np.zeros((0, 3))
    return {
        "id": summary.scan_id,
        "path": summary.path_id,
        "samples": summary.samples,
        "returns": summary.returns,
        "seconds": summary.duration,
        "length": summary.length,
        "hits": pack_points(hits, origin),
        "misses": pack_points(missed, origin),
        "tip": pack_points(tip, origin),
        "pixels": _to_pixels(record, hits[:: max(1, len(hits) // 200)]),
        "residuals": _measure_residuals(hits, directions, surface),
    }


def _believe_surface(record: Record) -> Surface:
    """The camera's points as presently corrected, as a cone sees them from the standoff."""
    surface = Surface.from_estimate(record.scene, record.estimate)
    radius = record.request.scan.standoff * float(np.tan(record.request.sensor.beam_half_angle))
    return surface.dilate(radius) if radius > 0 else surface


def _measure_residuals(hits: Array, directions: Array, surface: Surface) -> list[float]:
    """m: quantiles of how much farther along their beams the hits lie than the camera's points as corrected at the end;
    empty where no hit meets anything that the camera saw.
    """
    starts = hits - _LIFT * directions
    residuals = _LIFT - surface.predict_ranges(starts, directions)
    seen = surface.is_known_at(starts, directions) & (np.abs(residuals) < _LIFT)
    return [] if not seen.any() else [round(float(x), 6) for x in np.quantile(residuals[seen], _QUANTILES)]


def _describe_estimate(estimate: dict[str, Any], origin: Array) -> dict[str, Any]:
    """`turn` (9, row by row) and `shift` (3, m) correct a point about the origin, `axes` are the half axes (m) of the
    ellipsoid about `centre` (m, about the origin) in which the object's centre lies with 95 % probability.
    """
    correction = pose_from_json(estimate["base_T_correction"])
    variances, axes = np.linalg.eigh(np.array(estimate["covariance"]).reshape(6, 6)[3:, 3:])
    centre = correction.apply(np.array(estimate["centroid"])) - origin
    return {
        "turn": np.round(correction.rotation, 9).ravel().tolist(),
        "shift": np.round(correction.apply(origin) - origin, 7).tolist(),
        "centre": np.round(centre, 6).tolist(),
        "axes": np.round(_ELLIPSOID * np.sqrt(np.maximum(variances, 0)) * axes, 7).T.tolist(),
        "expected_error": estimate["expected_error"],
        "error_quantile": estimate["error_quantile"],
        "fit": estimate["fit"],
        "weak": [
            {"direction": np.round(each["direction"], 4).tolist(), "std": each["std"], "text": each["text"]}
            for each in estimate["unobservable"][:6]
        ],
    }


def _to_pixels(record: Record, points: Array) -> list[float]:
    """Where in the scene's image points (n, 3), m, in base, are seen as presently corrected: u, v, u, v, ..."""
    base_T_camera: Pose = record.estimate.base_T_correction @ record.scene.base_T_camera
    seen = base_T_camera.inverse().apply(points)
    pixels = record.scene.camera.project(seen[seen[:, 2] > 0.01])
    limit = 10 * max(record.scene.depth.metres.shape)
    return [round(float(x), 1) for x in pixels[(np.abs(pixels) < limit).all(axis=1)].ravel()]


def _thin(points: NDArray[np.float64], most: int) -> NDArray[np.float64]:
    """At most `most` of the points, evenly chosen."""
    if len(points) <= most:
        return points
    return np.asarray(points[np.linspace(0, len(points) - 1, most).astype(int)])


def pack_points(points: Array, origin: Array) -> list[int]:
    """The points (n, 3), m, in UNIT about the origin: x, y, z, x, y, z, ..."""
    return [int(x) for x in np.round((points - origin) / UNIT).ravel()]
