"""Server-sent events are parsed correctly however the bytes are split."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pretouch.client.events import Event, ServerSentEvents
from pretouch.errors import Internal

STREAM = (
    b': keep-alive\n\nid: 1\nevent: session\ndata: {"a": "\xc3\xa9"}\n\n'
    b'id:2\r\nevent:scan\r\nretry: 100\r\ndata: {"b":\r\ndata: 2}\r\n\r\n: again\n\nid: 3\nevent: end\ndata: null\n\n'
)
EVENTS = [Event(1, "session", {"a": "é"}), Event(2, "scan", {"b": 2}), Event(3, "end", None)]


@given(st.lists(st.integers(0, len(STREAM)), max_size=12))
def test_events_survive_any_cut(cuts: list[int]) -> None:
    parser = ServerSentEvents()
    edges = [0, *sorted(cuts), len(STREAM)]
    got = [event for a, b in pairwise(edges) for event in parser.feed(STREAM[a:b])]
    assert got == EVENTS


def test_an_event_that_was_cut_off_is_not_given() -> None:
    assert list(ServerSentEvents().feed(b"id: 1\nevent: session\ndata: {}\n")) == []


def test_data_that_is_not_json_is_an_internal_error() -> None:
    with pytest.raises(Internal, match="event 4"):
        list(ServerSentEvents().feed(b"id: 4\nevent: scan\ndata: oops\n\n"))


@pytest.mark.parametrize(
    "stream",
    [
        b"id: 1\ndata: \xff\n\n",
        b"data: " + b"x" * 2**21,
        b"data: xxxxxxxxx\n" * 2**18,
        b"id: 1\ndata: " + b"[" * 10**5 + b"\n\n",
    ],
)
def test_what_is_no_event_stream_is_an_internal_error(stream: bytes) -> None:
    with pytest.raises(Internal):
        list(ServerSentEvents().feed(stream))


def test_an_event_without_a_number_for_id_is_left_out() -> None:
    stream = "".join(f"id: {id}\ndata: 1\n\n" for id in ("", "²", "-1", "9" * 5000, "7"))
    assert list(ServerSentEvents().feed(stream.encode())) == [Event(7, "message", 1)]
