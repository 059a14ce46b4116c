"""Sizes and times in settings."""

import pytest

from pretouch.errors import InvalidInput
from pretouch.serving.quantities import parse_bytes, parse_seconds


@pytest.mark.parametrize(
    ("text", "size"),
    [("1000", 1000), ("64k", 64 << 10), ("800M", 800 << 20), ("2 GiB", 2 << 30), ("3GB", 3 << 30), ("0.5T", 1 << 39)],
)
def test_sizes_are_read_as_people_write_them(text: str, size: int) -> None:
    assert parse_bytes(text, "it") == size


@pytest.mark.parametrize(
    ("text", "seconds"), [("7", 604800), ("1.5h", 5400), ("90 min", 5400), ("2s", 2), ("1d", 86400)]
)
def test_times_are_read_as_people_write_them(text: str, seconds: float) -> None:
    assert parse_seconds(text, "it") == seconds


@pytest.mark.parametrize("text", ["", "G", "0", "-1", "1e9", "nan", "two", "\u00b2", "\u0663d", "1" * 40, "5 weeks"])
def test_what_is_neither_is_named(text: str) -> None:
    for parse in (parse_bytes, parse_seconds):
        with pytest.raises(InvalidInput, match="PRETOUCH_IT is"):
            parse(text, "PRETOUCH_IT")
