"""The modules of `experiments/`, which is a folder of commands and no package."""

import importlib
import sys
from pathlib import Path

EXPERIMENTS = Path(__file__).resolve().parents[1] / "experiments"
sys.path.append(str(EXPERIMENTS))

kept, one_scan, one_scan_figures, one_scan_text, oracle, sessions, table1, transfer = map(
    importlib.import_module,
    ("kept", "one_scan", "one_scan_figures", "one_scan_text", "oracle", "sessions", "table1", "transfer"),
)
