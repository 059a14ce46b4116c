"""A reflex for robots whose finger the sensor gateway reads: it follows the fused samples while the tip moves."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from pretouch.client.reflex import Reflex
from pretouch.errors import PretouchError, Unavailable, from_rpc_error
from pretouch.geometry import Array
from pretouch.tof import RangeSamples
from pretouch.v1.sensor_gateway_pb2 import StreamPointsResponse
from pretouch.wire.common import samples_from_proto

SILENCE = 0.5
"""s without a sample after which the tip must not move on."""
_ABSENT = 255


class Guard:
    """Keeps a reflex up to date with what the gateway's StreamPoints answers, in a thread of its own.

        guard = Guard(gateway.StreamPoints(tell_tip_poses()))
        while the tip moves along path:
            move_to(guard.reflex.raise_tip(path.at([now])[0]))
        guard.finish()  # after the last tip pose was told

    Args:
        answers: what StreamPoints returned.
    """

    def __init__(self, answers: Iterable[StreamPointsResponse]) -> None:
        self._reflex = Reflex()
        self._heard = time.monotonic()
        self._failure: Exception | None = None
        self._thread = threading.Thread(target=self._listen, args=(answers,), daemon=True)
        self._thread.start()

    @property
    def reflex(self) -> Reflex:
        """The reflex after the last sample.

        Raises:
            Unavailable: the stream has failed, or no sample has come for `SILENCE` s.
        """
        if self._failure is not None or time.monotonic() - self._heard > SILENCE:
            raise Unavailable(
                f"The finger is not heard. {self._failure or ''}".strip(), "Look at the gateway's log and its device."
            )
        return self._reflex

    def finish(self) -> None:
        """Waits until the last sample has its pose.

        Raises:
            PretouchError: the stream failed.
        """
        self._thread.join()
        if self._failure is not None:
            raise self._failure

    def _listen(self, answers: Iterable[StreamPointsResponse]) -> None:
        at = np.inf
        try:
            for answer in answers:
                samples = samples_from_proto(answer.samples)
                for t in np.unique(samples.t):
                    ranges, status = _arrange_by_module(samples, t, len(self._reflex.ahead))
                    self._reflex = self._reflex.update(ranges, status, max(float(t) - at, 0.0))
                    self._heard, at = time.monotonic(), float(t)
        except Exception as error:  # whatever it is, the robot must hear of it
            self._failure = error if isinstance(error, PretouchError) else from_rpc_error(error)


def _arrange_by_module(samples: RangeSamples, t: float, least: int) -> tuple[Array, NDArray[np.int64]]:
    """Ranges and status codes (m,) of the samples at time `t`, of `least` modules or more; NaN for one without any."""
    chosen = np.flatnonzero(samples.t == t)
    count = max(least, int(samples.module[chosen].max()) + 1)
    ranges, status = np.full(count, np.nan), np.full(count, _ABSENT)
    ranges[samples.module[chosen]], status[samples.module[chosen]] = samples.range[chosen], samples.status[chosen]
    return ranges, status
