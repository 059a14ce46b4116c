"""`pretouch session list` and `pretouch session show`."""

from __future__ import annotations

from typing import Annotated, Any

import typer
from rich.text import Text

from pretouch.cli import TlsCa, TlsCert, TlsKey, Token
from pretouch.client import RestClient
from pretouch.results import STANDARD_OUTPUT, check_file, write_json
from pretouch.session_command.options import DEFAULT_URL, Json, SessionId, Url, open_console, print_paragraphs
from pretouch.session_command.tables import tabulate_scans, tabulate_sessions
from pretouch.session_command.wording import describe, describe_forecast, describe_plan, describe_warning
from pretouch.wire.json import session_to_json

_PAGE = 100
"""Sessions asked for at once."""


def list_sessions(
    limit: Annotated[int, typer.Option(min=1, max=100_000, help="At most so many, the newest.")] = 20,
    url: Url = DEFAULT_URL,
    json: Json = None,
    token: Token = None,
    tls_ca: TlsCa = None,
    tls_cert: TlsCert = None,
    tls_key: TlsKey = None,
) -> None:
    """List sessions, the newest first: how each ended and how certain its answer is."""
    if json is not None:
        check_file(json)
    console = open_console()
    documents: list[dict[str, Any]] = []
    count, cursor = 0, ""
    with RestClient(url, token=token, tls_ca=tls_ca, tls_cert=tls_cert, tls_key=tls_key) as client:
        while count == 0 or (cursor and count < limit):
            page = client.sessions(min(_PAGE, limit - count), cursor)
            if json is not None:
                documents += map(session_to_json, page.sessions)
            if json != STANDARD_OUTPUT and page.sessions:
                console.print(tabulate_sessions(page.sessions, console.width, header=count == 0))
            count, cursor = count + len(page.sessions), page.next
            if not page.sessions:
                break
    if json is not None:
        write_json(json, {"sessions": documents, "next": cursor or None})
    if json == STANDARD_OUTPUT:
        return
    if not count:
        console.print("There is no session yet.")
    elif cursor:
        console.print(Text(f"The newest {count} are shown; --limit shows more.", "dim"))


def show(
    session_id: SessionId,
    url: Url = DEFAULT_URL,
    json: Json = None,
    token: Token = None,
    tls_ca: TlsCa = None,
    tls_cert: TlsCert = None,
    tls_key: TlsKey = None,
) -> None:
    """Say what came of a session and why, then its scans and warnings."""
    if json is not None:
        check_file(json)
    with RestClient(url, token=token, tls_ca=tls_ca, tls_cert=tls_cert, tls_key=tls_key) as client:
        session = client.session(session_id)
    if json is not None:
        write_json(json, session_to_json(session))
    if json == STANDARD_OUTPUT:
        return
    console = open_console()
    print_paragraphs(console, describe(session))
    if session.scans:
        console.print(tabulate_scans(session.scans, console.width))
    if session.next_scan is not None:
        print_paragraphs(console, [describe_plan(session.next_scan)])
    if session.forecast is not None:
        print_paragraphs(console, [describe_forecast(session.forecast)])
    print_paragraphs(console, map(describe_warning, session.warnings))
