"""Messages of recordings on a WebSocket that Foxglove connects to."""

from __future__ import annotations

from typing import Any, Self

import foxglove
from foxglove.websocket import ServerListener

from pretouch.errors import Unavailable
from pretouch.live.feed import Update
from pretouch.recording.reader import Recorded

_BACKLOG = 8192
"""Messages that wait for a slow viewer; a whole session has fewer."""


class FoxgloveServer:
    """Serves from its making until it is closed.

    A viewer that subscribes is sent the session from its start with the next `show`: the protocol keeps nothing.

    Args:
        host: address to listen on.
        port: 0 for a free one.

    Attributes:
        url: where viewers connect to.

    Raises:
        Unavailable: the port is taken.
    """

    def __init__(self, host: str, port: int) -> None:
        self._context = foxglove.Context()
        self._channels: dict[tuple[str, str], foxglove.Channel] = {}
        self._last: Update | None = None
        self._listener = _Listener()
        try:
            self._server = foxglove.start_server(
                name="pretouch",
                host=host,
                port=port,
                context=self._context,
                server_listener=self._listener,
                message_backlog_size=_BACKLOG,
            )
        except Exception as error:  # whatever the SDK raises for an address that it cannot have
            raise Unavailable(
                f"Foxglove's server cannot listen on {host}:{port}: {error}", "Give another port, or end what has it."
            ) from error
        self.url = f"ws://{host}:{self._server.port}"

    def show(self, update: Update | None) -> None:
        """Sends what is new, and all of it where a viewer has subscribed since."""
        if update is not None and self._last is not None and update.session_id != self._last.session_id:
            self._server.clear_session()  # viewers forget the session before
        self._last = update or self._last
        asked, self._listener.asked = self._listener.asked, False
        if asked and self._last is not None:
            self._send(self._last.whole)
        elif update is not None:
            self._send(update.new)

    def close(self) -> None:
        self._server.stop()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _send(self, messages: tuple[Recorded, ...]) -> None:
        for message in messages:
            key = message.topic, message.schema
            if key not in self._channels:
                schema = foxglove.Schema(name=message.schema, encoding="protobuf", data=message.described)
                self._channels[key] = foxglove.Channel(
                    message.topic, schema=schema, message_encoding="protobuf", context=self._context
                )
            self._channels[key].log(message.data, log_time=message.time)


class _Listener(ServerListener):
    """Notes, in the server's own thread, that a viewer has subscribed."""

    def __init__(self) -> None:
        self.asked = False

    def on_subscribe(self, client: Any, channel: Any) -> None:
        self.asked = True
