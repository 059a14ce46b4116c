"""Weights as proposer `deep` reads them, without training and without onnx.

Log error = rectangle . slope + bias + share * log analytic.

The graph is written straight in protobuf's wire format, field numbers as in onnx.proto (IR version 8, opset 17).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pretouch_detector.model.encoding import CHANNELS, SIZE
from pretouch_detector.model.weights import FORMAT

SLOPE = (-1.0, 0.0, 0.0, 0.0, 0.0)
"""The further right, the better."""
_FLOAT, _INT64 = 1, 7


def write(
    folder: Path,
    slope: Sequence[float] = SLOPE,
    bias: float = -5.0,
    share: float = 0.0,
    output: str = "log_error",
    **facts: Any,
) -> Path:
    """Writes scorer.onnx and scorer.json into `folder`; `facts` replace what the latter says."""
    folder.mkdir(exist_ok=True)
    (folder / "scorer.onnx").write_bytes(_model(np.asarray(slope, np.float32), bias, share, output))
    about = {"format": FORMAT, "channels": list(CHANNELS), "size": SIZE, **facts}
    (folder / "scorer.json").write_text(json.dumps(about))
    return folder


def _model(slope: np.ndarray, bias: float, share: float, output: str) -> bytes:
    weights = {
        "slope": np.stack([slope, np.zeros(5, np.float32)], axis=1),
        "bias": np.array([bias, -0.7], np.float32),
        "share": np.array([[share, 0.0]], np.float32),
    }
    graph = _node("Log", ("analytic",), "logs") + _node("Unsqueeze", ("logs", "axis"), "column")
    graph += _node("Gemm", ("rectangles", "slope", "bias"), "linear") + _node("Gemm", ("column", "share"), "shared")
    graph += _node("Add", ("linear", "shared"), output) + _field(2, b"made")
    graph += _field(5, _number(1, 1) + _number(2, _INT64) + _field(8, b"axis") + _field(9, (1).to_bytes(8, "little")))
    graph += b"".join(_field(5, _tensor(name, values)) for name, values in weights.items())
    graph += _field(11, _value("image", (1, len(CHANNELS), SIZE, SIZE)))
    graph += _field(11, _value("rectangles", ("n", 5))) + _field(11, _value("analytic", ("n",)))
    graph += _field(12, _value(output, ("n", 2)))
    return _number(1, 8) + _field(7, graph) + _field(8, _number(2, 17))


def _node(kind: str, inputs: Sequence[str], output: str) -> bytes:
    return _field(
        1, b"".join(_field(1, name.encode()) for name in inputs) + _field(2, output.encode()) + _field(4, kind.encode())
    )


def _tensor(name: str, values: np.ndarray) -> bytes:
    dims = b"".join(_number(1, n) for n in values.shape)
    return dims + _number(2, _FLOAT) + _field(8, name.encode()) + _field(9, values.astype("<f4").tobytes())


def _value(name: str, shape: Sequence[int | str]) -> bytes:
    dims = b"".join(_field(1, _number(1, n) if isinstance(n, int) else _field(2, n.encode())) for n in shape)
    return _field(1, name.encode()) + _field(2, _field(1, _number(1, _FLOAT) + _field(2, dims)))


def _field(number: int, data: bytes) -> bytes:
    return _varint(number << 3 | 2) + _varint(len(data)) + data


def _number(number: int, value: int) -> bytes:
    return _varint(number << 3) + _varint(value)


def _varint(value: int) -> bytes:
    low, rest = value & 0x7F, value >> 7
    return bytes([low | 0x80]) + _varint(rest) if rest else bytes([low])
