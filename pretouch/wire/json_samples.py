"""Results of scans <-> JSON. They are read column by column, so that 20,000 samples take a fraction of a second."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from typing import Any

import numpy as np

from pretouch.errors import InvalidInput, TooLarge
from pretouch.geometry import QUATERNION_NORM_TOLERANCE, Array, quaternion_from_rotation, rotation_from_quaternion
from pretouch.session import GatewaySpan, Points, SampleChunk, Skipped, Submission, Telling
from pretouch.tof import MAX_SAMPLES, RangeSamples
from pretouch.wire.reader import Members, read_number, read_numbers, read_pose

_SAMPLE = ("t", "base_T_tip", "range", "status", "module")
_KINDS = ("samples", "points", "gateway", "skipped")
MAX_CODE = 255
"""Status and module are one byte each."""


def submission_to_json(submission: Submission) -> dict[str, Any]:
    """The body of `POST /v1/sessions/{id}/scans/{scan_id}`."""
    match submission:
        case RangeSamples():
            return {"samples": _samples_to_json(submission)}
        case Points():
            return {"points": submission.points.tolist()}
        case GatewaySpan():
            return _span_to_json(submission)
        case Skipped():
            taken = {} if submission.samples is None else {"samples": _samples_to_json(submission.samples)}
            return {"skipped": submission.reason} | taken


def submission_from_json(document: object) -> Submission:
    """Reads what `submission_to_json` writes.

    Raises:
        InvalidInput: none or several of the kinds, no points, or a member that is wrong.
        Malformed: a number that is not finite.
        TooLarge: more than MAX_SAMPLES samples or points.
    """
    members = Members(document, "", _KINDS)
    given = [name for name in _KINDS if name in members]
    if given == ["gateway"]:
        return _span_from_json(members)
    if given in (["skipped"], ["samples", "skipped"]):
        reason = members.text("skipped")
        return Skipped(_samples_from_json(members.items("samples")) if "samples" in members else None, reason)
    if given == ["samples"]:
        return _samples_from_json(members.items("samples"))
    if given == ["points"]:
        return Points(_read_rows(_read_points(members), 3, "points[{}]"))
    raise InvalidInput(
        f"The scan has {', '.join(given) or 'none of samples, points, gateway and skipped'}.",
        "Send one of samples, points, gateway or skipped; samples may come along with skipped.",
    )


def telling_to_json(telling: Telling) -> dict[str, Any]:
    """The body of `POST /v1/sessions/{id}/scans/{scan_id}/samples`."""
    match telling:
        case SampleChunk():
            return {"from": telling.start, "samples": _samples_to_json(telling.samples)}
        case GatewaySpan():
            return _span_to_json(telling)


def telling_from_json(document: object) -> Telling:
    """Reads what `telling_to_json` writes.

    Raises:
        InvalidInput: neither samples nor a span, or a member that is wrong.
        Malformed: a number that is not finite.
        TooLarge: more than MAX_SAMPLES samples.
    """
    members = Members(document, "", ("from", "samples", "gateway"))
    if "gateway" in members:
        return _span_from_json(Members(document, "", ("gateway",)))
    return SampleChunk(members.integer("from"), _samples_from_json(members.items("samples")))


def _span_to_json(span: GatewaySpan) -> dict[str, Any]:
    return {"gateway": {"device": span.device, "from": span.start, "to": span.end}}


def _span_from_json(members: Members) -> GatewaySpan:
    span = members.members("gateway", ("device", "from", "to"))
    return GatewaySpan(span.text("device"), span.number("from"), span.number("to"))


def poses_to_json(poses: Array) -> list[dict[str, Any]]:
    """Poses (n, 4, 4) as JSON poses."""
    return [
        {"translation": pose[:3, 3].tolist(), "rotation": quaternion_from_rotation(pose[:3, :3]).tolist()}
        for pose in poses
    ]


def poses_from_json(values: Sequence[object], path: str) -> Array:
    """JSON poses as (n, 4, 4); `path` with the index at its `{}` names each in errors."""
    members = _split_columns(values, ("translation", "rotation"), path)
    translations = _read_rows(members["translation"], 3, path + ".translation")
    quaternions = _read_rows(members["rotation"], 4, path + ".rotation")
    norms = np.linalg.norm(quaternions, axis=1)
    off = np.flatnonzero(np.abs(norms - 1.0) > QUATERNION_NORM_TOLERANCE)
    if len(off):
        read_pose(values[off[0]], path.format(off[0]))
    poses = np.tile(np.eye(4), (len(values), 1, 1))
    poses[:, :3, :3] = np.moveaxis(rotation_from_quaternion((quaternions / norms[:, None]).T), -1, 0)
    poses[:, :3, 3] = translations
    return poses


def _samples_to_json(samples: RangeSamples) -> list[dict[str, Any]]:
    ranges = [None if value != value else value for value in samples.range.tolist()]
    columns = (samples.t.tolist(), poses_to_json(samples.base_T_tip), ranges)
    codes = (samples.status.tolist(), samples.module.tolist())
    return [dict(zip(_SAMPLE, row, strict=True)) for row in zip(*columns, *codes, strict=True)]


def _samples_from_json(values: list[Any]) -> RangeSamples:
    if len(values) > MAX_SAMPLES:
        raise TooLarge(f"samples has {len(values)} items; the limit is {MAX_SAMPLES}.", "Thin out the scan.")
    columns = _split_columns(values, _SAMPLE, "samples[{}]", {"status": 0, "module": 0})
    missing = np.array([value is None for value in columns["range"]], dtype=bool)
    ranges = _read_column([0.0 if value is None else value for value in columns["range"]], "samples[{}].range")
    return RangeSamples(
        t=_read_column(columns["t"], "samples[{}].t"),
        base_T_tip=poses_from_json(columns["base_T_tip"], "samples[{}].base_T_tip"),
        range=np.where(missing, np.nan, ranges),
        status=_read_codes(columns["status"], "samples[{}].status"),
        module=_read_codes(columns["module"], "samples[{}].module"),
    )


def _read_points(members: Members) -> list[Any]:
    values = members.items("points")
    if not values:
        raise InvalidInput("points is empty.", 'Send what the sensor gave, or {"skipped": "unreachable"}.')
    if len(values) > MAX_SAMPLES:
        raise TooLarge(f"points has {len(values)} items; the limit is {MAX_SAMPLES}.", "Thin out the scan.")
    return values


def _split_columns(
    values: Sequence[Any], names: tuple[str, ...], path: str, defaults: dict[str, Any] | None = None
) -> dict[str, list[Any]]:
    """The members of JSON objects, one list for each name."""
    defaults = defaults or {}
    if not set(map(type, values)) <= {dict} or any(
        not required <= set(keys) <= set(names)
        for required in [set(names) - set(defaults)]
        for keys in set(map(tuple, values))
    ):
        for k, value in enumerate(values):
            members = Members(value, path.format(k), names)
            for name in names:
                members.get(name, *([defaults[name]] if name in defaults else []))
    return {
        name: [value.get(name, defaults[name]) for value in values]
        if name in defaults
        else [value[name] for value in values]
        for name in names
    }


def _read_column(values: list[Any], path: str) -> Array:
    """JSON numbers as (n,)."""
    if set(map(type, values)) <= {int, float}:
        try:
            column = np.array(values, dtype=np.float64)
        except OverflowError:
            column = np.array([np.nan])
        if np.isfinite(column).all():
            return column
    return np.array([read_number(value, path.format(k)) for k, value in enumerate(values)])


def _read_rows(values: list[Any], width: int, path: str) -> Array:
    """JSON lists of `width` numbers each as (n, width)."""
    if set(map(type, values)) <= {list} and set(map(len, values)) <= {width}:
        flat = list(chain.from_iterable(values))
        if set(map(type, flat)) <= {int, float}:
            try:
                rows = np.array(flat, dtype=np.float64).reshape(-1, width)
            except OverflowError:
                rows = np.array([np.nan])
            if np.isfinite(rows).all():
                return rows
    return np.array([read_numbers(value, path.format(k), width) for k, value in enumerate(values)])


def _read_codes(values: list[Any], path: str) -> np.ndarray[Any, np.dtype[np.int64]]:
    """JSON whole numbers from 0 to MAX_CODE as (n,)."""
    column = _read_column(values, path)
    bad = np.flatnonzero((column != np.floor(column)) | (column < 0) | (column > MAX_CODE))
    if len(bad):
        raise InvalidInput(
            f"{path.format(bad[0])} is {values[bad[0]]!r:.40}.", f"Send a whole number from 0 to {MAX_CODE}."
        )
    return column.astype(np.int64)
