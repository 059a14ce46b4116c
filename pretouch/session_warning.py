"""What is legal but odd about the input of a session, and what to do about it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class SessionWarning:
    """Input that is legal but most often a mistake.

    Attributes:
        code: name of the kind of oddity, which stays the same from release to release.
        detail: what was seen, in numbers.
        remedy: what to do if it was a mistake.
    """

    code: str
    detail: str
    remedy: str


def merge_warnings(earlier: Iterable[SessionWarning], new: Iterable[SessionWarning]) -> tuple[SessionWarning, ...]:
    """All warnings, one of each kind: a new one takes the place of an earlier one of its kind."""
    by_code = {warning.code: warning for warning in earlier}
    by_code.update({warning.code: warning for warning in new})
    return tuple(by_code.values())
