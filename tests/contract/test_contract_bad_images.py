"""Invalid images and arrays are refused before they are decoded, and bodies above the limit before they are read."""

from __future__ import annotations

import pickle
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.box_session import DEPTH, MASK, request
from helpers.box_view import png
from helpers.creation import files, image, message, npy
from helpers.problems import check, over_grpc, over_rest
from helpers.processes import Orchestrator

from pretouch.camera import decode_depth
from pretouch.client import GrpcClient, RestClient
from pretouch.errors import InvalidInput, Malformed, TooLarge


def test_a_png_that_is_none_is_malformed(orchestrator: Orchestrator) -> None:
    whole = png(DEPTH)
    for depth in (b"", b"depth", whole[:1000], whole[:40] + bytes(1000) + whole[1040:], b"GIF89a" + bytes(100)):
        document, _ = over_rest(orchestrator, "POST", "/v1/sessions", files=files(depth=depth))
        check(document, Malformed, "PNG")
    document, _ = over_rest(orchestrator, "POST", "/v1/sessions", files=files(mask=whole[:100]))
    check(document, Malformed, "mask")


def test_a_png_of_another_kind_is_not_valid(orchestrator: Orchestrator) -> None:
    for depth in (png(image(DEPTH.shape, 200)), png(np.dstack([MASK.astype(np.uint8)] * 3))):
        document, _ = over_rest(orchestrator, "POST", "/v1/sessions", files=files(depth=depth))
        check(document, InvalidInput, "16-bit")


def test_an_array_that_does_not_fill_its_shape_is_not_valid(orchestrator: Orchestrator) -> None:
    short = message()
    short.depth.data = short.depth.data[:-2]
    document, _ = over_grpc(orchestrator, "CreateSession", short)
    check(document, InvalidInput, "depth")
    huge = message()
    del huge.depth.shape[:]
    huge.depth.shape.extend([2**32 - 1, 2**32 - 1])
    document, _ = over_grpc(orchestrator, "CreateSession", huge)
    check(document, InvalidInput, "depth")


class Trap:
    """Makes a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __reduce__(self) -> Any:
        return (open, (str(self._path), "w"))


def test_a_pickle_is_refused_and_not_opened(orchestrator: Orchestrator, tmp_path: Path) -> None:
    sprung = tmp_path / "sprung"
    trap = np.empty((2, 2), dtype=object)
    trap[:] = [[Trap(sprung)] * 2] * 2
    for depth in (npy(trap), pickle.dumps(Trap(sprung)), npy(np.array(Trap(sprung)))):
        document, _ = over_rest(orchestrator, "POST", "/v1/sessions", files=files(depth=depth))
        check(document, Malformed if document["status"] == 400 else InvalidInput)
    assert not sprung.exists()


def test_an_array_file_that_is_damaged_is_malformed(orchestrator: Orchestrator) -> None:
    whole = npy(DEPTH)
    for depth in (whole[:20], whole[:-5], whole.replace(b"'shape'", b"'shapf'"), whole[:6] + b"\x09" + whole[7:]):
        document, _ = over_rest(orchestrator, "POST", "/v1/sessions", files=files(depth=depth))
        check(document, Malformed, "npy")
    bomb = whole.replace(b"(240, 320)", b"(2400000, 3200000)".ljust(10))
    document, _ = over_rest(orchestrator, "POST", "/v1/sessions", files=files(depth=bomb))
    assert document["status"] in (400, 413)


@pytest.mark.parametrize(
    ("shape", "status"),
    [
        ("True, 4", 422),
        ("0, 99999999999999999999999", 422),
        ("-2000, -2000", 422),
        ("2000, 2000", 400),
        ("9999, 9999", 413),
    ],
)
def test_an_array_file_of_a_shape_that_cannot_be_is_refused(
    shape: str, status: int, orchestrator: Orchestrator
) -> None:
    header = f"{{'descr': '<u2', 'fortran_order': False, 'shape': ({shape}), }}".ljust(117) + "\n"
    depth = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode() + bytes(8)
    document, _ = over_rest(orchestrator, "POST", "/v1/sessions", files=files(depth=depth))
    assert document["status"] == status, document


def test_an_array_file_in_the_order_of_columns_is_read_as_what_it_is() -> None:
    np.testing.assert_array_equal(decode_depth(npy(np.asfortranarray(DEPTH))), DEPTH)


def chunk(kind: bytes, data: bytes) -> bytes:
    return len(data).to_bytes(4, "big") + kind + data + zlib.crc32(kind + data).to_bytes(4, "big")


def header(side: int) -> bytes:
    return chunk(b"IHDR", 2 * side.to_bytes(4, "big") + b"\x10\x00\x00\x00\x00")


@pytest.mark.parametrize(
    ("chunks", "status"),
    [
        ([header(50_000)], 413),
        ([chunk(b"tEXt", b"k\0" + bytes(20)), header(12_000)], 400),
        ([header(10), header(12_000)], 400),
        ([header(10), *[chunk(b"tEXt", b"k\0v")] * 100_000], 400),
        ([header(10), chunk(b"iCCP", b"k\0\0" + zlib.compress(bytes(50_000_000)))], 400),
    ],
)
def test_a_png_that_unpacks_to_much_more_is_refused(
    chunks: list[bytes], status: int, orchestrator: Orchestrator
) -> None:
    pixels = chunk(b"IDAT", zlib.compress(bytes(12_000 * 24_001)))
    depth = b"\x89PNG\r\n\x1a\n" + b"".join(chunks) + pixels + chunk(b"IEND", b"")
    before = orchestrator.peak_memory()
    for part in ("depth", "mask"):
        document, _ = over_rest(orchestrator, "POST", "/v1/sessions", files=files(**{part: depth}))
        assert document["status"] == status, document
    assert orchestrator.peak_memory() - before < 100 << 20


def test_a_gigabyte_is_refused_before_it_is_read(orchestrator: Orchestrator) -> None:
    with RestClient(orchestrator.rest_url) as client:
        session = client.create_session(request(), DEPTH, MASK)
    assert session.next_scan is not None
    scan_path = f"/v1/sessions/{session.id}/scans/{session.next_scan.scan_id}"
    form = b'--x\r\nContent-Disposition: form-data; name="depth"; filename="depth.png"\r\n\r\n'
    before = orchestrator.peak_memory()
    for path, media_type, start in (
        ("/v1/sessions", "multipart/form-data; boundary=x", form),
        (scan_path, "application/json", b'{"samples": ['),
    ):
        for announced in ({}, {"content-length": str(len(start) + (1 << 30))}):
            taken: list[int] = []
            headers = {"content-type": media_type} | announced
            document, _ = over_rest(orchestrator, "POST", path, content=gigabyte(start, taken), headers=headers)
            check(document, TooLarge, "bytes")
            assert sum(taken) < 128 << 20
    assert orchestrator.peak_memory() - before < 100 << 20


def gigabyte(start: bytes, taken: list[int]) -> Iterator[bytes]:
    """`start` and a gigabyte; `taken` holds the sizes of the pieces that were asked for."""
    yield start
    for _ in range(1024):
        taken.append(1 << 20)
        yield bytes(1 << 20)


def test_a_message_beyond_the_limit_is_refused(orchestrator: Orchestrator) -> None:
    big = np.ones((4000, 4200), np.float32)
    with GrpcClient(orchestrator.address) as client, pytest.raises(TooLarge):
        client.create_session(request(), big, np.ones(big.shape))
