"""What a scan is predicted to tell before it is made: candidates, and what is predicted of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pretouch.errors import InvalidInput
from pretouch.trajectory import Trajectory

MAX_PIECES = 2000
"""Scans that one call may ask about: candidates without spans, and the spans of the others."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A path, and the pieces of it whose scans are considered.

    Attributes:
        path: of the tip in base.
        spans: start and end of each piece, in seconds on the path's own clock; empty: the whole path.

    Raises:
        InvalidInput: a span is empty or leaves the path.
    """

    path: Trajectory
    spans: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        first, last = float(self.path.t[0]), float(self.path.t[-1])
        for start, end in self.spans:
            if not first <= start < end <= last:
                raise InvalidInput(
                    f"A span is from {start:g} to {end:g} s, its path from {first:g} to {last:g} s.",
                    "Send spans that end after they start and lie within their path.",
                )

    @property
    def pieces(self) -> tuple[tuple[float, float], ...]:
        """The spans; where there are none, that of the whole path."""
        return self.spans or ((float(self.path.t[0]), float(self.path.t[-1])),)


@dataclass(frozen=True)
class Prediction:
    """What one scan is predicted to leave and to return.

    Attributes:
        expected_error: what `Estimate.expected_error` would become, in metres.
        expected_returns: share of the samples, of all modules, that are expected to come back within the range.
    """

    expected_error: float
    expected_returns: float


def check_pieces(candidates: Sequence[Candidate]) -> None:
    """Raises InvalidInput if the candidates have more than MAX_PIECES pieces together."""
    count = sum(len(candidate.pieces) for candidate in candidates)
    if count > MAX_PIECES:
        raise InvalidInput(
            f"The candidates have {count} pieces; the limit is {MAX_PIECES}.", "Send fewer candidates or spans a call."
        )
