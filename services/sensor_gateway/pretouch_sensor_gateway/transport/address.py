"""Parses the address of a port: a path, a USB device by its numbers, or a network address.

What an address names is looked up each time the port is opened, so that a device may come back under another name.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from urllib.parse import urlsplit

from pretouch.errors import InvalidInput

DEFAULT_BAUD = 115_200
"""Bits a second of a real UART; USB, ptys and sockets ignore it."""
_FORMS = (
    "Give the path of a serial port (/dev/serial/by-id/... survives replugging), usb:VID:PID or usb:VID:PID:SERIAL "
    "with the hexadecimal numbers that lsusb shows, or socket://host:port."
)


@dataclass(frozen=True)
class PathAddress:
    """A serial port by its absolute path, symbolic links allowed."""

    path: str


@dataclass(frozen=True)
class UsbAddress:
    """The serial port of the USB device with these numbers; an empty `serial` means any."""

    vendor: int
    product: int
    serial: str

    def __str__(self) -> str:
        return f"{self.vendor:04x}:{self.product:04x}" + (f" with the serial number {self.serial}" * bool(self.serial))


@dataclass(frozen=True)
class SocketAddress:
    """A serial server on the network that passes raw bytes over TCP."""

    host: str
    port: int


Address = PathAddress | UsbAddress | SocketAddress


def parse_address(text: str) -> Address:
    """Parses an address.

    Raises:
        InvalidInput: `text` is not a valid address.
    """
    if not text or not text.isprintable():
        raise InvalidInput(f"The address {text!r} is empty or holds control characters.", _FORMS)
    if text.startswith("usb:"):
        return _parse_usb(text)
    if text.startswith("socket:"):
        return _parse_socket(text)
    if "://" in text:
        raise InvalidInput(
            f"{text!r} is a URL of another kind than socket://, and the gateway reads file descriptors only.",
            "Let the serial server offer the port as raw TCP and use socket://host:port. " + _FORMS,
        )
    if not text.startswith("/") or text.endswith("/"):
        raise InvalidInput(f"{text!r} is not the absolute path of a port.", _FORMS)
    return PathAddress(text)


def _parse_usb(text: str) -> UsbAddress:
    match = re.fullmatch(r"usb:([0-9a-fA-F]{1,4}):([0-9a-fA-F]{1,4})(?::(.+))?", text)
    if match is None:
        raise InvalidInput(
            f"{text!r} is not usb:VID:PID or usb:VID:PID:SERIAL.",
            "VID and PID are hexadecimal, as lsusb shows them: usb:2341:0043.",
        )
    return UsbAddress(int(match[1], 16), int(match[2], 16), match[3] or "")


def _parse_socket(text: str) -> SocketAddress:
    remedy = "Write socket://host:port and nothing else: socket://10.0.0.5:4000, socket://[fe80::1]:4000."
    try:
        parts = urlsplit(text)
        host, port = parts.hostname, parts.port
        (host or "").encode("idna")
    except ValueError as error:  # among them UnicodeError: a host name that cannot be written in DNS
        raise InvalidInput(f"{text!r} holds no host and port: {error}.", remedy) from error
    if not host or not port:
        raise InvalidInput(f"{text!r} holds no host and port.", remedy)
    if text != f"socket://{parts.netloc}" or "@" in parts.netloc:
        raise InvalidInput(f"{text!r} holds more than a host and a port.", remedy)
    return SocketAddress(host, port)
