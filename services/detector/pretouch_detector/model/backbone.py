"""The scorer's image part: an encoder with skip connections, features at a quarter of the image's size."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from pretouch_detector.model.encoding import CHANNELS


class Block(nn.Module):
    """Two convolutions beside a shortcut; `stride` 2 halves the size."""

    def __init__(self, before: int, after: int, stride: int = 1) -> None:
        super().__init__()
        self.body = nn.Sequential(
            nn.Conv2d(before, after, 3, stride, 1, bias=False),
            nn.BatchNorm2d(after),
            nn.SiLU(),
            nn.Conv2d(after, after, 3, 1, 1, bias=False),
            nn.BatchNorm2d(after),
        )
        self.shortcut = nn.Identity() if before == after and stride == 1 else nn.Conv2d(before, after, 1, stride)
        self.act = nn.SiLU()

    def forward(self, x: Tensor) -> Tensor:
        out: Tensor = self.act(self.body(x) + self.shortcut(x))
        return out


class Backbone(nn.Module):
    """(b, C, S, S) -> (b, features, S/4, S/4).

    Args:
        width: channels at a quarter of the size; twice as many at an eighth and a sixteenth.

    It trains in half precision, which is as accurate and faster, and infers in single precision.
    """

    def __init__(self, features: int = 48, width: int = 32) -> None:
        super().__init__()
        self.features = features
        self.stem = nn.Sequential(
            nn.Conv2d(len(CHANNELS), width // 2, 3, 2, 1, bias=False), nn.BatchNorm2d(width // 2), nn.SiLU()
        )
        self.quarter = nn.Sequential(Block(width // 2, width, 2), Block(width, width))
        self.eighth = nn.Sequential(Block(width, 2 * width, 2), Block(2 * width, 2 * width))
        self.sixteenth = nn.Sequential(Block(2 * width, 2 * width, 2), Block(2 * width, 2 * width))
        self.sides = nn.ModuleList([nn.Conv2d(n, features, 1) for n in (width, 2 * width, 2 * width)])
        self.joined = Block(features, features)

    def forward(self, image: Tensor) -> Tensor:
        with torch.autocast(image.device.type, torch.bfloat16, enabled=self.training):
            out = self._extract_features(image)
        return out.float()

    def _extract_features(self, image: Tensor) -> Tensor:
        a = self.quarter(self.stem(image))
        b = self.eighth(a)
        c = self.sixteenth(b)
        up = nn.functional.interpolate(self.sides[2](c), scale_factor=2.0, mode="bilinear", align_corners=False)
        up = nn.functional.interpolate(up + self.sides[1](b), scale_factor=2.0, mode="bilinear", align_corners=False)
        out: Tensor = self.joined(up + self.sides[0](a))
        return out
