"""The torch side of `benchmarks.detector_latency`, in a process of its own with threads of its own.

`python -m benchmarks.detector_latency_torch QUESTIONS.npz ANSWERS.npz WEIGHTS.safetensors THREADS REPEATS`
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

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
    count = sum(name.startswith("image-") for name in arrays)

    def ask(k: int) -> torch.Tensor:
        rectangles, analytic = arrays[f"rectangles-{k}"], arrays[f"analytic-{k}"]
        answer: torch.Tensor = model(arrays[f"image-{k}"], rectangles[None], analytic[None])
        return answer[0, :, :2]

    with torch.inference_mode():
        told: dict[str, Any] = {f"answer-{k}": ask(k).numpy() for k in range(count)}
        times = []
        for _ in range(int(repeats)):
            for k in range(count):
                started = time.perf_counter()
                ask(k)
                times.append(1e3 * (time.perf_counter() - started))
    np.savez(Path(answers), ms=np.array(times), **told)


if __name__ == "__main__":
    main()
