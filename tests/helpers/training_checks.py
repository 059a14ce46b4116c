"""Checks that need torch, in a separate process: python -m helpers.training_checks NAME FOLDER.

torch's threads and half a gigabyte stay out of the suite's process.
"""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import torch
import typer
from pretouch_detector.model.encoding import CHANNELS, SIZE, Encoding
from pretouch_detector.model.scorer import OUTPUTS, Scorer, sample_perimeters
from pretouch_detector.model.weights import FOLDER, load
from pretouch_detector.training.command import train
from pretouch_detector.training.dataset import SIDES, Dataset, write
from pretouch_detector.training.export import Served, export_scorer, restore
from pretouch_detector.training.processes import join_processes
from pretouch_detector.training.schedule import Schedule
from pretouch_detector.training.targets import Targets, targets_of
from pretouch_detector.training.trainer import Trainer
from safetensors.torch import load_file
from torch import distributed
from typer.testing import CliRunner

from helpers.label_cases import example
from pretouch.errors import Conflict, Malformed, NotFound
from pretouch.rectangle import RotatedRectangle

CPU = torch.device("cpu")
SCHEDULE = Schedule(epochs=2, batch=4, rectangles=8)


def made_views(count: int, seed: int = 0) -> list[Targets]:
    """Views in which a rectangle's error is its centre's height in the image, half of them not scanned."""
    rng = np.random.default_rng(seed)
    views = []
    for _ in range(count):
        image = rng.normal(size=(len(CHANNELS), SIZE, SIZE)).astype(np.float32)
        rectangles = np.column_stack(
            [rng.uniform(-0.5, 0.5, (12, 2)), rng.uniform(0.2, 0.6, (12, 2)), rng.uniform(-1.5, 1.5, 12)]
        ).astype(np.float32)
        error = 0.005 * np.exp(2 * rectangles[:, 1])
        errors = np.column_stack([np.where(np.arange(12) < 6, error, np.nan), error, error]).astype(np.float32)
        views.append(Targets(image, rectangles, np.full(12, 0.007, np.float32), errors))
    return views


class Interrupting(list[Targets]):
    """Views that can be scored once; then comes Ctrl-C."""

    scored = 0

    def __len__(self) -> int:
        self.scored += 1
        if self.scored > 1:
            raise KeyboardInterrupt
        return super().__len__()


def perimeters(folder: Path) -> None:
    """The points lie on the rectangle, evenly, and tangents point along it."""
    rng = np.random.default_rng(1)
    given = np.column_stack([rng.normal(size=(50, 2)), rng.uniform(0.1, 2, (50, 2)), rng.uniform(-1.5, 1.5, 50)])
    model = Scorer()
    points, tangents = (each.double().numpy() for each in sample_perimeters(torch.tensor(given), model.steps.double()))
    for row, on, along in zip(given, points, tangents, strict=True):
        step = 2 * (row[2] + row[3]) / len(on)
        rectangle = RotatedRectangle(*row)
        assert np.abs(rectangle.distance(on)).max() < 1e-9
        np.testing.assert_allclose(np.abs(rectangle.distance(on + 1e-4 * along)), 0, atol=1.01e-4)
        gaps = np.linalg.norm(np.roll(on, -1, axis=0) - on, axis=1)
        assert (gaps <= step + 1e-6).all()
        assert np.isclose(gaps, step, atol=1e-6).sum() >= len(on) - 4


def learns(folder: Path) -> None:
    """Three dozen steps on a rule that can be seen bring the loss down."""
    torch.manual_seed(0)
    trainer = Trainer(Scorer(), Schedule(epochs=6, batch=4, rectangles=12, average=0.5), folder, CPU)
    trainer.train(made_views(24), made_views(8, 1))
    first, last = trainer.log[0]["validation foreseen"], trainer.log[-1]["validation foreseen"]
    assert last < 0.8 * first, (first, last)


def resumes(folder: Path) -> None:
    """A run stopped after an epoch and taken up again ends as one that was not."""
    views, validation = made_views(8), made_views(4, 1)
    for name, stops in (("whole", False), ("stopped", True)):
        torch.manual_seed(0)
        model = Scorer()
        trainer = Trainer(model, SCHEDULE, folder / name, CPU)
        if stops:
            with suppress(KeyboardInterrupt):
                trainer.train(views, Interrupting(validation))
            assert len(trainer.log) == 1
            trainer = Trainer(Scorer(), SCHEDULE, folder / name, CPU)
            assert len(trainer.log) == 1
        trainer.train(views, validation)
    whole, stopped = (torch.load(folder / n / "checkpoint.pt", weights_only=True) for n in ("whole", "stopped"))
    assert len(whole["log"]) == len(stopped["log"]) == 2
    for name, value in whole["averaged"].items():
        torch.testing.assert_close(value, stopped["averaged"][name], rtol=0, atol=1e-4)
    try:
        Trainer(Scorer(), Schedule(epochs=3), folder / "whole", CPU)
    except Conflict:
        return
    raise AssertionError("another schedule went on with the run")


def served_equals_torch(folder: Path) -> None:
    """onnxruntime answers as torch does, for any number of rectangles."""
    torch.manual_seed(3)
    model = Scorer()
    for parameter in model.head.parameters():
        torch.nn.init.normal_(parameter, std=0.1)
    trainer = Trainer(model, SCHEDULE, folder / "run", CPU)
    trainer.train(made_views(4), made_views(4, 1))
    export_scorer(folder / "run" / "weights.safetensors", folder / "served", {})
    network = load(folder / "served", 1)
    restore(model, folder / "served" / "scorer.safetensors")
    served = Served(model).eval()
    for view in made_views(3, 7):
        for n in (1, 5, 12):
            encoding = Encoding(view.image, (0.0, 0.0), 1.0)
            with torch.no_grad():
                inputs = (view.image[None], view.rectangles[:n], view.analytic[:n])
                told = served(*map(torch.tensor, inputs)).numpy()
            answered = network.predict_errors(encoding, view.rectangles[:n], view.analytic[:n])
            np.testing.assert_allclose(answered, np.exp(told[:, 0]), rtol=1e-4)
    assert told.shape == (12, 2)
    assert len(OUTPUTS) == 4


def commanded(folder: Path) -> None:
    """`pretouch train` leaves weights that can be served, and begins with those that it is given."""
    dataset = Dataset.create(folder / "labels", {"recipe": {"kind": "scans"}})
    for side in SIDES:
        write(dataset.path(side, "box-0-0"), example())
    app = typer.Typer()
    app.command()(train)
    arguments = ["--dataset", str(dataset.folder), "--epochs", "1", "--device", "cpu"]
    shipped_weights = FOLDER / "scorer.safetensors"
    for name, more in (("anew", []), ("further", ["--rate", "0", "--start", str(shipped_weights)])):
        done = CliRunner().invoke(app, [*arguments, *more, "--out", str(folder / name)])
        assert done.exit_code == 0, (done.output, done.exception)
        assert (folder / name / "curves.png").stat().st_size > 0
    given, further = (load_file(each) for each in (shipped_weights, folder / "further" / "scorer.safetensors"))
    for name, _ in Scorer().named_parameters():
        torch.testing.assert_close(further[name], given[name], rtol=0, atol=0)
    view = targets_of(example(), worst=False)
    for name in ("anew", "further"):
        scorer = Scorer()
        restore(scorer, folder / name / "scorer.safetensors")
        with torch.no_grad():
            inputs = (torch.tensor(each)[None] for each in (view.image, view.rectangles, view.analytic))
            by_torch = scorer.eval()(*inputs)[0, :, 0].exp().numpy()
        answered = load(folder / name, 1).predict_errors(
            Encoding(view.image, (0.0, 0.0), 1.0), view.rectangles, view.analytic
        )
        np.testing.assert_allclose(answered, by_torch, rtol=1e-4)


def shared(folder: Path) -> None:
    """By torchrun: each process learns from its own views; all come to the same weights and part before the end."""
    torch.manual_seed(0)
    with join_processes(CPU) as among:
        trainer = Trainer(Scorer(), SCHEDULE, folder, CPU, among)
        trainer.train(made_views(16), made_views(4, 1))
        assert among.world == 2
        mine = torch.cat([parameter.detach().flatten() for parameter in trainer.model.parameters()])
        all_of_them = [torch.empty_like(mine) for _ in range(among.world)]
        distributed.all_gather(all_of_them, mine)
        torch.testing.assert_close(all_of_them[0], all_of_them[1], rtol=0, atol=0)
    names = [thread.read_text() for thread in Path("/proc/self/task").glob("*/comm")]
    assert not [name for name in names if "gloo" in name], names


def shipped(folder: Path) -> None:
    """The weights that are shipped: both files are the same network."""
    network = load(FOLDER, 1)
    scorer = Scorer()
    restore(scorer, FOLDER / "scorer.safetensors")
    for view in made_views(3, 11):
        encoding = Encoding(view.image, (0.0, 0.0), 1.0)
        image, rectangles, analytic = (
            torch.tensor(each)[None] for each in (view.image, view.rectangles, view.analytic)
        )
        with torch.no_grad():
            by_scorer = scorer.eval()(image, rectangles, analytic)[0, :, 0].exp().numpy()
        np.testing.assert_allclose(
            network.predict_errors(encoding, view.rectangles, view.analytic), by_scorer, rtol=1e-4
        )


def refuses(folder: Path) -> None:
    """Weights that are missing, damaged or of another network."""
    damaged = folder / "damaged.safetensors"
    damaged.write_bytes(b"\x10\x00")
    for path, kind in ((folder / "none.safetensors", NotFound), (damaged, Malformed)):
        try:
            restore(Scorer(), path)
        except kind:
            continue
        raise AssertionError(path)


if __name__ == "__main__":
    torch.set_num_threads(1)
    globals()[sys.argv[1]](Path(sys.argv[2]))
