"""Depth images and masks are sent unchanged over REST and gRPC, from any form that a program may have them in."""

from pathlib import Path

import numpy as np
import pytest

from pretouch.camera import decode_depth, decode_png
from pretouch.client.images import encode_depth, encode_mask, load_depth, load_mask
from pretouch.errors import InvalidInput, NotFound, TooLarge

MILLIMETRES = np.array([[0, 1, 65535], [800, 801, 802]], np.uint16)
METRES = np.array([[0, np.nan], [0.8, 1e-3]], np.float32)
MASK = np.array([[0, 1, 0], [3, 0, 255]])


@pytest.mark.parametrize(("depth", "media"), [(MILLIMETRES, "image/png"), (METRES, "application/x-npy")])
def test_a_depth_array_is_the_same_as_array_bytes_and_path(depth: np.ndarray, media: str, tmp_path: Path) -> None:
    data, media_type = encode_depth(depth)
    assert media_type == media
    file = tmp_path / "depth"
    file.write_bytes(data)
    for given in (depth, data, file, str(file)):
        np.testing.assert_array_equal(load_depth(given), depth)
        assert load_depth(given).dtype == depth.dtype
        np.testing.assert_array_equal(decode_depth(encode_depth(given)[0]), depth)
        assert encode_depth(given)[1] == media


def test_a_big_endian_depth_array_keeps_its_values() -> None:
    np.testing.assert_array_equal(decode_depth(encode_depth(MILLIMETRES.astype(">u2"))[0]), MILLIMETRES)


@pytest.mark.parametrize("bad", [np.ones((2, 2)), np.ones((2, 2), np.uint8), np.ones((2, 2, 1), np.uint16)])
def test_a_depth_array_of_another_kind_is_refused(bad: np.ndarray) -> None:
    for convert in (encode_depth, load_depth):
        with pytest.raises(InvalidInput, match="depth image is an array") as caught:
            convert(bad)
        assert "astype" in caught.value.remedy


@pytest.mark.parametrize("mask", [MASK, MASK > 0, MASK.astype(np.float32), np.dstack([MASK, 0 * MASK])])
def test_a_mask_is_non_zero_on_the_object(mask: np.ndarray) -> None:
    np.testing.assert_array_equal(load_mask(mask) > 0, MASK > 0)
    data, media_type = encode_mask(mask)
    assert media_type == "image/png"
    np.testing.assert_array_equal(decode_png(data, "mask") > 0, MASK > 0)
    np.testing.assert_array_equal(load_mask(data) > 0, MASK > 0)


def test_a_mask_of_another_shape_is_refused() -> None:
    with pytest.raises(InvalidInput, match="shape"):
        load_mask(np.ones(4))


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(NotFound, match=r"missing\.png"):
        encode_depth(tmp_path / "missing.png")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("side", [12_000, 30_000])
def test_a_png_is_refused_for_its_size_before_it_is_decoded(side: int) -> None:
    data = bytearray(encode_mask(MASK)[0])
    data[16:24] = side.to_bytes(4, "big") * 2
    with pytest.raises(TooLarge, match=f"mask has {side * side} pixels"):
        decode_png(bytes(data), "mask")
