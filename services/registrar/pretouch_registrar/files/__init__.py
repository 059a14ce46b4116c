"""Files of other people's tools: points and triangles."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from pretouch.errors import InvalidInput
from pretouch_registrar.files.meshes import read_obj, read_stl
from pretouch_registrar.files.pcd import read_pcd
from pretouch_registrar.files.ply import read_ply
from pretouch_registrar.files.shape import Shape, read_bytes

_READERS: dict[str, Callable[[str, bytes], Shape]] = {
    ".ply": read_ply,
    ".pcd": read_pcd,
    ".obj": read_obj,
    ".stl": read_stl,
}


def read_shape(path: Path) -> Shape:
    """What a PLY, PCD, OBJ or STL file holds.

    Raises:
        NotFound: it cannot be read.
        InvalidInput: another suffix, or no points in it.
        Malformed: it is damaged.
    """
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise InvalidInput(f"{path.name} is no file of points.", f"Give one of .npz, {', '.join(_READERS)}.")
    return reader(path.name, read_bytes(path))
