"""Shows what a device sent, on one line, for people."""

from __future__ import annotations

_LENGTH = 60
"""Characters of a line that are shown."""
_BYTES = 16
"""Bytes that are shown in hexadecimal."""


def quote(line: str) -> str:
    """A line in quotes, escaped, and shortened if it is long."""
    shown = "".join(each if each.isprintable() else ascii(each)[1:-1] for each in line.strip(" "))
    return f"'{shown}'" if len(shown) <= _LENGTH else f"'{shown[:_LENGTH]}'..."


def quote_bytes(data: bytes) -> str:
    """The first bytes, in hexadecimal."""
    return f"{data[:_BYTES].hex(' ')}{' ..' if len(data) > _BYTES else ''}"
