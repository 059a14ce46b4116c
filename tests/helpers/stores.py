"""Both kinds of store for tests that are the same for both."""

from __future__ import annotations

from typing import Any

import numpy as np

KINDS = ("sqlite", "postgresql")


def same(a: Any, b: Any) -> bool:
    """Equal to the bit, through dataclasses, tuples and arrays."""
    if isinstance(a, np.ndarray):
        return bool(a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes())
    if hasattr(a, "__dataclass_fields__"):
        return type(a) is type(b) and all(same(getattr(a, f), getattr(b, f)) for f in a.__dataclass_fields__)
    if isinstance(a, tuple):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    return bool(a == b)
