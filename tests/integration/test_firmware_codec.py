"""The firmware's frames, checksum and receiver beside the gateway's."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator

import pytest
from fastcrc import crc16
from helpers.firmware_bench import MODULES, make, need, sanitizers
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_sensor_gateway.wire_formats.binary import FrameDecoder, encode
from pretouch_sensor_gateway.wire_formats.messages import Identify, Ping
from pretouch_sensor_gateway.wire_formats.parser import Identity, Measurement, PingReply

Codec = Callable[[str], str]

u8, u16, u32 = (st.integers(0, 2**bits - 1) for bits in (8, 16, 32))
printable = st.text(st.characters(min_codepoint=0x20, max_codepoint=0x7E), max_size=32)
requests = st.one_of(st.builds(Ping, u32), st.just(Identify()))
frames = st.one_of(requests.map(encode), st.builds(PingReply, u16, u32, u32).map(encode))


@st.composite
def damaged(draw: st.DrawFn) -> bytes:
    """A frame with one byte changed; it may be cut in two by that."""
    frame = bytearray(draw(frames))
    frame[draw(st.integers(0, len(frame) - 1))] = draw(u8)
    return bytes(frame)


@pytest.fixture(scope="module")
def codec(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Codec]:
    need("make", "cc")
    build = tmp_path_factory.mktemp("codec")
    make(f"{build}/codec", build, **sanitizers(build))
    process = subprocess.Popen([build / "codec"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdin is not None
    assert process.stdout is not None
    stdin, stdout = process.stdin, process.stdout

    def ask(line: str) -> str:
        stdin.write(line + "\n")
        stdin.flush()
        return stdout.readline().rstrip("\n")

    yield ask
    stdin.close()
    assert process.wait(timeout=30) == 0
    stdout.close()


def test_the_checksum_of_the_standard_text(codec: Codec) -> None:
    assert codec("crc " + b"123456789".hex()) == str(0x29B1)


@given(data=st.binary(min_size=1, max_size=255))
@settings(max_examples=100)
def test_checksums_are_those_of_the_gateway(codec: Codec, data: bytes) -> None:
    assert codec("crc " + data.hex()) == str(crc16.ibm_3740(data))


@given(boot=u16, sequence=u32, micros=u32, readings=st.lists(st.tuples(u16, u8), min_size=MODULES, max_size=MODULES))
@settings(max_examples=200)
def test_ranges(codec: Codec, boot: int, sequence: int, micros: int, readings: list[tuple[int, int]]) -> None:
    said = f"ranges {boot} {sequence} {micros} " + " ".join(f"{steps} {status}" for steps, status in readings)
    ranges = tuple(float("nan") if steps == 0xFFFF else steps * 1e-4 for steps, _ in readings)
    meant = Measurement(boot, sequence, micros, ranges, tuple(status for _, status in readings))
    assert codec(said) == encode(meant).hex()


@given(boot=u16, sequence=u32, micros=u32)
@settings(max_examples=100)
def test_ping_replies(codec: Codec, boot: int, sequence: int, micros: int) -> None:
    assert codec(f"ping_reply {boot} {sequence} {micros}") == encode(PingReply(boot, sequence, micros)).hex()


@given(boot=u16, serial=st.binary(min_size=8, max_size=8), period=u32, firmware=printable)
@settings(max_examples=100)
def test_identities(codec: Codec, boot: int, serial: bytes, period: int, firmware: str) -> None:
    meant = Identity(boot, serial.hex(), MODULES, period * 1e-6, firmware)
    assert codec(f"identity {boot} {serial.hex()} {period} {firmware}") == encode(meant).hex()


@given(pieces=st.lists(st.one_of(frames, frames, damaged(), st.binary(max_size=300)), max_size=12))
@settings(max_examples=300)
def test_the_receiver_finds_the_same_requests_as_the_gateway_would(codec: Codec, pieces: list[bytes]) -> None:
    data = b"".join(pieces) + b"\0"
    wanted = [
        f"ping {message.sequence}" if isinstance(message, Ping) else "identify"
        for message in FrameDecoder().feed(data)
        if isinstance(message, Ping | Identify)
    ]
    assert codec("receive " + data.hex()) == ",".join(wanted)
