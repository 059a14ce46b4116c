"""Files of other people's tools: points and triangles."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from pretouch.errors import InvalidInput
from pretouch_registrar.files.content import read_bytes
from pretouch_registrar.files.obj import read_obj
from pretouch_registrar.files.off import read_off
from pretouch_registrar.files.pcd import read_pcd
from pretouch_registrar.files.ply import read_ply
from pretouch_registrar.files.scenes import read_3mf, read_glb
from pretouch_registrar.files.shape import Shape
from pretouch_registrar.files.stl import read_stl

_READERS: dict[str, Callable[[str, bytes], Shape]] = {
    ".ply": read_ply,
    ".pcd": read_pcd,
    ".obj": read_obj,
    ".stl": read_stl,
    ".off": read_off,
    ".glb": read_glb,
    ".3mf": read_3mf,
}
MESH_SUFFIXES = (".ply", ".obj", ".stl", ".off", ".glb", ".3mf")
"""Of files that may hold triangles."""


def read_shape(path: Path) -> Shape:
    """What a PLY, PCD, OBJ, STL, OFF, GLB or 3MF file holds.

    Raises:
        NotFound: it cannot be read.
        InvalidInput: another suffix, or no points in it.
        Malformed: it is damaged; the message says why and in which line or at which byte.
    """
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise InvalidInput(f"{path.name} is no file of points.", f"Give one of .npz, {', '.join(_READERS)}.")
    try:
        with np.errstate(invalid="ignore"):  # numpy warns of signalling NaN, which is no data like any other
            return reader(path.name, read_bytes(path))
    except (MemoryError, OverflowError) as error:
        raise InvalidInput(f"{path.name} is too large for this machine's memory.", "Thin it out.") from error
