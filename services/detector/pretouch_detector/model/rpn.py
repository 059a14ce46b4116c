"""The region proposal network: for each rotated anchor whether a good rectangle is near, and where."""

from __future__ import annotations

from torch import Tensor, nn

from pretouch_detector.model.anchors import SHAPES

_RARE = -3.0
"""Logit of an anchor's objectness to begin with: one in twenty is near a good rectangle."""


class RegionProposals(nn.Module):
    """features (b, f, 2 CELLS, 2 CELLS) -> objectness (b, A), a logit, and deltas (b, A, 6), as `anchors` has them."""

    def __init__(self, features: int, hidden: int = 64) -> None:
        super().__init__()
        self.body = nn.Sequential(
            nn.Conv2d(features, hidden, 4, 2, 1), nn.SiLU(), nn.Conv2d(hidden, hidden, 3, 1, 1), nn.SiLU()
        )
        self.objectness = nn.Conv2d(hidden, SHAPES, 1)
        self.deltas = nn.Conv2d(hidden, SHAPES * 6, 1)
        nn.init.normal_(self.objectness.weight, std=0.01)
        assert self.objectness.bias is not None
        nn.init.constant_(self.objectness.bias, _RARE)
        begin_unmoved(self.deltas)

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        x = self.body(features)
        b = x.shape[0]
        objectness = self.objectness(x).permute(0, 2, 3, 1).reshape(b, -1)
        return objectness, self.deltas(x).permute(0, 2, 3, 1).reshape(b, -1, 6)


def begin_unmoved(layer: nn.Conv2d | nn.Linear) -> None:
    """Sets a layer of deltas to leave every rectangle nearly as it is: a turn's cosine is 1, all else 0."""
    nn.init.normal_(layer.weight, std=0.001)
    assert layer.bias is not None
    nn.init.zeros_(layer.bias)
    layer.bias.data[4::6] = 1.0
