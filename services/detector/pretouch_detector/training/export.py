"""Exports trained weights: ONNX for onnxruntime, safetensors for torch, and a description in JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from pretouch.errors import Malformed, NotFound
from pretouch_detector.model.encoding import CHANNELS, SIZE
from pretouch_detector.model.scorer import Scorer
from pretouch_detector.model.weights import FORMAT

OPSET = 17


class Served(nn.Module):
    """The scorer as it is served: for one image, with its first two outputs."""

    def __init__(self, scorer: Scorer) -> None:
        super().__init__()
        self.scorer = scorer

    def forward(self, image: Tensor, rectangles: Tensor, analytic: Tensor) -> Tensor:
        """`image` (1, C, S, S), `rectangles` (n, 5), `analytic` (n,) -> `log_error` (n, 2)."""
        out: Tensor = self.scorer(image, rectangles[None], analytic[None])[0, :, :2]
        return out


def restore(model: nn.Module, weights: Path) -> None:
    """Fills the model with a safetensors file.

    Raises:
        NotFound: there is no such file.
        Malformed: it is damaged, or of another network.
    """
    if not weights.is_file():
        raise NotFound(f"There are no weights {weights}.", "Give what `pretouch train` wrote.")
    try:
        model.load_state_dict(load_file(weights))
    except Exception as error:  # safetensors and torch raise many kinds of error
        raise Malformed(f"{weights} does not fit: {error}", "Give what `pretouch train` wrote.") from error


def export_scorer(weights: Path, folder: Path, facts: dict[str, Any]) -> None:
    """Writes scorer.safetensors, scorer.onnx and scorer.json into `folder`."""
    model = Scorer()
    restore(model, weights)
    model.eval()
    folder.mkdir(parents=True, exist_ok=True)
    save_file({name: value.contiguous() for name, value in model.state_dict().items()}, folder / "scorer.safetensors")
    image, rectangles = torch.zeros(1, len(CHANNELS), SIZE, SIZE), torch.rand(7, 5) + 0.1
    analytic = torch.full((7,), 0.01)
    torch.onnx.export(
        Served(model).eval(),
        (image, rectangles, analytic),
        str(folder / "scorer.onnx"),
        input_names=["image", "rectangles", "analytic"],
        output_names=["log_error"],
        dynamic_axes={name: {0: "n"} for name in ("rectangles", "analytic", "log_error")},
        opset_version=OPSET,
        dynamo=False,
    )
    description = {"format": FORMAT, "channels": list(CHANNELS), "size": SIZE, **facts}
    (folder / "scorer.json").write_text(json.dumps(description, indent=1) + "\n")
