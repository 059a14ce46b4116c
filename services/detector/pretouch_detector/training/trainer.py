"""The training loop: on a processor, on one GPU, or on many by torchrun; it can be stopped and resumed.

run/checkpoint.pt    all that is needed to resume, written after each epoch
run/log.json         the terms of the loss, an entry an epoch
run/weights.safetensors   the weights' running average, which is what is exported
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.progress import track
from safetensors.torch import save_file
from torch import nn

from pretouch.errors import Conflict
from pretouch_detector.model.scorer import Scorer
from pretouch_detector.training.augment import augment
from pretouch_detector.training.batch import batch_of
from pretouch_detector.training.processes import ALONE, Processes
from pretouch_detector.training.schedule import Schedule
from pretouch_detector.training.scorer_loss import compute_loss
from pretouch_detector.training.targets import Targets


class Trainer:
    """Trains `model` and keeps its state in the folder `run`.

    Raises:
        Conflict: the folder holds a run with another schedule.
    """

    def __init__(
        self,
        model: Scorer,
        schedule: Schedule,
        run: Path,
        device: torch.device,
        among: Processes = ALONE,
    ) -> None:
        self.model, self.schedule, self.run, self.device = model.to(device), schedule, run, device
        self.among = among
        self.averaged = torch.optim.swa_utils.AveragedModel(
            self.model, multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(schedule.average), use_buffers=True
        )
        self.optimiser = torch.optim.AdamW(model.parameters(), lr=schedule.rate, weight_decay=schedule.decay)
        self.log: list[dict[str, float]] = []
        run.mkdir(parents=True, exist_ok=True)
        self._resume()

    def train(self, views: Sequence[Targets], validation: Sequence[Targets]) -> None:
        """Runs the remaining epochs; each ends with a checkpoint."""
        steps = max(1, len(views) // (self.schedule.batch * self.among.world))
        for epoch in range(len(self.log), self.schedule.epochs):
            entry = self._train_epoch(views, epoch, steps)
            entry |= {f"validation {name}": value for name, value in self.evaluate(validation).items()}
            self.log.append(entry)
            if self.among.rank == 0:
                self._save()

    @torch.no_grad()
    def evaluate(self, views: Sequence[Targets]) -> dict[str, float]:
        """The terms of the loss on views without augmentation, by the averaged weights."""
        self.averaged.eval()
        rng = np.random.default_rng(0)
        size = self.schedule.batch
        terms = [
            compute_loss(
                self.averaged.module, batch_of(views[k : k + size], self.schedule.rectangles, rng, self.device)
            )
            for k in range(0, len(views), size)
        ]
        return {name: float(np.mean([float(each[name]) for each in terms])) for name in terms[0]}

    def _train_epoch(self, views: Sequence[Targets], epoch: int, steps: int) -> dict[str, float]:
        self.model.train()
        size = self.schedule.batch
        order = np.random.default_rng((self.schedule.seed, epoch)).permutation(len(views))
        rng = np.random.default_rng((self.schedule.seed, epoch, self.among.rank))
        torch.manual_seed(int(rng.integers(2**31)))
        sums: dict[str, float] = {}
        console = Console(stderr=True)
        title = f"epoch {epoch + 1} of {self.schedule.epochs}"
        for step in track(range(steps), title, console=console, disable=self.among.rank > 0, transient=True):
            first = (step * self.among.world + self.among.rank) * size
            chosen = [augment(views[k], rng) for k in order[first : first + size]]
            self._set_rate((epoch * steps + step) / (self.schedule.epochs * steps))
            terms = compute_loss(self.model, batch_of(chosen, self.schedule.rectangles, rng, self.device))
            self.optimiser.zero_grad(set_to_none=True)
            torch.stack(list(terms.values())).sum().backward()
            self.among.share_gradients(self.model)
            nn.utils.clip_grad_norm_(self.model.parameters(), 2.0)
            self.optimiser.step()
            self.averaged.update_parameters(self.model)
            for name, value in terms.items():
                sums[name] = sums.get(name, 0.0) + float(value.detach()) / steps
        return sums

    def _set_rate(self, share: float) -> None:
        warm = min(1.0, share / 0.05 + 0.01)
        for group in self.optimiser.param_groups:
            group["lr"] = self.schedule.rate * warm * (0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * share)))

    def _save(self) -> None:
        state = {
            "schedule": asdict(self.schedule),
            "model": self.model.state_dict(),
            "averaged": self.averaged.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "log": self.log,
        }
        draft = self.run / "checkpoint.pt.new"
        torch.save(state, draft)
        draft.replace(self.run / "checkpoint.pt")
        (self.run / "log.json").write_text(json.dumps(self.log, indent=1) + "\n")
        weights = {name: value.contiguous().cpu() for name, value in self.averaged.module.state_dict().items()}
        save_file(weights, self.run / "weights.safetensors")

    def _resume(self) -> None:
        path = self.run / "checkpoint.pt"
        if not path.exists():
            return
        state = torch.load(path, map_location=self.device, weights_only=True)
        if state["schedule"] != asdict(self.schedule):
            raise Conflict(
                f"{self.run} holds a run with another schedule.", "Choose another folder, or the same settings."
            )
        self.model.load_state_dict(state["model"])
        self.averaged.load_state_dict(state["averaged"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.log = state["log"]
