"""Reads .npz files of targets and scans: named arrays of numbers."""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
from numpy.typing import NDArray

from pretouch.errors import InvalidInput, Malformed, TooLarge
from pretouch.geometry import Array, frozen_array
from pretouch_registrar.files.content import read_bytes
from pretouch_registrar.files.shape import MAX_POINTS

_LONGEST_HEADER = 12_000
"""Bytes; numpy itself refuses headers of more than 10,000."""


class NpzFile:
    """Arrays by their names, each read when it is asked for; never unpickled.

    Raises:
        NotFound: the file cannot be read.
        Malformed: no ZIP archive.
    """

    def __init__(self, path: Path) -> None:
        self.name = path.name
        data = read_bytes(path)
        try:
            self._archive = ZipFile(io.BytesIO(data))
        except Exception as error:  # zipfile raises many kinds on damaged archives
            raise self._unreadable() from error
        self._members = {member.removesuffix(".npy"): member for member in self._archive.namelist()}

    def __contains__(self, key: str) -> bool:
        return key in self._members

    def array(self, key: str, kinds: str = "iuf") -> NDArray[Any]:
        """The array `key`; `kinds` are those of numpy that its values may have.

        Its header is checked before the values are unpacked, which may take a thousand times the space.

        Raises:
            InvalidInput: there is none, or it holds no numbers.
            TooLarge: more than MAX_POINTS rows, or values of as many points.
            Malformed: it is damaged.
        """
        if key not in self._members:
            found = ", ".join(sorted(self._members)) or "nothing"
            raise InvalidInput(
                f"{self.name} holds {found}, but no {key}.",
                "Write a target as depth, fx, fy, cx, cy, base_T_camera and mask, with depth_scale where depth is not "
                "in metres and table [nx, ny, nz, d] where it is known, or as points; a scan as origins, directions "
                "and ranges, or as points.",
            )
        shape, dtype = self._header(key)
        if dtype.hasobject:
            raise InvalidInput(f"{self.name}: {key} holds Python objects.", f"Save {key} as numbers.")
        if dtype.kind not in kinds:
            raise InvalidInput(f"{self.name}: {key} holds {dtype}, not numbers.", f"Save {key} as numbers.")
        if max(shape[:1], default=0) > MAX_POINTS or math.prod(shape) > 3 * MAX_POINTS:
            raise TooLarge(
                f"{self.name}: {key} announces {' x '.join(map(str, shape))} values; the limit is {MAX_POINTS} points.",
                "Thin it out.",
            )
        try:
            with self._archive.open(self._members[key]) as stream:
                values: NDArray[Any] = np.lib.format.read_array(stream, allow_pickle=False)
        except MemoryError as error:
            raise TooLarge(f"{self.name} is too large for this machine's memory.", "Thin it out.") from error
        except Exception as error:  # zipfile, its decompressors and numpy raise many kinds on damaged members
            raise self._unreadable() from error
        return values

    def numbers(self, key: str, shape: tuple[int | None, ...]) -> Array:
        """The array `key` as finite float64 of this shape; None stands for any length."""
        with np.errstate(over="ignore", invalid="ignore"):  # what becomes infinite or NaN is refused
            return frozen_array(self.array(key), shape, f"{self.name}: {key}")

    def number(self, key: str) -> float:
        """The single finite number `key`."""
        if shape := self.array(key).shape:
            raise InvalidInput(
                f"{self.name}: {key} is an array of shape {list(shape)}, not one number.",
                f"Save {key} as a single number.",
            )
        return float(self.numbers(key, ()))

    def _header(self, key: str) -> tuple[tuple[int, ...], np.dtype[Any]]:
        try:
            with self._archive.open(self._members[key]) as stream:
                head = io.BytesIO(stream.read(_LONGEST_HEADER))
            version = np.lib.format.read_magic(head)
            # a 3.0 header differs from a 2.0 one in its encoding alone, which matters for the names of fields
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, _, dtype = read(head)
        except Exception as error:  # zipfile, its decompressors and numpy raise many kinds on damaged members
            raise self._unreadable() from error
        if min(shape, default=0) < 0:
            raise self._unreadable()
        return shape, dtype

    def _unreadable(self) -> Malformed:
        return Malformed(f"{self.name} is not a readable .npz file.", "Write it with numpy.savez.")
