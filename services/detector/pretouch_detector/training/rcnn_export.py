"""The two-stage design as what is served: a graph for each stage, as the rectangles between them are numpy's work."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save_file
from torch import Tensor, nn

from pretouch_detector.model.encoding import CHANNELS, SIZE
from pretouch_detector.model.rcnn import RotatedRCNN
from pretouch_detector.model.weights import FORMAT
from pretouch_detector.training.export import OPSET, restore


class FirstStage(nn.Module):
    """`image` (1, C, S, S) -> `features` (1, f, S/4, S/4), `objectness` (A,), a logit, `deltas` (A, 6)."""

    def __init__(self, model: RotatedRCNN) -> None:
        super().__init__()
        self.model = model

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        features = self.model.features(image)
        objectness, deltas = self.model.rpn(features)
        return features, objectness[0], deltas[0]


class SecondStage(nn.Module):
    """`features`, `rectangles` (n, 5) -> `score` (n,), a logit, `deltas` (n, 6), `log_error` (n, 2) as the scorer's."""

    def __init__(self, model: RotatedRCNN) -> None:
        super().__init__()
        self.model = model

    def forward(self, features: Tensor, rectangles: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        score, deltas, errors = self.model.head(features, rectangles[None])
        return score[0], deltas[0], errors[0, :, :2]


def export_rcnn(weights: Path, folder: Path, facts: dict[str, Any]) -> None:
    """Writes rcnn.safetensors, rcnn.onnx and rcnn-head.onnx, the two stages, and rcnn.json into `folder`."""
    model = RotatedRCNN()
    restore(model, weights)
    model.eval()
    folder.mkdir(parents=True, exist_ok=True)
    save_file({name: value.contiguous() for name, value in model.state_dict().items()}, folder / "rcnn.safetensors")
    image = torch.zeros(1, len(CHANNELS), SIZE, SIZE)
    with torch.no_grad():
        features = model.features(image)
    first, second = ["features", "objectness", "deltas"], ["score", "deltas", "log_error"]
    _export(FirstStage(model), (image,), folder / "rcnn.onnx", ["image"], first, [])
    inputs = (features, torch.rand(7, 5) + 0.1)
    per_rectangle = ["rectangles", *second]
    _export(SecondStage(model), inputs, folder / "rcnn-head.onnx", ["features", "rectangles"], second, per_rectangle)
    told = {"format": FORMAT, "design": "rcnn", "channels": list(CHANNELS), "size": SIZE, **facts}
    (folder / "rcnn.json").write_text(json.dumps(told, indent=1) + "\n")


def _export(
    stage: nn.Module,
    example: tuple[Tensor, ...],
    path: Path,
    inputs: list[str],
    outputs: list[str],
    per_rectangle: list[str],
) -> None:
    torch.onnx.export(
        stage.eval(),
        example,
        str(path),
        input_names=inputs,
        output_names=outputs,
        dynamic_axes={name: {0: "n"} for name in per_rectangle},
        opset_version=OPSET,
        dynamo=False,
    )
