"""A service's log stays small: no flood of one error, no endless line, and every line is still JSON."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Iterator
from typing import Any

import pytest
import structlog

from pretouch.serving.logs import configure_logs


@pytest.fixture(autouse=True)
def _restore() -> Iterator[None]:
    root = logging.getLogger()
    handlers, level, config = root.handlers[:], root.level, structlog.get_config()
    yield
    root.handlers[:], root.level = handlers, level
    structlog.configure(**config)


def lines(capsys: pytest.CaptureFixture[str]) -> list[dict[str, Any]]:
    return [json.loads(line) for line in capsys.readouterr().err.splitlines()]


def fail(depth: int = 0) -> None:
    if depth > 300:
        raise ZeroDivisionError("the reason")
    fail(depth + 1)


def test_a_flood_is_counted_instead_of_written(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now = time.monotonic()
    monkeypatch.setattr(time, "monotonic", lambda: now)
    configure_logs("test", "info")
    own, library = structlog.get_logger("pretouch.test"), logging.getLogger("asyncio")
    for k in range(5000):
        own.warning("a connection could not be accepted", number=k)
        library.error("socket.accept() out of system resource\nsocket: <%d>", k)
        own.info("request", number=k)
    written = lines(capsys)
    assert sum(line["event"] == "request" for line in written) == 5000
    assert len(written) == 5020
    now += 61.0
    own.warning("a connection could not be accepted", number=-1)
    library.error("socket.accept() out of system resource\nsocket: <%d>", -1)
    own.error("something else")
    last = lines(capsys)
    assert last[0]["left_out"] == 4990
    assert "4990 more" in last[1]["event"]
    assert last[2]["event"] == "something else"


def test_long_values_and_traces_are_shortened(capsys: pytest.CaptureFixture[str]) -> None:
    configure_logs("test", "info")
    log = structlog.get_logger("pretouch.test")
    log.info("x" * 1_000_000, path="\x00" * 1_000_000, items=list(range(1_000_000)), odd=object(), ok=[1], none=None)
    try:
        fail()
    except ZeroDivisionError as error:
        log.error("a defect", exc_info=error)
    raw = capsys.readouterr().err.splitlines()
    assert max(map(len, raw)) < 40_000
    first, second = map(json.loads, raw)
    assert first["ok"] == [1]
    assert second["exception"].endswith("ZeroDivisionError: the reason")
