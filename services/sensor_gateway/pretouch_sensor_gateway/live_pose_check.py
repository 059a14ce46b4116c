"""Notices a robot whose clock is not the gateway's, by the times of the poses that it sends as it moves."""

from __future__ import annotations

from pretouch.errors import InvalidInput

MAX_DIFFERENCE = 1.0
"""Seconds that live poses may be from now: what a busy robot is late by."""
STAY = 1.0
"""Seconds for which they must be further than that to be refused. No point can have come of them by then."""
_SAME_PACE = 0.5
"""Seconds by which the difference may change meanwhile; planned motions that are sent at once change it by more."""


class LivePoseCheck:
    """Follows the messages of one call. A motion that is planned ahead and sent at once is no live one."""

    def __init__(self) -> None:
        self._since: tuple[float, float] | None = None  # when the difference began, and what it was

    def observe(self, first: float, last: float, now: float, offset: float) -> None:
        """Checks a message whose poses are of times from `first` to `last`, s, received at `now`, s.

        Args:
            offset: the robot's clock minus the gateway's, s, that was subtracted from these times.

        Raises:
            InvalidInput: poses have come for `STAY` s as time goes, all of them more than `MAX_DIFFERENCE` from now.
        """
        difference = max(first - now, 0.0) + min(last - now, 0.0)
        if abs(difference) <= MAX_DIFFERENCE:
            self._since = None
        elif self._since is None or abs(difference - self._since[1]) > _SAME_PACE:
            self._since = (now, difference)
        elif now - self._since[0] >= STAY:
            apart = last - now  # the newest pose is the one that a live robot sends at its own now
            raise InvalidInput(
                f"Tip poses keep coming that are {abs(apart):.3f} s {'ahead of' if apart > 0 else 'behind'} "
                "the gateway's clock, so their points would lie where the tip was not.",
                f"Send clock_offset, the robot's clock minus the gateway's (about {offset + apart:.3f} s), or "
                "robot_clock in every message, or keep both clocks in step (NTP). GetStatus tells the gateway's now.",
            )
