"""Where experiments read from and write to by default."""

from __future__ import annotations

import os
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[1]
SHARED = Path(os.environ.get("PRETOUCH_SHARED", _ROOT.parent / "shared"))
RESULTS = _ROOT / "docs" / "results"
