"""Depth images and masks are sent unchanged over REST and gRPC, from any form that a program may have them in."""

from pathlib import Path

import numpy as np
import pytest

from pretouch.camera import decode_depth, decode_png
from pretouch.client.images import depth_file, depth_values, mask_file, mask_values
from pretouch.errors import InvalidInput

MILLIMETRES = np.array([[0, 1, 65535], [800, 801, 802]], np.uint16)
METRES = np.array([[0, np.nan], [0.8, 1e-3]], np.float32)
MASK = np.array([[0, 1, 0], [3, 0, 255]])


@pytest.mark.parametrize(("depth", "media"), [(MILLIMETRES, "image/png"), (METRES, "application/x-npy")])
def test_a_depth_array_is_the_same_as_array_bytes_and_path(depth: np.ndarray, media: str, tmp_path: Path) -> None:
    data, media_type = depth_file(depth)
    assert media_type == media
    file = tmp_path / "depth"
    file.write_bytes(data)
    for given in (depth, data, file, str(file)):
        np.testing.assert_array_equal(depth_values(given), depth)
        assert depth_values(given).dtype == depth.dtype
        np.testing.assert_array_equal(decode_depth(depth_file(given)[0]), depth)
        assert depth_file(given)[1] == media


def test_a_big_endian_depth_array_keeps_its_values() -> None:
    np.testing.assert_array_equal(decode_depth(depth_file(MILLIMETRES.astype(">u2"))[0]), MILLIMETRES)


@pytest.mark.parametrize("bad", [np.ones((2, 2)), np.ones((2, 2), np.uint8), np.ones((2, 2, 1), np.uint16)])
def test_a_depth_array_of_another_kind_is_refused(bad: np.ndarray) -> None:
    for convert in (depth_file, depth_values):
        with pytest.raises(InvalidInput, match="depth image is an array") as caught:
            convert(bad)
        assert "astype" in caught.value.remedy


@pytest.mark.parametrize("mask", [MASK, MASK > 0, MASK.astype(np.float32), np.dstack([MASK, 0 * MASK])])
def test_a_mask_is_non_zero_on_the_object(mask: np.ndarray) -> None:
    np.testing.assert_array_equal(mask_values(mask) > 0, MASK > 0)
    data, media_type = mask_file(mask)
    assert media_type == "image/png"
    np.testing.assert_array_equal(decode_png(data, "mask") > 0, MASK > 0)
    np.testing.assert_array_equal(mask_values(data) > 0, MASK > 0)


def test_a_mask_of_another_shape_is_refused() -> None:
    with pytest.raises(InvalidInput, match="shape"):
        mask_values(np.ones(4))


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match=r"missing\.png"):
        depth_file(tmp_path / "missing.png")
