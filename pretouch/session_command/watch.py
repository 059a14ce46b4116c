"""`pretouch session watch`: a session's events in lines, until it ends."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from rich.text import Text

from pretouch.cli import TlsCa, TlsCert, TlsKey, Token
from pretouch.client import Event, RestClient
from pretouch.errors import Internal, InvalidInput
from pretouch.results import check_file, write_json
from pretouch.session import Session
from pretouch.session_command.options import DEFAULT_URL, Json, SessionId, Url, open_console, print_paragraphs
from pretouch.session_command.wording import (
    describe,
    describe_forecast,
    describe_plan,
    describe_scan,
    describe_warning,
    millimetres,
)
from pretouch.wire.json import session_from_json, session_to_json

_PATIENCE = 600.0
"""s for which an orchestrator that was there may be away."""


def watch(
    session_id: SessionId,
    url: Url = DEFAULT_URL,
    json: Json = None,
    token: Token = None,
    tls_ca: TlsCa = None,
    tls_cert: TlsCert = None,
    tls_key: TlsKey = None,
) -> None:
    """Follow a session until it ends, from its start: a line for each scan, then what came of it.

    An orchestrator that is restarted meanwhile is awaited for ten minutes. --json gets the ended session.
    """
    if json is not None:
        check_file(json)
    console = open_console(json)
    last: Session | None = None
    with RestClient(url, token=token, tls_ca=tls_ca, tls_cert=tls_cert, tls_key=tls_key, timeout=_PATIENCE) as client:
        for present in _read_sessions(client.events(session_id)):
            print_paragraphs(console, describe_change(last, present))
            last = present
        ended = last or client.session(session_id)
    print_paragraphs(console, describe(ended))
    if json is not None:
        write_json(json, session_to_json(ended))


def describe_change(before: Session | None, now: Session) -> Iterator[Text]:
    """What is new in a session since it was `before`, in lines; all of it at first, the state left out."""
    warnings = () if before is None else before.warnings
    scans = 0 if before is None else len(before.scans)
    planned = None if before is None or before.next_scan is None else before.next_scan.scan_id
    if before is None:
        yield Text(f"{len(now.regions)} regions; {millimetres(now.estimate.expected_error)} expected")
    for warning in now.warnings:
        if warning not in warnings:
            yield describe_warning(warning)
    for scan in now.scans[scans:]:
        yield describe_scan(scan)
    if now.next_scan is not None and now.next_scan.scan_id != planned:
        yield describe_plan(now.next_scan)
        if now.forecast is not None:
            yield describe_forecast(now.forecast)


def _read_sessions(events: Iterable[Event]) -> Iterator[Session]:
    """The session after each of its steps; the other events tell parts of the same."""
    for event in events:
        if event.type == "session":
            try:
                yield session_from_json(event.data)
            except InvalidInput as error:
                raise Internal(
                    f"Event {event.id} cannot be read: {error.detail}",
                    "Check that the address is that of a pretouch orchestrator, and that this program is as new.",
                ) from error
