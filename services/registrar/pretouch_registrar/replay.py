"""Registers the scans of a recorded session again, one by one, as the session did."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pretouch.errors import InvalidInput, TooLarge
from pretouch.estimate import Estimate, from_prior
from pretouch.geometry import Array, vector_from_rotation
from pretouch.recording.session_file import SessionRecording
from pretouch.scene import Scene
from pretouch.tof import Scan
from pretouch.wire.common import estimate_from_proto, estimate_to_proto, scan_from_proto, scene_from_proto
from pretouch.wire.json import estimate_from_document, estimate_to_json
from pretouch_registrar.engines import Engine
from pretouch_registrar.registration import MAX_SAMPLES, Registrar, Settings
from pretouch_registrar.servicer import points_from_proto, settings_from_proto


@dataclass(frozen=True)
class Recorded:
    """A recorded session, validated.

    Attributes:
        estimates: one after each scan, to the rounding of their JSON.
        at: (k, 3), m, in base, as the camera puts them: where errors count; None: at the object's visible points.
    """

    scene: Scene
    scan_ids: tuple[str, ...]
    scans: tuple[Scan, ...]
    estimates: tuple[Estimate, ...]
    settings: Settings
    at: Array | None


@dataclass(frozen=True)
class Replayed:
    """A scan, what was estimated after it, and what is now.

    Attributes:
        identical: whether the two estimates are the same to the bit, as their JSON is.
        distance: m between where the two put the object's centroid.
        turn: rad between their rotations.
        seconds: s that the registration took.
    """

    scan_id: str
    samples: int
    recorded: Estimate
    estimate: Estimate
    identical: bool
    distance: float
    turn: float
    seconds: float


def read_recorded(recording: SessionRecording) -> Recorded:
    """The recorded session as the registrar takes it.

    Raises:
        InvalidInput: a message that no session has, or an engine that this version does not know.
        TooLarge: more samples than a session may have.
    """
    session = recording.session
    try:
        scans = tuple(scan_from_proto(each.scan) for each in recording.scans)
        if (count := sum(map(len, scans))) > MAX_SAMPLES:
            raise TooLarge(f"It has {count} samples; the limit is {MAX_SAMPLES}.", "Give a session's recording.")
        return Recorded(
            scene_from_proto(session.scene),
            tuple(each.scan_id for each in recording.scans),
            scans,
            tuple(estimate_from_proto(each.estimate) for each in recording.scans),
            settings_from_proto(session.settings, Engine.POSTERIOR),
            points_from_proto(session.settings),
        )
    except InvalidInput as error:
        raise type(error)(f"The recording cannot be replayed: {error.detail}", error.remedy) from error


def replay(recorded: Recorded, settings: Settings, registrar: Registrar) -> Iterator[Replayed]:
    """The estimates after each scan, with the settings given; with the recorded ones they are the recorded estimates to
    the bit, where pretouch, its numerical libraries and the kind of processor are the same.
    """
    present = from_prior(settings.prior, recorded.scene.cloud, recorded.at)
    steps = zip(recorded.scan_ids, recorded.scans, recorded.estimates, strict=True)
    for number, (scan_id, scan, before) in enumerate(steps, start=1):
        began = time.perf_counter()
        scans = _select_registrable(recorded.scans[:number])
        if len(scan) and scans:
            present = registrar.register(recorded.scene, scans, settings, recorded.at)
        seconds = time.perf_counter() - began
        shift = present.base_T_correction.apply(present.centroid) - before.base_T_correction.apply(before.centroid)
        turn = vector_from_rotation(present.base_T_correction.rotation @ before.base_T_correction.rotation.T)
        yield Replayed(
            scan_id,
            len(scan),
            before,
            present,
            _serialise(_round(present)) == _serialise(before),
            float(np.linalg.norm(shift)),
            float(np.linalg.norm(turn)),
            seconds,
        )


def _select_registrable(scans: Sequence[Scan]) -> tuple[Scan, ...]:
    """Those that a session registers: all with samples, once one sample of any has returned."""
    if not any(scan.returned.any() for scan in scans):
        return ()
    return tuple(scan for scan in scans if len(scan))


def _round(estimate: Estimate) -> Estimate:
    """As it is recorded: as its JSON says, whose poses are quaternions."""
    return estimate_from_document(estimate_to_json(estimate, None))


def _serialise(estimate: Estimate) -> bytes:
    """Without what JSON leaves out."""
    told = replace(estimate, sensor_problem="", engine="")
    return estimate_to_proto(told).SerializeToString(deterministic=True)
