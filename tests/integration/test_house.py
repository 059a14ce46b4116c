"""The house keeps its own rules: stubs as generated, rooms import what they may, types and style hold."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

HOUSE = Path(__file__).resolve().parents[2]
BIN = Path(sys.executable).parent


def run(*command: str) -> None:
    done = subprocess.run(command, cwd=HOUSE, capture_output=True, text=True, timeout=280, check=False)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]


def test_the_stubs_are_what_the_protos_generate(tmp_path: Path) -> None:
    plugins = [f"--plugin={name}={BIN / name}" for name in ("protoc-gen-mypy", "protoc-gen-mypy_grpc")]
    outputs = [f"--{kind}_out={tmp_path}" for kind in ("python", "grpc_python", "mypy", "mypy_grpc")]
    protos = sorted(str(path.relative_to(HOUSE)) for path in (HOUSE / "proto").rglob("*.proto"))
    run(sys.executable, "-m", "grpc_tools.protoc", "-I", "proto", *plugins, *outputs, *protos)
    generated = {path.name: path.read_text() for path in (tmp_path / "pretouch/v1").iterdir()}
    committed = {path.name: path.read_text() for path in (HOUSE / "pretouch/v1").glob("*_pb2*")}
    assert committed == generated, "Run `make proto` and commit pretouch/v1."


@pytest.mark.parametrize(
    "command",
    [
        ("buf", "lint", "proto"),
        ("lint-imports",),
        ("ruff", "check", "."),
        ("ruff", "format", "--check", "."),
        ("mypy",),
    ],
    ids=" ".join,
)
def test_the_linters_find_nothing(command: tuple[str, ...]) -> None:
    run(str(BIN / command[0]), *command[1:])
