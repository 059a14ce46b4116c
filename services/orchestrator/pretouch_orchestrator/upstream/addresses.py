"""The addresses of a service's copies: listed one by one, or all behind one DNS name."""

from __future__ import annotations

import asyncio
import socket
from dataclasses import dataclass

from pretouch.errors import InvalidInput, Unavailable

_DNS = "dns:///"


@dataclass(frozen=True)
class Addresses:
    """Where a service's copies are.

    Attributes:
        listed: host:port of each copy; empty where a name is resolved.
        name, port: what resolves to the copies; the name is also the one on their certificates. Empty and 0 if listed.
    """

    listed: tuple[str, ...] = ()
    name: str = ""
    port: int = 0

    @staticmethod
    def parse(text: str) -> Addresses:
        """From `host:port,host:port`, or `dns:///name:port`.

        Raises:
            InvalidInput: neither.
        """
        remedy = "Give host:port, several of them separated by commas, or dns:///name:port."
        if text.startswith(_DNS):
            name, _, port = text.removeprefix(_DNS).rpartition(":")
            if not (name and "," not in text and port.isascii() and port.isdigit() and 0 < int(port) < 65536):
                raise InvalidInput(f"{text!r} names no service.", remedy)
            return Addresses(name=name, port=int(port))
        listed = tuple(each.strip() for each in text.split(","))
        if not all(listed) or len(set(listed)) < len(listed):
            raise InvalidInput(f"{text!r} is no list of addresses.", remedy)
        return Addresses(listed)

    async def resolve(self) -> tuple[str, ...]:
        """host:port of each copy there is now.

        Raises:
            Unavailable: the name cannot be resolved.
        """
        if self.listed:
            return self.listed
        try:
            found = await asyncio.get_running_loop().getaddrinfo(self.name, self.port, type=socket.SOCK_STREAM)
        except OSError as error:
            raise Unavailable(
                f"{self.name} cannot be resolved: {error.strerror}.", "Check the name, and that the service runs."
            ) from error
        hosts = sorted({str(address[0]) for *_, address in found})
        return tuple(f"[{host}]:{self.port}" if ":" in host else f"{host}:{self.port}" for host in hosts)
