"""What a fake service answers where a test has no use for a method."""

from __future__ import annotations

from typing import Any

import grpc


def unimplemented(*call: Any, **_: Any) -> Any:
    """A servicer's method (self, request, context): ends the call as a server does that lacks it."""
    servicer, _request, context = call
    context.abort(grpc.StatusCode.UNIMPLEMENTED, f"{type(servicer).__name__} does not have this method.")
