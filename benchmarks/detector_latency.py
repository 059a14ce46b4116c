"""How long proposing takes on 640 x 480 views, for each proposer; `deep` by onnxruntime beside plain torch.

`python -m benchmarks.detector_latency [--meshes DIR] [--views N] [--repeats N] [--weights DIR] [--json OUT]`

The views are the evaluation's (Kinect noise, one of each mesh in turn; without --meshes of the objects made in code),
whole. Two threads on two cores. Torch, if it is there, runs the same network in a process of its own on exactly the
questions that `deep` asked, after one round that does not count, without gradients.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pretouch_detector.model.encoding import Encoding
from pretouch_detector.model.weights import FOLDER, Network, Weights
from pretouch_detector.proposals import deep, list_readiness, propose, warm_up

from benchmarks.narf import views
from pretouch.errors import Unavailable
from pretouch.geometry import Array
from pretouch.scene import Scene
from pretouch.session import Proposer
from pretouch.tof import Sensor

THREADS = 2
REGIONS = 20
INPUTS = ("image", "rectangles", "analytic")
Floats = np.ndarray[Any, np.dtype[np.floating[Any]]]
Question = dict[str, Floats]


@dataclass(frozen=True, eq=False)
class Recorder(Network):
    """A network that records its inputs.

    Attributes:
        asked: the graph's inputs of each question.
    """

    asked: list[Question] = field(default_factory=list)

    def predict_errors(self, encoding: Encoding, rectangles: ArrayLike, analytic: ArrayLike) -> Array:
        inputs = (encoding.image[None], encoding.normalise(rectangles), np.asarray(analytic, dtype=np.float32))
        self.asked.append(dict(zip(INPUTS, inputs, strict=True)))
        return super().predict_errors(encoding, rectangles, analytic)


def time_proposers(scenes: Sequence[Scene], repeats: int) -> dict[str, list[float]]:
    """ms of each request, for each proposer that is ready."""
    times: dict[str, list[float]] = {}
    for proposer, reason in list_readiness():
        if reason:
            print(f"{proposer} is not ready: {reason}")
            continue
        times[proposer] = time_calls([_request(scene, proposer) for scene in scenes], repeats)
    return times


def _request(scene: Scene, proposer: Proposer) -> Callable[[], object]:
    def request() -> object:
        fresh = Scene(scene.depth, scene.camera, scene.base_T_camera, scene.mask, scene.table)
        return propose(fresh, proposer, Sensor(), REGIONS, 0)

    return request


def time_calls(calls: Sequence[Callable[[], object]], repeats: int) -> list[float]:
    """ms of each call, `repeats` times all in turn, after one that does not count."""
    calls[0]()
    times = []
    for _ in range(repeats):
        for call in calls:
            started = time.perf_counter()
            call()
            times.append(1e3 * (time.perf_counter() - started))
    return times


def networks(scenes: Sequence[Scene], repeats: int, folder: Path) -> dict[str, Any]:
    """ms of the network alone, by onnxruntime and by torch, on the questions of each view, and how far they are apart.

    Raises:
        Unavailable: the weights cannot be read, or torch cannot.
    """
    network = deep.WEIGHTS.get_network()
    questions: list[Question] = []
    for scene in scenes:
        recorder = Recorder(network.session)
        deep.propose_with(recorder, scene, Sensor(), REGIONS, np.random.default_rng(0))
        questions += recorder.asked

    def ask(question: Question) -> Floats:
        answer: Floats = network.session.run(None, question)[0]
        return answer

    answers = [ask(question) for question in questions]
    times = time_calls([partial(ask, question) for question in questions], repeats)
    torch_times, torch_answers = _time_torch(questions, repeats, folder)
    mine, theirs = (np.concatenate(each) for each in (answers, torch_answers))
    return {"onnxruntime": times, "torch": torch_times, "apart": float(np.abs(mine - theirs).max())}


def _time_torch(questions: list[Question], repeats: int, folder: Path) -> tuple[list[float], list[Floats]]:
    weights = folder / "scorer.safetensors"
    if importlib.util.find_spec("torch") is None or not weights.is_file():
        raise Unavailable("There is no torch, or no scorer.safetensors.", "Install pretouch[train].")
    with tempfile.TemporaryDirectory() as name:
        asked, told = Path(name) / "questions.npz", Path(name) / "answers.npz"
        arrays: dict[str, Any] = {
            f"{name}-{k}": array for k, question in enumerate(questions) for name, array in question.items()
        }
        np.savez(asked, **arrays)
        files = (str(asked), str(told), str(weights))
        command = [sys.executable, "-m", "benchmarks.detector_latency_torch", *files, str(THREADS), str(repeats)]
        subprocess.run(command, check=True, timeout=1800)
        with np.load(told) as file:
            return file["ms"].tolist(), [file[f"answer-{k}"] for k in range(len(questions))]


def line(name: str, times: Sequence[float]) -> str:
    p50, p95 = np.percentile(times, (50, 95))
    return f"{name:36} p50 {p50:7.1f} ms   p95 {p95:7.1f} ms   n = {len(times)}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--meshes", type=Path, help="a folder of meshes instead of the objects made in code")
    parser.add_argument("--views", type=int, default=24)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--weights", type=Path, default=FOLDER)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    os.sched_setaffinity(0, set(sorted(os.sched_getaffinity(0))[-THREADS:]))
    scenes = [scene for _, scene in views(options.views, options.meshes)]
    deep.WEIGHTS = Weights(options.weights)
    deep.warm_up(THREADS)
    warm_up()
    command = shlex.join(["python", "-m", "benchmarks.detector_latency", *sys.argv[1:]])
    content: dict[str, Any] = {"command": command, "threads": THREADS, "views": len(scenes), "load": os.getloadavg()}
    content["proposing_ms"] = time_proposers(scenes, options.repeats)
    for name, times in content["proposing_ms"].items():
        print(line(name, times))
    try:
        content["network"] = alone = networks(scenes, options.repeats, options.weights)
    except Unavailable as missing:
        print(f"No comparison with torch: {missing} {missing.remedy}")
    else:
        print(line("deep's network alone, onnxruntime", alone["onnxruntime"]))
        print(line("deep's network alone, torch", alone["torch"]))
        ratio = float(np.median(alone["torch"]) / np.median(alone["onnxruntime"]))
        content["ratio"] = ratio
        print(f"torch takes {ratio:.2f} times as long (medians); their answers agree within {alone['apart']:.1e}")
    if options.json:
        options.json.write_text(json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    main()
