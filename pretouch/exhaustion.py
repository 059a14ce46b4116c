"""Why a session ended without meeting its tolerance, as its `reason` says it."""

from __future__ import annotations

from enum import StrEnum
from typing import Any, Final

from pretouch.errors import TYPE_PREFIX, WIRE, Conflict


class Exhaustion(StrEnum):
    """What ended an exhausted session; the `type` of its reason ends in it."""

    SCANS = "scans"
    SECONDS = "seconds"
    FRACTION = "fraction"
    NOTHING_TO_GAIN = "nothing-to-gain"
    OUT_OF_RANGE = "out-of-range"
    MISFIT = "misfit"
    SENSOR = "sensor"


_TITLES: Final = {
    Exhaustion.SCANS: "The session's scans are made",
    Exhaustion.SECONDS: "The session's robot seconds are spent",
    Exhaustion.FRACTION: "The session's share of the object is scanned",
    Exhaustion.NOTHING_TO_GAIN: "No region is left to scan",
    Exhaustion.OUT_OF_RANGE: "The finger met nothing within its range",
    Exhaustion.MISFIT: "The samples fit no pose",
    Exhaustion.SENSOR: "The samples are not measurements",
}


def exhaustion_problem(exhaustion: Exhaustion, detail: str, remedy: str) -> dict[str, Any]:
    """The RFC 9457 problem document of an exhausted session.

    Its status is that of asking the session for another scan, 409.

    Args:
        detail: what happened, in numbers.
        remedy: what the client can do about it.
    """
    return {
        "type": TYPE_PREFIX + exhaustion.value,
        "title": _TITLES[exhaustion],
        "status": WIRE[Conflict].http_status,
        "detail": detail,
        "remedy": remedy,
    }
