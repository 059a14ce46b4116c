"""`pretouch session view`: the newest session in Foxglove and Rerun, as it grows."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from contextlib import AsyncExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Protocol

import typer

from pretouch.cli import TlsCa, TlsCert, TlsKey, Token
from pretouch.client import AsyncRestClient
from pretouch.errors import InvalidInput, Unavailable
from pretouch.live.feed import Feed, Update
from pretouch.serving.process import ended_by_signals
from pretouch.session_command.options import DEFAULT_URL, Url

FOXGLOVE_PORT, RERUN_PORT, RERUN_WEB_PORT = 8765, 9876, 9090
_PAUSE = 1.0
"""s between two questions to the orchestrator, at least."""
_SHARE = 4.0
"""How many times as long as an answer took it is left alone."""


class View(Protocol):
    """Something that shows updates; None: nothing has happened for a while."""

    def show(self, update: Update | None) -> None: ...


def view(
    foxglove: Annotated[bool, typer.Option("--foxglove", help="Serve Foxglove's viewers on a WebSocket.")] = False,
    foxglove_port: Annotated[int, typer.Option(min=0, max=65535, help="Its port; 0 for a free one.")] = FOXGLOVE_PORT,
    foxglove_host: Annotated[
        str, typer.Option(help="Address that it listens on; whoever reaches it sees the sessions.")
    ] = "127.0.0.1",
    rerun: Annotated[
        bool, typer.Option("--rerun", help="Serve Rerun's data and its viewer for browsers on 127.0.0.1.")
    ] = False,
    rerun_port: Annotated[int, typer.Option(min=1, max=65535, help="Port of Rerun's data.")] = RERUN_PORT,
    rerun_web_port: Annotated[
        int, typer.Option(min=1, max=65535, help="Port of Rerun's viewer for browsers.")
    ] = RERUN_WEB_PORT,
    url: Url = DEFAULT_URL,
    token: Token = None,
    tls_ca: TlsCa = None,
    tls_cert: TlsCert = None,
    tls_key: TlsKey = None,
    until_stdin_closes: Annotated[bool, typer.Option(hidden=True)] = False,
) -> None:
    """Show the newest session in Foxglove or Rerun, as it grows, until Ctrl-C."""
    if not (foxglove or rerun):
        raise InvalidInput("There is nothing to show it with.", "Add --foxglove, --rerun or both.")

    async def run() -> None:
        async with AsyncExitStack() as stack:
            views: list[View] = []
            if foxglove:
                from pretouch.live.foxglove_server import FoxgloveServer

                server = stack.enter_context(FoxgloveServer(foxglove_host, foxglove_port))
                print(f"Foxglove: open a connection to {server.url}", flush=True)
                views.append(server)
            if rerun:
                from pretouch.live.rerun_server import RerunServer, check_installed

                check_installed()
                viewer = await stack.enter_async_context(RerunServer(rerun_port, rerun_web_port))
                print(f"Rerun: {viewer.url}", flush=True)
                views.append(viewer)
            client = AsyncRestClient(url, token=token, tls_ca=tls_ca, tls_cert=tls_cert, tls_key=tls_key)
            await stack.enter_async_context(client)
            folder = Path(stack.enter_context(TemporaryDirectory(prefix="pretouch-")))
            await show_all(Feed(client, folder), views, lambda text: print(text, flush=True))

    async def run_until_told() -> None:
        async with ended_by_signals(until_stdin_closes=until_stdin_closes):
            await run()

    asyncio.run(run_until_told())


async def show_all(feed: Feed, views: list[View], tell: Callable[[str], None]) -> None:
    """Shows every update in every view, at most one a second; goes on when the orchestrator was away.

    Raises:
        PretouchError: what asking again would not help against, such as a wrong token.
    """
    away = False
    while True:
        began = time.monotonic()
        try:
            update = await feed.poll()
            if away:
                tell("The orchestrator is there again.")
            away = False
        except Unavailable as error:
            update = None
            if not away:
                tell(f"{error.detail} It is asked again.")
            away = True
        for each in views:
            await asyncio.to_thread(each.show, update)
        await asyncio.sleep(max(_PAUSE, _SHARE * (time.monotonic() - began)))
