"""How much memory a call will need at its peak, from the request's own numbers.

The factors are one and a half times what the resident set grew by at most (4 megapixels, 400,000 samples, 2000 pieces).
"""

from __future__ import annotations

from pretouch.scene import Scene
from pretouch.v1 import registrar_pb2 as pb
from pretouch_registrar.downsampling import MAX_PIXELS

Request = pb.RegisterRequest | pb.PredictScansRequest

BASE = 24 * 2**20
BYTE_OF_TARGET = 20
"""Bytes for each byte of a mesh's message while it is decoded; a scene takes a quarter of that."""
_PIXEL, _SAMPLE, _PIECE = 500, 700, 40_000
"""Bytes for a pixel of the scene as it is registered, for a sample, and for a piece of a candidate path."""


def estimate_memory(request: Request, known: Scene | None) -> int:
    """Bytes; `known` is the scene whose digest was sent."""
    target, pixels = BYTE_OF_TARGET * request.mesh.ByteSize(), MAX_PIXELS
    if known is not None:
        pixels = known.mask.size
    elif request.WhichOneof("target") == "scene":
        target, pixels = BYTE_OF_TARGET // 4 * request.scene.ByteSize(), len(request.scene.mask.data)
    samples = sum(len(scan.ranges.data) // 8 for scan in request.scans)
    pieces = 0
    if isinstance(request, pb.PredictScansRequest):
        pieces = sum(max(1, len(candidate.spans)) for candidate in request.candidates)
    return target + estimate_work(pixels, samples) + _PIECE * pieces


def estimate_work(pixels: int, samples: int) -> int:
    """Bytes for registering so many samples with a scene of so many pixels."""
    return BASE + _PIXEL * min(pixels, MAX_PIXELS) + _SAMPLE * samples
