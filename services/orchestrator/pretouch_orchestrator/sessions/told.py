"""The samples of a planned scan that are told while the robot moves: how they add up, and what the scan was then."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pretouch.errors import Conflict, InvalidInput
from pretouch.session import GatewaySpan, Points, SampleChunk, ScanPlan
from pretouch.tof import RangeSamples
from pretouch_orchestrator.perception.scan_check import check_samples
from pretouch_orchestrator.sessions.record import Record


class Flight(NamedTuple):
    """How far, m, and how long, s, the tip moved in a scan."""

    length: float
    duration: float


def check_open(record: Record, scan_id: str) -> None:
    """Raises `Conflict` if the scan was answered already."""
    if scan_id in record.answered:
        raise Conflict(
            f"The scan {scan_id!r:.80} is closed and takes no more samples.",
            "Stop the robot, then read the session and go on with its next_scan.",
        )


def add_told(record: Record, told: SampleChunk | RangeSamples) -> Record:
    """The session with those of the samples that it was not told yet; `record` itself if there is none.

    Args:
        told: a chunk of the scan, or samples of the gateway. Of a chunk, the samples from number `start` on count up to
            those that were told before; a sample of the gateway is known by its time and module.

    Raises:
        Conflict: samples are missing before the chunk.
        InvalidInput: the samples go back in time, do not fit the session's sensor, or cannot be of the planned scan.
        TooLarge: more than MAX_SAMPLES in all.
    """
    if isinstance(told, SampleChunk):
        before = record.told_samples
        count = len(before)
        if told.start > count:
            raise Conflict(
                f"The chunk starts at sample {told.start}; told is {count}.",
                f"Send the samples of the scan from number {count} on.",
            )
        new = told.samples.select(slice(count - told.start, None))
        _check_order(before, new)
    else:
        new = _select_untold(record, told)
    if len(new) == 0:
        return record
    new.beams(record.request.sensor)
    if record.next_scan is not None:
        check_samples(new, record.next_scan, record.scene, record.request.sensor)
    return record.with_told(new)


def complete_with_rest(record: Record, rest: RangeSamples | Points) -> RangeSamples | Points:
    """The whole scan: what was told of it, and the rest.

    Raises:
        InvalidInput: the rest goes back in time, points follow samples, or there is neither a rest nor anything told.
        TooLarge: more than MAX_SAMPLES in all.
    """
    told = record.told_samples
    if isinstance(rest, RangeSamples):
        _check_order(told, rest)
        rest = RangeSamples.concatenate([told, rest])
    elif len(told):
        raise InvalidInput(
            f"The scan is closed with points, but {len(told)} samples were told.",
            'Close it with the rest of its samples; {"samples": []} if all were told.',
        )
    if len(rest if isinstance(rest, RangeSamples) else rest.points) == 0:
        raise InvalidInput(
            "The scan is empty.",
            'Send all of its samples, those without a return included, or {"skipped": "unreachable"} if the robot '
            "cannot make it.",
        )
    return rest


def complete_from_gateway(record: Record, span: GatewaySpan, fetched: RangeSamples) -> RangeSamples:
    """The whole scan: what was told of it, and those of the gateway's samples of `span` that were not.

    Raises:
        InvalidInput: there are none at all.
        TooLarge: more than MAX_SAMPLES in all.
    """
    whole = RangeSamples.merge([*record.told, _select_untold(record, fetched)])
    if len(whole) == 0:
        raise InvalidInput(
            f"The gateway has no samples from {span.start:.6f} to {span.end:.6f} s.",
            "Send tip poses while the robot moves, to POST /v1/devices/{name}/poses or the gateway's StreamPoints, and "
            "give a span of that time by the clock of the gateway's host.",
        )
    return whole


def measure_flight(record: Record, plan: ScanPlan, submission: RangeSamples | Points) -> Flight:
    """How the tip moved: as the samples say where any were told; else along the plan, at least as long as planned."""
    if not isinstance(submission, RangeSamples):
        return Flight(plan.path.length, plan.path.duration)
    duration = float(submission.t[-1] - submission.t[0])
    if not record.told:
        return Flight(plan.path.length, max(plan.path.duration, duration))
    steps = np.diff(submission.base_T_tip[:, :3, 3], axis=0)
    return Flight(float(np.linalg.norm(steps, axis=1).sum()), duration)


def _select_untold(record: Record, fetched: RangeSamples) -> RangeSamples:
    told = record.told_samples
    known = set(zip(told.t.tolist(), told.module.tolist(), strict=True))
    pairs = zip(fetched.t.tolist(), fetched.module.tolist(), strict=True)
    return fetched.select(np.array([pair not in known for pair in pairs], dtype=bool))


def _check_order(told: RangeSamples, new: RangeSamples) -> None:
    if len(told) and len(new) and new.t[0] < told.t[-1]:
        raise InvalidInput(
            f"samples[0].t is {new.t[0]:g}, before the last sample that was told, at {told.t[-1]:g}.",
            f"Send only samples that follow the {len(told)} told, in the order of time.",
        )
