"""How many bytes of requests a service holds at once."""

from __future__ import annotations

from pretouch.errors import Overloaded

MAX_HELD = 256 * 1024 * 1024
"""Bytes; eight of the largest messages, and hundreds of a camera's usual images."""
_LEAST = 64 * 1024  # what holding any request costs


class HeldBytes:
    """Counts the bytes of requests that are being received or served, over both wires."""

    def __init__(self) -> None:
        self._held = 0

    @property
    def held(self) -> int:
        """Bytes at present."""
        return self._held

    def take(self, size: int) -> int:
        """Counts a request of `size` bytes; what to `free` once it is served.

        Raises:
            Overloaded: there would be more than MAX_HELD.
        """
        taken = max(size, _LEAST)
        if self._held + taken > MAX_HELD:
            raise Overloaded("The service holds as many requests as it has memory for.", "Try again shortly.")
        self._held += taken
        return taken

    def free(self, taken: int) -> None:
        """Ends what `take` began."""
        self._held -= taken
