"""How much memory a call will need at its peak, from the request's own numbers."""

from __future__ import annotations

from pretouch.scene import Scene
from pretouch.v1 import registrar_pb2 as pb
from pretouch_registrar.downsampling import MAX_PIXELS

Request = pb.RegisterRequest | pb.PredictScansRequest

BASE = 24 * 2**20
BYTE_OF_TARGET = 16
"""Bytes for each byte of a scene's or a mesh's message while it is decoded."""
_PIXEL, _SAMPLE, _PIECE = 900, 700, 4000
"""Bytes for a pixel of the scene as it is registered, for a sample, and for a piece of a candidate path."""


def estimate_memory(request: Request, known: Scene | None) -> int:
    """Bytes; `known` is the scene whose digest was sent."""
    target, pixels = request.mesh.ByteSize(), MAX_PIXELS
    if known is not None:
        pixels = known.mask.size
    elif request.WhichOneof("target") == "scene":
        target, pixels = request.scene.ByteSize(), len(request.scene.mask.data)
    samples = sum(len(scan.ranges.data) // 8 for scan in request.scans)
    pieces = 0
    if isinstance(request, pb.PredictScansRequest):
        pieces = sum(max(1, len(candidate.spans)) for candidate in request.candidates)
    return BYTE_OF_TARGET * target + estimate_work(pixels, samples) + _PIECE * pieces


def estimate_work(pixels: int, samples: int) -> int:
    """Bytes for registering so many samples with a scene of so many pixels."""
    return BASE + _PIXEL * min(pixels, MAX_PIXELS) + _SAMPLE * samples
