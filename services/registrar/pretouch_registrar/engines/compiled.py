"""Options for compiling the innermost kernels."""

from __future__ import annotations

from typing import Any

NO_REFERENCES: dict[str, Any] = {"_nrt": False}
"""Options of numba's njit for kernels that allocate nothing.

They switch reference counting off: otherwise taking an array out of a named tuple increments and decrements a counter
atomically for each array in it, which takes longer than the arithmetic of a beam.
"""
