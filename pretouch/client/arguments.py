"""Checks of what a program gives to a client, before anything is sent: all clients refuse it in the same words."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path

from pretouch.errors import InvalidInput, NotFound, PretouchError

FilePath = str | PathLike[str]
MAX_TIMEOUT = 86_400.0
"""s: a day."""
_ID = re.compile(r"[A-Za-z0-9_~.-]{1,128}")
_KEY = re.compile(r"[!-~]([ -~]*[!-~])?")
_MAX_EVENT_ID = 10**18


def check_timeout(timeout: float) -> float:
    """Raises `InvalidInput` unless `timeout` is a number of seconds that can be waited."""
    if not (isinstance(timeout, int | float) and 0 < timeout <= MAX_TIMEOUT):
        raise InvalidInput(f"The timeout is {timeout!r:.40}.", f"Give seconds, above 0 and at most {MAX_TIMEOUT:g}.")
    return timeout


def check_id(kind: str, id: str) -> str:
    """Raises `NotFound` if no `kind` ("session", "scan", "camera") can have this id: in a path it might name others."""
    if not isinstance(id, str):
        raise InvalidInput(f"The id of a {kind} is {id!r:.80}.", "Give the text that the service answered.")
    if _ID.fullmatch(id) is None or id in (".", ".."):
        raise NotFound(f"There is no {kind} {id!r:.80}.", f"Give the id of a {kind} that the service answered.")
    return id


def check_key(key: str | None) -> str | None:
    """Raises `InvalidInput` unless an idempotency key can be sent in a header."""
    if key and not (isinstance(key, str) and _KEY.fullmatch(key)):
        raise InvalidInput(f"The idempotency key is {key!r:.80}.", "Give printable ASCII characters, such as a UUID.")
    return key


def check_event_id(after: int) -> int:
    """Raises `InvalidInput` unless `after` can be the id of an event."""
    if not isinstance(after, int) or not 0 <= after < _MAX_EVENT_ID:
        raise InvalidInput(f"The id of the last event is {after!r:.40}.", "Give an event's id, or 0 for the start.")
    return after


def as_path(path: FilePath | None) -> Path | None:
    """A path that a program may leave out."""
    return None if path is None else Path(path)


@contextmanager
def failing_as(kind: type[PretouchError], what: str, remedy: str) -> Iterator[None]:
    """Whatever fails in the block is raised as an error of pretouch: what is none yet becomes a `kind`."""
    try:
        yield
    except PretouchError:
        raise
    except Exception as error:
        raise kind(f"{what}: {str(error) or type(error).__name__:.200}.", remedy) from error
