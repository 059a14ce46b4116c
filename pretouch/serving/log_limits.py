"""Keeps logs small whatever happens: values are shortened, and what repeats is counted instead of written."""

from __future__ import annotations

import json
import logging
import time
from collections import OrderedDict

import structlog

LONGEST_VALUE = 2000
LONGEST_TRACE = 8000
"""Characters of a value, or of a trace, in a line of the log."""
_BURST, _WINDOW = 10, 60.0  # lines of one kind that are written in as many seconds
_MAX_KINDS = 1000


def shorten_values(_: object, __: str, event: structlog.typing.EventDict) -> structlog.typing.EventDict:
    """A processor that cuts long values of a line; of a trace it keeps the end, which names the error."""
    for name, value in event.items():
        if name == "exception":
            event[name] = value if len(value) <= LONGEST_TRACE else "…" + value[-LONGEST_TRACE:]
        elif not isinstance(value, bool | int | float | None):
            text = value if isinstance(value, str) else json.dumps(value, default=repr)
            if len(text) > LONGEST_VALUE:
                event[name] = text[:LONGEST_VALUE] + "…"
    return event


class RepeatFilter(logging.Filter):
    """Lets ten warnings or errors of one kind through in a minute; the next says how many were left out."""

    def __init__(self) -> None:
        super().__init__()
        self._kinds: OrderedDict[tuple[str, int, str], tuple[float, int]] = OrderedDict()

    def filter(self, record: logging.LogRecord) -> bool:
        if record.levelno < logging.WARNING:
            return True
        now = time.monotonic()
        kind = (record.name, record.levelno, _describe(record))
        began, count = self._kinds.pop(kind, (now, 0))
        left_out = max(0, count - _BURST)
        if now - began > _WINDOW:
            began, count = now, 0
            if left_out:
                _add_count(record, left_out)
        self._kinds[kind] = (began, count + 1)
        if len(self._kinds) > _MAX_KINDS:
            self._kinds.popitem(last=False)
        return count < _BURST


def _describe(record: logging.LogRecord) -> str:
    """What lines of one kind share: an event without values or a message without arguments, and the error's kind."""
    if isinstance(record.msg, dict):
        text, raised = str(record.msg.get("event", "")), str(record.msg.get("exception", "")).rpartition("\n")[2]
    else:
        text, raised = str(record.msg), ""
    if record.exc_info and record.exc_info[0] is not None:
        raised = record.exc_info[0].__name__
    return f"{text.partition(chr(10))[0][:100]} {raised.partition(':')[0][:100]}"


def _add_count(record: logging.LogRecord, left_out: int) -> None:
    if isinstance(record.msg, dict):
        record.msg = {**record.msg, "left_out": left_out}
    else:
        record.msg = f"{record.getMessage()} (and {left_out} more of this kind before)"
        record.args = ()
