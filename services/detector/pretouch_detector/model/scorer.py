"""The single-stage design: the error that a scan of any rectangle's perimeter would leave.

Features are read along the perimeter, where the finger would go, and nowhere else. A small network reads each point
with its neighbours; the points are pooled by mean, maximum, and the sum of outer products of a projection: what samples
tell of a pose adds up like that, J^T J, and an error is a function of the sum.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from pretouch_detector.model.backbone import Backbone
from pretouch_detector.model.encoding import CHANNELS

POINTS = 48
"""Points along a perimeter, evenly."""
OUTPUTS = ("log_error", "log_std", "log_expected", "log_foreseen")
"""Log of the mean error, m; log of the standard deviation of the error's logarithm; and logs, m, of what the registrar
expects after the scan and foretells before it: the last two only help to learn."""
_START = (-5.2, -0.7, -5.2, -5.0)
_GRAM = 12


class _Along(nn.Module):
    """Each point with two neighbours on either side, once round."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.body = nn.Sequential(
            nn.Conv1d(channels, channels, 5, padding=2, padding_mode="circular", groups=channels),
            nn.Conv1d(channels, channels, 1),
            nn.SiLU(),
        )

    def forward(self, x: Tensor) -> Tensor:
        out: Tensor = x + self.body(x)
        return out


class Scorer(nn.Module):
    """`forward(image (b, C, S, S), rectangles (b, r, 5))` -> (b, r, len(OUTPUTS)).

    Rectangles are as by `Encoding.normalised`.
    """

    def __init__(self, features: int = 48, width: int = 32, hidden: int = 64) -> None:
        super().__init__()
        self.backbone = Backbone(features, width)
        self.point = nn.Sequential(nn.Conv1d(features + len(CHANNELS) + 6, hidden, 1), nn.SiLU())
        self.along = nn.ModuleList([_Along(hidden), _Along(hidden)])
        self.project = nn.Conv1d(hidden, _GRAM, 1)
        self.whole = nn.Sequential(nn.Linear(features, hidden), nn.SiLU())
        pooled = 2 * hidden + _GRAM * (_GRAM + 1) // 2 + hidden + 3
        self.head = nn.Sequential(
            nn.Linear(pooled, 2 * hidden), nn.SiLU(), nn.Dropout(0.1), nn.Linear(2 * hidden, hidden), nn.SiLU(),
            nn.Linear(hidden, len(OUTPUTS)),
        )  # fmt: skip
        last = self.head[-1]
        assert isinstance(last, nn.Linear)
        nn.init.zeros_(last.weight)
        last.bias.data.copy_(torch.tensor(_START))
        rows, columns = torch.triu_indices(_GRAM, _GRAM)
        self.register_buffer("upper", rows * _GRAM + columns, persistent=False)
        self.upper: Tensor
        self.register_buffer("steps", (torch.arange(POINTS) + 0.5) / POINTS, persistent=False)
        self.steps: Tensor

    def forward(self, image: Tensor, rectangles: Tensor) -> Tensor:
        features = self.backbone(image)
        b, r = rectangles.shape[:2]
        points, tangent, spacing = perimeter(rectangles, self.steps)
        sampled = torch.cat([_sampled(features, points), _sampled(image, points)], dim=1)  # (b, c, r, p)
        centre = rectangles[..., None, :2]
        local = torch.cat([points - centre, tangent, points], dim=-1).permute(0, 3, 1, 2)
        x = torch.cat([sampled, local], dim=1).transpose(1, 2).reshape(b * r, -1, POINTS)
        x = self.point(x)
        for layer in self.along:
            x = layer(x)
        g = self.project(x)
        gram = (torch.bmm(g, g.transpose(1, 2)) * spacing.reshape(b * r, 1, 1)).reshape(b * r, -1)[:, self.upper]
        whole = self.whole(features.mean(dim=(2, 3)))[:, None].expand(b, r, -1).reshape(b * r, -1)
        shape = torch.log(rectangles[..., 2:4]).reshape(b * r, 2)
        size = image[:, -1, 0, 0][:, None].expand(b, r).reshape(b * r, 1)
        gram = torch.sign(gram) * torch.log1p(gram.abs())
        pooled = torch.cat([x.mean(dim=2), x.amax(dim=2), gram, whole, shape, size], dim=1)
        out: Tensor = self.head(pooled).reshape(b, r, len(OUTPUTS))
        return out


def perimeter(rectangles: Tensor, steps: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Points (..., p, 2) and unit tangents (..., p, 2) at the shares `steps` (p,) of the way; spacing (..., 1)."""
    x, y, w, h, theta = rectangles[..., None, :].unbind(-1)
    s = steps * 2.0 * (w + h)
    first, second, third = w, w + h, 2.0 * w + h
    side = (s >= first).to(s.dtype) + (s >= second).to(s.dtype) + (s >= third).to(s.dtype)
    on0, on1, on2, on3 = ((side == k).to(s.dtype) for k in range(4))
    a = on0 * (s - w / 2) + on1 * (w / 2) + on2 * (w / 2 - (s - second)) - on3 * (w / 2)
    b = -on0 * (h / 2) + on1 * (s - first - h / 2) + on2 * (h / 2) + on3 * (h / 2 - (s - third))
    cos, sin = torch.cos(theta), torch.sin(theta)
    ta, tb = on0 - on2, on1 - on3
    points = torch.stack([x + cos * a - sin * b, y + sin * a + cos * b], dim=-1)
    tangent = torch.stack([cos * ta - sin * tb, sin * ta + cos * tb], dim=-1)
    return points, tangent, (2.0 * (w + h) / steps.shape[0])


def _sampled(image: Tensor, points: Tensor) -> Tensor:
    """(b, c, r, p): bilinear values of image (b, c, s, s) at points (b, r, p, 2) in [-1, 1]; 0 outside."""
    return nn.functional.grid_sample(image, points, mode="bilinear", padding_mode="zeros", align_corners=False)
