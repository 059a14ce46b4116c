"""The two-stage design: a Faster R-CNN (Ren et al. 2015) for rotated rectangles.

The first stage proposes rectangles from the whole image. The second looks into each, tells how likely it is among the
best of the image, how it should be changed for that, and the error that a scan of its perimeter would leave.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from pretouch_detector.model.backbone import Backbone
from pretouch_detector.model.encoding import CHANNELS
from pretouch_detector.model.roi_align import BINS, roi_align
from pretouch_detector.model.rpn import RegionProposals, begin_unmoved
from pretouch_detector.model.scorer import OUTPUTS

_START = (-5.2, -0.7, -5.2, -5.0)
_PLACE = 6


class RotatedRCNN(nn.Module):
    """All rectangles as `Encoding.normalised`, [x, y, w, h, theta].

    Its stages are called one by one, as the features serve both; `forward` is the errors of given rectangles alone.
    """

    def __init__(self, features: int = 48, width: int = 32, hidden: int = 64) -> None:
        super().__init__()
        self.backbone = Backbone(features, width)
        features += len(CHANNELS)
        self.proposals = RegionProposals(features, hidden)
        self.region = nn.Sequential(nn.Conv2d(features, hidden, 3), nn.SiLU())
        self.joined = nn.Sequential(
            nn.Linear(hidden * (BINS - 2) ** 2 + features + _PLACE, 2 * hidden),
            nn.SiLU(),
            nn.Dropout(0.1),
            nn.Linear(2 * hidden, 2 * hidden),
            nn.SiLU(),
        )
        self.score = nn.Linear(2 * hidden, 1)
        self.deltas = nn.Linear(2 * hidden, 6)
        self.errors = nn.Linear(2 * hidden, len(OUTPUTS))
        begin_unmoved(self.deltas)
        nn.init.zeros_(self.errors.weight)
        self.errors.bias.data.copy_(torch.tensor(_START))

    def features(self, image: Tensor) -> Tensor:
        """image (b, C, S, S) -> (b, f, S/4, S/4): what the backbone finds, and the image itself, made smaller."""
        return torch.cat([self.backbone(image), nn.functional.avg_pool2d(image, 4)], dim=1)

    def rpn(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Objectness (b, A), a logit, and deltas (b, A, 6) from the `anchors`."""
        objectness, deltas = self.proposals(features)
        return objectness, deltas

    def head(self, features: Tensor, rectangles: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The second stage, of rectangles (b, r, 5).

        Returns:
            Logits (b, r) of being among the image's best; deltas (b, r, 6) to the nearest of those; logs of errors
            (b, r, len(OUTPUTS)), as the scorer's.
        """
        b = features.shape[0]
        regions = self.region(roi_align(features, rectangles).flatten(0, 1)).flatten(1).unflatten(0, (b, -1))
        centre, sides, theta = rectangles[..., :2], rectangles[..., 2:4], rectangles[..., 4:]
        place = torch.cat([centre, torch.log(sides), torch.cos(theta), torch.sin(theta)], dim=-1)
        whole = features.mean(dim=(2, 3))[:, None].expand(-1, rectangles.shape[1], -1)
        x = self.joined(torch.cat([regions, whole, place], dim=-1))
        return self.score(x)[..., 0], self.deltas(x), self.errors(x)

    def forward(self, image: Tensor, rectangles: Tensor) -> Tensor:
        """image (b, C, S, S), rectangles (b, r, 5) -> (b, r, len(OUTPUTS)): as the scorer."""
        return self.head(self.features(image), rectangles)[2]
