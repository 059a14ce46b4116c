"""`pretouch session recording`: a session's recording as a file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pretouch.cli import TlsCa, TlsCert, TlsKey, Token
from pretouch.client import RestClient
from pretouch.client.arguments import check_id
from pretouch.results import STANDARD_OUTPUT, check_file, write_file
from pretouch.session_command.options import DEFAULT_URL, SessionId, Url, open_console


def recording(
    session_id: SessionId,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", help="The file to write; - is standard output.", show_default="session-SESSION.mcap"
        ),
    ] = None,
    url: Url = DEFAULT_URL,
    token: Token = None,
    tls_ca: TlsCa = None,
    tls_cert: TlsCert = None,
    tls_key: TlsKey = None,
) -> None:
    """Download a session's recording, an MCAP file for Foxglove, Rerun and `pretouch session replay`."""
    path = out or Path(f"session-{check_id('session', session_id)}.mcap")
    check_file(path)
    with RestClient(url, token=token, tls_ca=tls_ca, tls_cert=tls_cert, tls_key=tls_key) as client:
        file = client.recording(session_id)
    write_file(path, file)
    if path != STANDARD_OUTPUT:
        open_console().print(f"{path}: {len(file) / 1e6:.2f} MB.", soft_wrap=True)
