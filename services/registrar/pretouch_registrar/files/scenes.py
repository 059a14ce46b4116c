"""Reads GLB and 3MF files, which hold scenes of several parts, with trimesh."""

from __future__ import annotations

import io
import zipfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pretouch.errors import Malformed, TooLarge
from pretouch_registrar.files.shape import Shape, make_shape

_MOST_UNPACKED = 1024**3


def read_glb(name: str, data: bytes) -> Shape:
    """All triangles of a binary glTF 2.0 file, in its frame (y up), m; of one without triangles, its points.

    Raises:
        Malformed: damaged, or compressed.
    """
    if not data.startswith(b"glTF"):
        raise Malformed(f"{name} does not begin with 'glTF'.", "Export it as GLB, the binary form of glTF 2.0.")
    stated = int.from_bytes(data[8:12], "little")
    if stated > len(data):
        raise Malformed(f"{name} ends at byte {len(data)} of {stated}.", "Write the file again.")
    if b"KHR_draco_mesh_compression" in data:
        raise Malformed(f"{name} is compressed with Draco.", "Export it without compression.")
    return _read(name, data, "glb")


def read_3mf(name: str, data: bytes) -> Shape:
    """All triangles of a 3MF file, in m: the file states its unit.

    Raises:
        Malformed: damaged.
        TooLarge: it unpacks to more than a gibibyte.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            size = sum(member.file_size for member in archive.infolist())
    except zipfile.BadZipFile as error:
        raise Malformed(f"{name} is no whole ZIP archive, as a 3MF file is.", "Write the file again.") from error
    if size > _MOST_UNPACKED:
        raise TooLarge(f"{name} unpacks to {size} bytes; the limit is {_MOST_UNPACKED}.", "Simplify the mesh.")
    return _read(name, data, "3mf")


def _read(name: str, data: bytes, kind: str) -> Shape:
    import trimesh  # half a second that other formats need not wait for

    try:
        scene = trimesh.load_scene(io.BytesIO(data), file_type=kind, process=False)
        if kind == "3mf":
            scene = scene.convert_units("meters")
        parts = scene.dump()
    except ModuleNotFoundError:
        raise
    except Exception as error:  # trimesh fails in any way on damaged files
        raise Malformed(f"{name} cannot be read: {error}.", "Write the file again.") from error
    points: list[NDArray[np.float64]] = []
    faces: list[NDArray[np.int64]] = []
    meshes = [part for part in parts if isinstance(part, trimesh.Trimesh)]
    for part in meshes or _clouds(parts):
        faces.append(np.asarray(getattr(part, "faces", np.zeros((0, 3))), dtype=np.int64) + sum(map(len, points)))
        points.append(np.asarray(part.vertices, dtype=np.float64))
    if not points:
        raise Malformed(f"{name} holds no triangles.", "Export it as a triangle mesh.")
    return make_shape(name, np.concatenate(points), np.concatenate(faces))


def _clouds(parts: list[Any]) -> list[Any]:
    return [part for part in parts if len(getattr(part, "vertices", ())) and not hasattr(part, "entities")]
