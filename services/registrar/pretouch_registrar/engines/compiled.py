"""How the innermost kernels are compiled."""

from __future__ import annotations

from typing import Any

NO_REFERENCES: dict[str, Any] = {"_nrt": False}
"""Options to numba's njit for kernels that allocate nothing.

They count no references: taking an array out of a named tuple would otherwise count one up and one down, atomically,
for each array in it, which costs more than the arithmetic of a beam.
"""
