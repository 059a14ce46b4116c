"""A scan in simulated time by a robot that tells its samples as it moves, and leaves the path once they are enough."""

from __future__ import annotations

from pretouch_orchestrator.sessions.loop import Loop
from pretouch_orchestrator.sessions.progress import is_assessable
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.sessions.told import add_told

from pretouch.session import SampleChunk
from pretouch.tof import RangeSamples
from pretouch_simulation.scanning import cut_pieces

NOTHING = RangeSamples.concatenate([])
"""Closes a scan whose samples were told."""
_NEAR, _FAR = 2, 4
"""Pieces of a quarter of a second between assessments: half a second, and a second."""


async def tell_until_enough(loop: Loop, record: Record, samples: RangeSamples) -> Record:
    """The session with the first of the samples told: those after which it would have converged, or all of them.

    They are assessed as the services do it, but less often, so that it takes less time to compute: every _NEAR pieces,
    and every _FAR as long as the error's quantile is more than twice the tolerance.

    Raises:
        PretouchError: as `Loop.assess`, or the samples do not fit the session's sensor.
    """
    due = _NEAR
    for number, piece in enumerate(cut_pieces(samples), start=1):
        record = add_told(record, SampleChunk(len(record.told_samples), piece))
        if number < due or not is_assessable(record):
            continue
        assessment = await loop.assess(record)
        if assessment.enough:
            break
        due = number + (_NEAR if assessment.error_quantile <= 2 * record.request.tolerance.error else _FAR)
    return record
