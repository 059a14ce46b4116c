"""`pretouch train`: trains the network of proposer `deep`."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from pretouch.errors import InvalidInput
from pretouch.interrupts import INTERRUPTED
from pretouch.results import check_folder
from pretouch_detector.training.schedule import Schedule

if TYPE_CHECKING:
    import torch


def train(
    dataset: Annotated[list[Path], typer.Option(help="Folder that `pretouch labels generate` wrote; repeatable.")],
    out: Annotated[Path, typer.Option(help="Folder of the run; one that was stopped goes on.")],
    start: Annotated[Path | None, typer.Option(help="Weights to begin with: a scorer.safetensors.")] = None,
    epochs: Annotated[int, typer.Option(min=1)] = Schedule.epochs,
    batch: Annotated[int, typer.Option(min=1, help="Views a step and process.")] = Schedule.batch,
    rectangles: Annotated[int, typer.Option(min=1, help="Of each view and step.")] = Schedule.rectangles,
    rate: Annotated[float, typer.Option(min=0.0, help="The highest learning rate.")] = Schedule.rate,
    seed: Annotated[
        int,
        typer.Option(
            help="Fixes the weights at the start, the order and the augmentations; a GPU's sums may differ in "
            "their last bits."
        ),
    ] = 0,
    device: Annotated[str | None, typer.Option(help="cpu or cuda.", show_default="cuda if there is one")] = None,
) -> None:
    """Teach the network where to sense, from labels.

    On several processes or machines: torchrun --nproc-per-node N --no-python pretouch train ... In the end the folder
    OUT holds the weights for torch and for serving, the log and its curves.
    """
    import torch

    from pretouch_detector.model.scorer import Scorer
    from pretouch_detector.training.curves import draw_curves
    from pretouch_detector.training.export import export_scorer, restore
    from pretouch_detector.training.processes import join_processes
    from pretouch_detector.training.targets import load
    from pretouch_detector.training.trainer import Trainer

    check_folder(out)
    console = Console(stderr=True)
    place = _choose_device(device)
    torch.manual_seed(seed)
    schedule = Schedule(epochs=epochs, batch=batch, rectangles=rectangles, rate=rate, seed=seed)
    network = Scorer()
    if start is not None:
        restore(network, start)
    with join_processes(place) as among:
        trainer = Trainer(network, schedule, out, place, among)
        views, validation = load(dataset, "train"), load(dataset, "validation")
        try:
            trainer.train(views, validation)
        except KeyboardInterrupt:
            console.print(f"Interrupted. {len(trainer.log)} of {epochs} epochs are kept; the same command goes on.")
            raise typer.Exit(INTERRUPTED) from None
    if among.rank > 0:
        return
    facts = {
        "command": shlex.join(["pretouch", *sys.argv[1:]]),
        "views": {"train": len(views), "validation": len(validation)},
        "validation": trainer.evaluate(validation),
    }
    export_scorer(out / "weights.safetensors", out, facts)
    console.print(f"The weights are {out}/scorer.onnx and .safetensors; the curves are {draw_curves(out)}.")


def _choose_device(name: str | None) -> torch.device:
    import torch

    if name is None:
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if name not in ("cpu", "cuda"):
        raise InvalidInput(f"There is no device {name!r}.", "Choose cpu or cuda.")
    if name == "cuda" and not torch.cuda.is_available():
        raise InvalidInput("torch finds no GPU.", "Choose cpu, or install a torch with CUDA.")
    return torch.device(name)
