"""Sizes and times as people write them in settings."""

from __future__ import annotations

import re

from pretouch.errors import InvalidInput

_SECONDS = {"d": 86400.0, "h": 3600.0, "min": 60.0, "s": 1.0, "": 86400.0}
"""s in each unit of time; a number alone is days."""
_BYTES = {"": 1.0, "k": 2.0**10, "m": 2.0**20, "g": 2.0**30, "t": 2.0**40}
"""Bytes in each unit of size: K, KB and KiB are the same, and so on."""


def parse_bytes(text: str, name: str) -> int:
    """The bytes in a text such as 800M or 10GiB.

    Args:
        name: of the setting, for the error.

    Raises:
        InvalidInput: it is none.
    """
    return int(_parse(text, name, _BYTES, r"([kmgt]?)(?:i?b)?", "a size such as 800M or 10GiB"))


def parse_seconds(text: str, name: str) -> float:
    """The seconds in a text such as 30d, 12h or 90min; a number alone is days.

    Args:
        name: of the setting, for the error.

    Raises:
        InvalidInput: it is none.
    """
    return _parse(text, name, _SECONDS, r"(d|h|min|s|)", "a time such as 30d, 12h or 90min")


def _parse(text: str, name: str, units: dict[str, float], unit: str, meaning: str) -> float:
    match = re.fullmatch(rf"(\d{{1,15}}(?:\.\d{{1,9}})?) ?{unit}", text.strip().lower(), re.ASCII)
    if match is None or float(match[1]) <= 0:
        raise InvalidInput(f"{name} is {text!r:.80}.", f"Give {meaning}.")
    return float(match[1]) * units[match[2]]
