"""`pretouch train`: teaches a network where to sense."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import torch
import typer
from rich.console import Console
from torch import nn

from pretouch.errors import InvalidInput
from pretouch_detector.model.rcnn import RotatedRCNN
from pretouch_detector.model.scorer import Scorer
from pretouch_detector.training.curves import draw
from pretouch_detector.training.export import export_scorer
from pretouch_detector.training.processes import processes
from pretouch_detector.training.rcnn_export import export_rcnn
from pretouch_detector.training.rcnn_loss import rcnn_loss
from pretouch_detector.training.scorer_loss import scorer_loss
from pretouch_detector.training.targets import load
from pretouch_detector.training.trainer import Loss, Schedule, Trainer

_INTERRUPTED = 130


class Design(StrEnum):
    """`SCORER` reads features along the perimeter of given rectangles; `RCNN` proposes rectangles by itself."""

    SCORER = "scorer"
    RCNN = "rcnn"


_PARTS: dict[Design, tuple[Callable[[], nn.Module], Loss, Callable[[Path, Path, dict[str, Any]], None]]] = {
    Design.SCORER: (Scorer, scorer_loss, export_scorer),
    Design.RCNN: (RotatedRCNN, rcnn_loss, export_rcnn),
}
"""The network, what it is taught by, and how it is written for serving."""


def train(
    dataset: Annotated[list[Path], typer.Option(help="Folder that `pretouch labels generate` wrote; repeatable.")],
    out: Annotated[Path, typer.Option(help="Folder of the run; one that was stopped goes on.")],
    design: Annotated[Design, typer.Option(help="Which network.")] = Design.SCORER,
    epochs: Annotated[int, typer.Option(min=1)] = Schedule.epochs,
    batch: Annotated[int, typer.Option(min=1, help="Views a step and process.")] = Schedule.batch,
    rectangles: Annotated[int, typer.Option(min=1, help="Of each view and step.")] = Schedule.rectangles,
    rate: Annotated[float, typer.Option(min=0.0, help="The highest learning rate.")] = Schedule.rate,
    seed: Annotated[int, typer.Option(help="Of the weights at the start, the order and the augmentations.")] = 0,
    device: Annotated[str | None, typer.Option(help="cpu or cuda.", show_default="cuda if there is one")] = None,
) -> None:
    """Teach a network where to sense, from labels.

    On several processes or machines: torchrun --nproc-per-node N --no-python pretouch train ... In the end the folder
    OUT holds the weights for torch and for serving, the log and its curves.
    """
    console = Console(stderr=True)
    place = _device(device)
    torch.manual_seed(seed)
    schedule = Schedule(epochs=epochs, batch=batch, rectangles=rectangles, rate=rate, seed=seed)
    network, loss, export = _PARTS[design]
    with processes(place) as among:
        trainer = Trainer(network(), loss, schedule, out, place, among)
        views, validation = load(dataset, "train"), load(dataset, "validation")
        try:
            trainer.train(views, validation)
        except KeyboardInterrupt:
            console.print(f"Interrupted. {len(trainer.log)} of {epochs} epochs are kept; the same command goes on.")
            raise typer.Exit(_INTERRUPTED) from None
    if among.rank > 0:
        return
    facts = {
        "command": shlex.join(["pretouch", *sys.argv[1:]]),
        "views": {"train": len(views), "validation": len(validation)},
        "validation": trainer.judged(validation),
    }
    export(out / "weights.safetensors", out, facts)
    console.print(f"The weights are {out}/{design}.onnx and .safetensors; the curves are {draw(out)}.")


def _device(name: str | None) -> torch.device:
    if name is None:
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if name not in ("cpu", "cuda"):
        raise InvalidInput(f"There is no device {name!r}.", "Choose cpu or cuda.")
    if name == "cuda" and not torch.cuda.is_available():
        raise InvalidInput("torch finds no GPU.", "Choose cpu, or install a torch with CUDA.")
    return torch.device(name)
