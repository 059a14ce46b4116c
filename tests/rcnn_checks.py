"""What is checked of the two-stage design with torch, in a process of its own: python tests/rcnn_checks.py NAME FOLDER.

torch and open3d are never in one process, and the suite's process has open3d.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import onnxruntime
import torch
from pretouch_detector.model.anchors import CELLS, SHAPES, anchors, decode, quarter_turned
from pretouch_detector.model.encoding import CHANNELS, SIZE
from pretouch_detector.model.rcnn import RotatedRCNN
from pretouch_detector.model.roi_align import BINS, roi_align
from pretouch_detector.model.rpn import RegionProposals
from pretouch_detector.overlap import overlap
from pretouch_detector.training.batch import Batch
from pretouch_detector.training.rcnn_export import FirstStage, SecondStage, export_rcnn
from pretouch_detector.training.rcnn_loss import rcnn_loss
from pretouch_detector.training.rcnn_targets import best_of
from rotated_shapes import drawn
from safetensors.torch import save_file


def bilinear(image: np.ndarray, x: float, y: float) -> np.ndarray:
    """(c,) of image (c, s, s), which covers [-1, 1]; 0 beyond."""
    s = image.shape[-1]
    u, v = (x + 1) * s / 2 - 0.5, (y + 1) * s / 2 - 0.5
    left, top = int(np.floor(u)), int(np.floor(v))
    total = np.zeros(len(image))
    for column in (left, left + 1):
        for row in (top, top + 1):
            if 0 <= column < s and 0 <= row < s:
                total += (1 - abs(u - column)) * (1 - abs(v - row)) * image[:, row, column]
    return total


def pools() -> None:
    """Bins hold the mean of four bilinear samples; the outer ones lie on the perimeter."""
    rng = np.random.default_rng(1)
    features = rng.normal(size=(2, 3, 8, 8))
    rectangles = drawn(rng, 6).reshape(2, 3, 5)
    found = roi_align(torch.tensor(features), torch.tensor(rectangles)).numpy()
    assert found.shape == (2, 3, 3, BINS, BINS)
    for image, rows, pooled in zip(features, rectangles, found, strict=True):
        for (x, y, w, h, theta), bins in zip(rows, pooled, strict=True):
            c, s = np.cos(theta), np.sin(theta)
            for row, column in np.ndindex(BINS, BINS):
                values = []
                for i in (-0.25, 0.25):
                    for j in (-0.25, 0.25):
                        a, b = w * ((column + i) / (BINS - 1) - 0.5), h * ((row + j) / (BINS - 1) - 0.5)
                        values.append(bilinear(image, x + c * a - s * b, y + s * a + c * b))
                np.testing.assert_allclose(bins[:, row, column], np.mean(values, axis=0), atol=1e-9)


def flips() -> None:
    """A mirrored image's mirrored rectangles have mirrored features, and half a turn turns them round."""
    rng = np.random.default_rng(2)
    features, rectangles = torch.tensor(rng.normal(size=(1, 4, 16, 16))), torch.tensor(drawn(rng, 5))[None]
    once = roi_align(features, rectangles)
    mirrored = roi_align(features.flip(3), rectangles * torch.tensor([-1, 1, 1, 1, -1]))
    torch.testing.assert_close(mirrored, once.flip(4))
    round_ = roi_align(features, rectangles + torch.tensor([0, 0, 0, 0, np.pi], dtype=torch.float64))
    torch.testing.assert_close(round_, once.flip(3, 4))
    quarter = torch.tensor(quarter_turned(rectangles[0].numpy(), np.ones(5, dtype=bool)))[None]
    turned = roi_align(features, quarter)
    for before, after in zip(once[0], turned[0], strict=True):
        ways = [torch.rot90(before, k, (1, 2)) for k in (1, 3)]
        assert min(float((way - after).abs().max()) for way in ways) < 1e-9


def answers_belong_to_anchors() -> None:
    """An answer's place in the first stage's output is its anchor's: by shape, and by where the image matters to it."""
    stage = RegionProposals(features=4, hidden=8)
    torch.nn.init.zeros_(stage.objectness.weight)
    torch.nn.init.zeros_(stage.deltas.weight)
    stage.objectness.bias.data = torch.arange(SHAPES).float()
    stage.deltas.bias.data = torch.arange(6 * SHAPES).float()
    objectness, deltas = stage(torch.zeros(1, 4, 2 * CELLS, 2 * CELLS))
    shape = torch.arange(len(anchors())) % SHAPES
    torch.testing.assert_close(objectness[0], shape.float())
    torch.testing.assert_close(deltas[0], (6 * shape[:, None] + torch.arange(6)).float())

    torch.manual_seed(0)
    torch.nn.init.normal_(stage.objectness.weight)
    features = torch.zeros(1, 4, 2 * CELLS, 2 * CELLS)
    features[..., -8:-6, 6:8] = 1.0
    changed = ((stage(features)[0] - stage(0 * features)[0]).abs() > 1e-6)[0].numpy()
    middle = anchors()[changed, :2].mean(axis=0)
    assert changed.sum() == 25 * SHAPES
    np.testing.assert_allclose(middle, [-0.5625, 0.5625], atol=1e-9)


def geometry(folder: Path) -> None:
    pools()
    flips()
    answers_belong_to_anchors()


def made_batch() -> Batch:
    """Two images, each a bright bar; a rectangle's error is its distance from the bar."""
    rng = np.random.default_rng(3)
    image = rng.normal(0, 0.1, (2, len(CHANNELS), SIZE, SIZE)).astype(np.float32)
    bars = np.array([[0.3, 0.2, 0.7, 0.4, 0.6], [-0.3, -0.1, 0.5, 0.6, -0.4]])
    steps = (np.arange(SIZE) + 0.5) / SIZE * 2 - 1
    for picture, (x, y, w, h, theta) in zip(image, bars, strict=True):
        dx, dy = steps[None] - x, steps[:, None] - y
        along, across = np.cos(theta) * dx + np.sin(theta) * dy, np.cos(theta) * dy - np.sin(theta) * dx
        picture[0][(np.abs(along) < w / 2) & (np.abs(across) < h / 2)] += 1
    rectangles = bars[:, None] + rng.normal(0, [0.2, 0.2, 0.05, 0.05, 0.3], (2, 20, 5))
    foreseen = 0.003 + 0.01 * np.linalg.norm(rectangles[..., :2] - bars[:, None, :2], axis=-1)
    achieved = np.where(np.arange(20) < 10, foreseen, np.nan)
    errors = np.stack([achieved, achieved, foreseen], axis=-1)
    analytic = np.full(rectangles.shape[:2], 0.007)
    return Batch(*(torch.tensor(each, dtype=torch.float32) for each in (image, rectangles, errors, analytic)))


def learns(folder: Path) -> None:
    """On two images, two score steps halve terms of the loss, and the first stage finds the best rectangles there."""
    torch.manual_seed(0)
    model, batch = RotatedRCNN(features=24, width=16, hidden=32), made_batch()
    optimiser = torch.optim.AdamW(model.parameters(), lr=2e-3)
    log: list[dict[str, float]] = []
    for _ in range(40):
        terms = rcnn_loss(model, batch)
        optimiser.zero_grad()
        torch.stack(list(terms.values())).sum().backward()
        optimiser.step()
        log.append({name: float(value.detach()) for name, value in terms.items()})
    for name in ("objectness", "anchor deltas", "foreseen"):
        assert np.mean([entry[name] for entry in log[-4:]]) < 0.5 * np.mean([entry[name] for entry in log[:2]]), name
    assert all(np.isfinite(list(entry.values())).all() for entry in log)
    for name, parameter in model.named_parameters():
        assert parameter.grad is not None, name
    objectness, deltas = model.eval().rpn(model.features(batch.image))
    for k, (found, moves) in enumerate(zip(objectness.detach(), deltas.detach(), strict=True)):
        top = found.topk(10).indices.numpy()
        best = batch.rectangles[k].double().numpy()[best_of(batch.errors[k].numpy())]
        assert overlap(decode(anchors()[top], moves.numpy()[top]), best).max(axis=1).mean() > 0.5


def served_equals_torch(folder: Path) -> None:
    """onnxruntime answers as torch does, for any number of rectangles."""
    torch.manual_seed(3)
    model = RotatedRCNN()
    for layer in (model.errors, model.deltas, model.proposals.deltas, model.proposals.objectness):
        torch.nn.init.normal_(layer.weight, std=0.1)
    model(torch.randn(4, len(CHANNELS), SIZE, SIZE), torch.rand(4, 3, 5) + 0.1)  # moves the running statistics
    save_file(model.state_dict(), folder / "trained.safetensors")
    export_rcnn(folder / "trained.safetensors", folder / "served", {"views": 3})
    told = json.loads((folder / "served" / "rcnn.json").read_text())
    assert (told["design"], told["channels"], told["views"]) == ("rcnn", list(CHANNELS), 3)
    first, second = (
        onnxruntime.InferenceSession(folder / "served" / name, providers=["CPUExecutionProvider"])
        for name in ("rcnn.onnx", "rcnn-head.onnx")
    )
    model.eval()
    rng = np.random.default_rng(5)
    with torch.no_grad():
        for count in (1, 5, 64):
            image = torch.randn(1, len(CHANNELS), SIZE, SIZE)
            features, objectness, deltas = FirstStage(model)(image)
            answers = first.run(["features", "objectness", "deltas"], {"image": image.numpy()})
            assert answers[1].shape == (len(anchors()),)
            for expected, answer in zip((features, objectness, deltas), answers, strict=True):
                np.testing.assert_allclose(answer, expected.numpy(), atol=1e-4)
            rectangles = drawn(rng, count).astype(np.float32)
            expected = SecondStage(model)(features, torch.tensor(rectangles))
            inputs = {"features": answers[0], "rectangles": rectangles}
            found = second.run(["score", "deltas", "log_error"], inputs)
            for one, other in zip(expected, found, strict=True):
                np.testing.assert_allclose(other, one.numpy(), atol=1e-4)
            assert [each.shape for each in found] == [(count,), (count, 6), (count, 2)]


if __name__ == "__main__":
    torch.set_num_threads(1)
    globals()[sys.argv[1]](Path(sys.argv[2]))
