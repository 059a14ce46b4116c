"""Whether all that sessions need is there: the store, and the other services."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping

from pretouch.errors import PretouchError, Unavailable


class Readiness:
    """Checks the parts, all at once.

    Args:
        checks: by the part's name; each raises a `PretouchError` while its part cannot be used.
    """

    def __init__(self, checks: Mapping[str, Callable[[], Awaitable[None]]]) -> None:
        self._checks = dict(checks)

    async def __call__(self) -> None:
        """Raises `Unavailable`, which says all that is wrong."""
        failures = [problem for problem in (await self.find_problems()).values() if problem is not None]
        if failures:
            raise Unavailable(
                " ".join(str(failure) for failure in failures), "Start or repair what is named, then check again."
            )

    async def find_problems(self) -> dict[str, PretouchError | None]:
        """What is wrong with each part; None where nothing is."""
        results = await asyncio.gather(*(check() for check in self._checks.values()), return_exceptions=True)
        problems: dict[str, PretouchError | None] = {}
        for name, result in zip(self._checks, results, strict=True):
            if isinstance(result, BaseException) and not isinstance(result, PretouchError):
                raise result
            problems[name] = result
        return problems
