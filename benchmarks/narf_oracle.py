"""PCL's NARF as an oracle: `narf_oracle.cpp` built against Debian's libpcl-dev, asked through files."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pretouch.camera import Camera, DepthImage

SOURCE = Path(__file__).resolve().parent / "pcl" / "narf_oracle.cpp"
BEAMS = 36
_HEADERS = Path("/usr/include")
_LIBRARIES = ("pcl_keypoints", "pcl_features", "pcl_common")
_OBSTACLE = (10, 8, 7, 9)
"""Bits of PCL's border traits: obstacle border to the left, right, top, bottom."""
_SHADOW, _VEIL = 1, 2
Floats = NDArray[np.float32]


class Missing(Exception):
    """PCL or a compiler is not installed."""


@dataclass(frozen=True, eq=False)
class Question:
    """A depth image and the support size, m, of its keypoints."""

    depth: DepthImage
    camera: Camera
    support: float


@dataclass(frozen=True, eq=False)
class Answer:
    """What PCL makes of it; sides are left, right, top, bottom.

    Attributes:
        first_scores, scores: (4, h, w) border scores, as first computed and after the search for shadows.
        obstacle: (4, h, w); shadow, veil: (h, w): the border traits.
        change, directions: (h, w), (h, w, 3) surface change.
        interest: (h, w), the complete interest image.
        sparse: (h, w), the sparse one, PCL's default.
        keypoints: (n, 4) as x, y, z, m, in the camera frame, and interest; of the complete image.
        sparse_keypoints: (m, 4), of the sparse one.
        described: (n,) whether the keypoint has a descriptor; descriptors: (n, 36), without rotation.
        ms: of everything but the sparse image and the files.
    """

    first_scores: Floats
    scores: Floats
    obstacle: NDArray[np.bool_]
    shadow: NDArray[np.bool_]
    veil: NDArray[np.bool_]
    change: Floats
    directions: Floats
    interest: Floats
    sparse: Floats
    keypoints: Floats
    sparse_keypoints: Floats
    described: NDArray[np.bool_]
    descriptors: Floats
    ms: float


def build(folder: Path) -> Path:
    """The oracle, compiled into `folder` unless it is there already.

    Raises:
        Missing: it does not compile here.
    """
    program = folder / "narf_oracle"
    if program.is_file() and program.stat().st_mtime > SOURCE.stat().st_mtime:
        return program
    includes = [f"-I{path}" for path in (*sorted(_HEADERS.glob("pcl-*")), _HEADERS / "eigen3")]
    words = ["g++", "-O3", "-std=c++17", "-DNDEBUG", "-w", *includes, str(SOURCE), "-o", str(program)]
    try:
        done = subprocess.run(
            [*words, *(f"-l{name}" for name in _LIBRARIES)], capture_output=True, text=True, timeout=300
        )
    except OSError as error:
        raise Missing("There is no g++ (Debian: g++ libpcl-dev).") from error
    if done.returncode:
        raise Missing("PCL's headers or libraries are not installed (Debian: libpcl-dev).")
    return program


def ask(program: Path, questions: Sequence[Question], timeout: float) -> list[Answer]:
    """PCL's answers, in order; `timeout` in seconds."""
    with tempfile.TemporaryDirectory() as name:
        images, answers = Path(name) / "images", Path(name) / "answers"
        with images.open("wb") as file:
            for question in questions:
                camera = question.camera
                optics = [camera.fx, camera.fy, camera.cx, camera.cy, question.support]
                file.write(np.array(question.depth.metres.shape, "<i4").tobytes())
                file.write(np.array(optics, "<f4").tobytes())
                file.write(np.ascontiguousarray(question.depth.metres, "<f4").tobytes())
        subprocess.run([program, images, answers], check=True, capture_output=True, timeout=timeout)
        return list(_read(answers.read_bytes(), [question.depth.metres.shape for question in questions]))


def _read(data: bytes, shapes: Sequence[tuple[int, ...]]) -> Iterator[Answer]:
    at = 0

    def take(kind: str, *shape: int) -> NDArray[Any]:
        nonlocal at
        count = int(np.prod(shape))
        values = np.frombuffer(data, kind, count, at).reshape(shape)
        at += 4 * count
        return values

    for h, w in shapes:
        first, scores = take("<f4", 4, h, w), take("<f4", 4, h, w)
        traits = take("<i4", h, w)
        change, directions = take("<f4", h, w), take("<f4", 3, h, w)
        interest, sparse = take("<f4", h, w), take("<f4", h, w)
        points = take("<i4", int(take("<i4", 1)[0]), 4 + 1 + BEAMS)
        sparse_points = take("<f4", int(take("<i4", 1)[0]), 4)
        yield Answer(
            first,
            scores,
            np.stack([traits >> bit & 1 for bit in _OBSTACLE]).astype(bool),
            (traits >> _SHADOW & 1).astype(bool),
            (traits >> _VEIL & 1).astype(bool),
            change,
            np.moveaxis(directions, 0, -1),
            interest,
            sparse,
            points[:, :4].view("<f4"),
            sparse_points,
            points[:, 4].astype(bool),
            points[:, 5:].view("<f4"),
            float(take("<f4", 1)[0]),
        )
