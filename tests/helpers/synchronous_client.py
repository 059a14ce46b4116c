"""Generates `pretouch.client.synchronous` from `pretouch.client.asynchronous`: `python -m helpers.synchronous_client`.

Word by word, then formatted by ruff: what differs between the two, asyncio's side and the threads', has two names in
`pretouch.client`, one for each.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from helpers.sources import ROOT

_CLIENT = ROOT / "pretouch/client"
SOURCES = sorted((_CLIENT / "asynchronous").glob("*.py"))
_HEADER = "# Generated from pretouch/client/asynchronous by `make client`: change that.\n"
_WORDS = {
    "__aenter__": "__enter__",
    "__aexit__": "__exit__",
    "AsyncCalls": "SyncCalls",
    "AsyncClient": "SyncClient",
    "AsyncExecution": "Execution",
    "AsyncGenerator": "Generator",
    "AsyncGatewayClient": "GatewayClient",
    "AsyncGrpcClient": "GrpcClient",
    "AsyncIterable": "Iterable",
    "AsyncIterator": "Iterator",
    "AsyncRestClient": "RestClient",
    "AsyncSignal": "Signal",
    "aclose": "close",
    "aclosing": "closing",
    "aiter_bytes": "iter_bytes",
    "drive_async": "drive",
    "open_async_http": "open_http",
    "open_channel": "open_sync_channel",
    "within_async": "within",
}
_MODULES = (
    ("pretouch.client.asynchronous", "pretouch.client.synchronous"),
    ("import asyncio\n", "import time\n"),
    ("asyncio.sleep", "time.sleep"),
)
_INIT = '"""The synchronous clients, generated from `asynchronous`."""\n'


def target(source: Path) -> Path:
    """Where the synchronous form of a module lies."""
    return _CLIENT / "synchronous" / source.name


def generate(source: Path) -> str:
    """The synchronous form of a module."""
    text = source.read_text()
    if source.name == "__init__.py":
        return _HEADER + _INIT
    for before, after in _MODULES:
        text = text.replace(before, after)
    text = re.sub(r"\b(async|await) (?=[a-z_(*]|with\b)", "", text)
    text = re.sub(r"\w+", lambda word: _WORDS.get(word[0], word[0]), text)
    for command in (["check", "--fix-only", "--select", "I", "-"], ["format", "-"]):
        options = ["--quiet", "--stdin-filename", str(target(source))]
        run = [sys.executable, "-m", "ruff", command[0], *options, *command[1:]]
        text = subprocess.run(run, input=text, capture_output=True, text=True, check=True, cwd=ROOT).stdout
    return _HEADER + text


if __name__ == "__main__":
    for path in SOURCES:
        target(path).write_text(generate(path))
