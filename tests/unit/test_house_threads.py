"""CPU work of the services goes through their bounded pools: no module uses asyncio's own, whose size nobody chose."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
SOURCES = sorted([*ROOT.glob("services/**/*.py"), *ROOT.glob("pretouch/serving/*.py")])
ALLOWED = {
    "services/orchestrator/pretouch_orchestrator/store": "waits for the disk, in few threads",
    "services/sensor_gateway/pretouch_sensor_gateway/recording": "reads a file ahead, one thread a device",
}
"""Folders that wait for files and not for a processor."""


def test_numpy_is_not_imported_before_a_service_has_said_how_many_threads_it_may_use() -> None:
    program = "import sys, pretouch.__main__, pretouch.cli; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


def uses_default_executor(tree: ast.AST) -> bool:
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and node.attr in ("to_thread", "run_in_executor", "set_default_executor"):
            return True
        if isinstance(node, ast.ImportFrom) and any(alias.name == "to_thread" for alias in node.names):
            return True
    return False


def test_no_module_takes_a_thread_past_the_pools() -> None:
    offenders = [
        name
        for source in SOURCES
        if not (name := str(source.relative_to(ROOT))).startswith(tuple(ALLOWED))
        and uses_default_executor(ast.parse(source.read_text()))
    ]
    assert not offenders, "use ServiceContext.run_in_thread"
    assert uses_default_executor(ast.parse("await asyncio.to_thread(f)"))
