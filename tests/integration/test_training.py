"""The network's training, with torch, each check in a process of its own."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="torch is not installed")
TESTS = Path(__file__).parents[1]
CHECKS = ["-m", "helpers.training_checks"]


@pytest.mark.parametrize(
    "check", ["perimeters", "learns", "resumes", "served_equals_torch", "commanded", "shipped", "refuses"]
)
def test_training(check: str, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, *CHECKS, check, tmp_path], cwd=TESTS, capture_output=True, text=True, timeout=280
    )
    assert done.returncode == 0, done.stderr


def test_two_processes_learn_together(tmp_path: Path) -> None:
    run = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", *CHECKS]
    done = subprocess.run([*run, "shared", tmp_path], cwd=TESTS, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "log.json").exists()
