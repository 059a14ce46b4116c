"""The torch side of `benchmarks.detector_latency`, in a process of its own since torch and open3d share none.

`python -m benchmarks.detector_latency_torch QUESTIONS.npz ANSWERS.npz WEIGHTS.safetensors THREADS REPEATS`
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import torch
from pretouch_detector.model.scorer import Scorer
from safetensors.torch import load_file


def main() -> None:
    questions, answers, weights, threads, repeats = sys.argv[1:]
    torch.set_num_threads(int(threads))
    model = Scorer()
    model.load_state_dict(load_file(weights))
    model.eval()
    with np.load(questions) as file:
        arrays = {name: torch.from_numpy(file[name]) for name in file.files}
    names = [name.removeprefix("image-") for name in arrays if name.startswith("image-")]
    asked: dict[str, list[str]] = {}
    for name in names:
        asked.setdefault(name.partition("-")[0], []).append(name)

    def ask(name: str) -> torch.Tensor:
        answer: torch.Tensor = model(arrays[f"image-{name}"], arrays[f"rectangles-{name}"][None])
        return answer[0, :, :2]

    with torch.inference_mode():
        told = {name: ask(name).numpy() for name in names}
        times = []
        for _ in range(int(repeats)):
            for question in asked.values():
                started = time.perf_counter()
                for name in question:
                    ask(name)
                times.append(1e3 * (time.perf_counter() - started))
    np.savez(Path(answers), ms=np.array(times), **told)


if __name__ == "__main__":
    main()
