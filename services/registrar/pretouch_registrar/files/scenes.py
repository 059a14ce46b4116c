"""Reads GLB and 3MF files, which hold scenes of several parts, with trimesh."""

from __future__ import annotations

import contextlib
import io
import json
import warnings
import zipfile
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pretouch.errors import Malformed, PretouchError, TooLarge
from pretouch_registrar.files.shape import MAX_POINTS, Shape, check_count, make_shape

_MOST_UNPACKED = 256 * 1024**2
"""Bytes: a 3MF file of a million triangles has about a hundred million."""
_GLB_HEADER = 20
"""Bytes before the document."""
_MODEL = "3d/3dmodel.model"
_OF_LOOKS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_")
"""What the names of glTF extensions begin with that leave triangles as they are; no other is understood here."""


def read_glb(name: str, data: bytes) -> Shape:
    """All triangles of a binary glTF 2.0 file, in its frame (y up), m; of one without triangles, its points.

    Raises:
        Malformed: damaged, compressed, or not all in this file.
        TooLarge: more than MAX_POINTS points.
    """
    if not data.startswith(b"glTF"):
        raise Malformed(f"{name} does not begin with 'glTF'.", "Export it as GLB, the binary form of glTF 2.0.")
    if len(data) < _GLB_HEADER:
        raise _damaged(name)
    version, stated, length = (int.from_bytes(data[at : at + 4], "little") for at in (4, 8, 12))
    if version != 2:
        raise Malformed(f"{name} is glTF of version {version}.", "Export it as glTF 2.0.")
    if stated > len(data):
        raise Malformed(f"{name} ends at byte {len(data)} of {stated}.", "Write the file again.")
    if b"KHR_draco_mesh_compression" in data:
        raise Malformed(f"{name} is compressed with Draco.", "Export it without compression.")
    try:
        document = json.loads(data[_GLB_HEADER : _GLB_HEADER + length].decode("utf-8", "replace"))
    except (ValueError, RecursionError) as error:
        raise _damaged(name) from error
    _check_document(name, document)
    return _read(name, data, "glb")


def read_3mf(name: str, data: bytes) -> Shape:
    """All triangles of a 3MF file, in m: the file states its unit.

    Raises:
        Malformed: damaged, or encrypted.
        TooLarge: it unpacks to more than 256 MiB.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
    except Exception as error:  # zipfile raises many kinds on damaged archives
        raise Malformed(f"{name} is no whole ZIP archive, as a 3MF file is.", "Write the file again.") from error
    size = sum(member.file_size for member in members)
    if size > _MOST_UNPACKED:
        raise TooLarge(f"{name} unpacks to {size} bytes; the limit is {_MOST_UNPACKED}.", "Simplify the mesh.")
    if any(member.flag_bits & 1 for member in members):
        raise Malformed(f"{name} is encrypted.", "Save it without a password.")
    if not any(_MODEL in member.filename.lower() for member in members):
        raise Malformed(f"{name} holds no 3D/3dmodel.model.", "Export it as 3MF.")
    return _read(name, data, "3mf")


def _check_document(name: str, document: Any) -> None:
    """Raises Malformed or TooLarge for what trimesh would misread in a glTF document, or not refuse in plain words."""
    for extension in _list(name, document, "extensionsRequired"):
        if not str(extension).startswith(_OF_LOOKS):
            raise Malformed(f"{name} needs the extension {str(extension)[:60]}.", "Export it without this extension.")
    for buffer in _list(name, document, "buffers"):
        uri = buffer.get("uri") if isinstance(buffer, dict) else None
        if uri is not None and not str(uri).startswith("data:"):
            raise Malformed(f"{name} refers to another file, {str(uri)[:60]}.", "Export it as one .glb.")
    for accessor in _list(name, document, "accessors"):
        count = accessor.get("count") if isinstance(accessor, dict) else None
        if isinstance(count, int) and count > 3 * MAX_POINTS:  # indices: three a face
            raise TooLarge(f"{name} announces more than {3 * MAX_POINTS} values at once.", "Simplify the mesh.")


def _list(name: str, document: Any, key: str) -> list[Any]:
    found = document.get(key, []) if isinstance(document, dict) else None
    if not isinstance(found, list):
        raise _damaged(name)
    return found


def _damaged(name: str) -> Malformed:
    return Malformed(f"{name} is damaged.", "Write the file again.")


def _read(name: str, data: bytes, kind: str) -> Shape:
    import trimesh  # half a second that other formats need not wait for

    try:
        with _silence():
            scene = trimesh.load_scene(io.BytesIO(data), file_type=kind, process=False)
            if kind == "3mf":
                scene = scene.convert_units("meters")
            placed = (scene.geometry[scene.graph[node][1]] for node in scene.graph.nodes_geometry)
            check_count(name, sum(len(getattr(part, "vertices", ())) for part in placed))
            parts = scene.dump()
    except (PretouchError, MemoryError, ModuleNotFoundError):
        raise
    except Exception as error:  # trimesh fails in any way on damaged files
        raise _damaged(name) from error
    points: list[NDArray[np.float64]] = []
    faces: list[NDArray[np.int64]] = []
    meshes = [part for part in parts if isinstance(part, trimesh.Trimesh)]
    for part in meshes or _clouds(parts):
        faces.append(np.asarray(getattr(part, "faces", np.zeros((0, 3))), dtype=np.int64) + sum(map(len, points)))
        points.append(np.asarray(part.vertices, dtype=np.float64))
    if not points:
        raise Malformed(f"{name} holds no triangles.", "Export it as a triangle mesh.")
    return make_shape(name, np.concatenate(points), np.concatenate(faces))


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Keeps warnings, log lines and prints of trimesh and numpy from the terminal: errors are told by us."""
    nowhere = io.StringIO()
    with (
        contextlib.redirect_stdout(nowhere),
        contextlib.redirect_stderr(nowhere),
        warnings.catch_warnings(action="ignore"),
        np.errstate(all="ignore"),
    ):
        yield


def _clouds(parts: list[Any]) -> list[Any]:
    return [part for part in parts if len(getattr(part, "vertices", ())) and not hasattr(part, "entities")]
