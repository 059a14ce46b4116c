"""The network: the error that a scan of any rectangle's perimeter would leave.

The network corrects the `analytic` error that proposer `stability` computes. Features are sampled along the perimeter
only, where the finger would go. From each point and its neighbours, a small network infers along which directions, and
how precisely, a beam there constrains the surface that it hits. The beams' information about the pose adds up as J^T J
(Gelfand et al., "Geometrically Stable Sampling for the ICP Algorithm", 2003). From the posterior variances,
features of the perimeter and features of the whole image a last network predicts the correction.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from pretouch_detector.model.backbone import Backbone
from pretouch_detector.model.encoding import CHANNELS, LENGTH
from pretouch_detector.model.information import locate_object, predict_variances

POINTS = 48
"""Points along a perimeter, evenly."""
OUTPUTS = ("log_error", "log_std", "log_expected", "log_predicted")
"""Log of the mean error, m; log of the standard deviation of the error's logarithm; and logs, m, of what the registrar
expects after the scan and predicts before it; the last two are auxiliary training targets."""
_DIRECTIONS = 2
"""Directions along which a beam constrains the place that it hits."""
_USUAL = 0.007
"""m: a typical error, which normalises inputs."""
_SHARP = 4.0
"""1 / LENGTH: the weight of a direction for which the network answers 1."""


class _Along(nn.Module):
    """Each point with two neighbours on either side, once round: (b, c, r, p) to the same."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.body = nn.Sequential(
            nn.Conv2d(channels, channels, (1, 5), padding=(0, 2), padding_mode="circular", groups=channels),
            nn.Conv2d(channels, channels, 1),
            nn.SiLU(),
        )

    def forward(self, x: Tensor) -> Tensor:
        out: Tensor = x + self.body(x)
        return out


class Scorer(nn.Module):
    """`forward(image (b, C, S, S), rectangles (b, r, 5), analytic (b, r))` -> (b, r, len(OUTPUTS)).

    Rectangles are as by `Encoding.normalise`, analytic errors in m.
    """

    def __init__(self, features: int = 48, width: int = 32, hidden: int = 64) -> None:
        super().__init__()
        self.backbone = Backbone(features, width)
        self.point = nn.Sequential(nn.Conv2d(features + len(CHANNELS) + 6, hidden, 1), nn.SiLU())
        self.along = nn.ModuleList([_Along(hidden), _Along(hidden)])
        self.directions = nn.Conv2d(hidden, 3 * _DIRECTIONS, 1)
        self.whole = nn.Sequential(nn.Linear(features, hidden), nn.SiLU())
        self.head = nn.Sequential(
            nn.Linear(3 * hidden + 8 + 3, 2 * hidden), nn.SiLU(), nn.Dropout(0.1),
            nn.Linear(2 * hidden, hidden), nn.SiLU(), nn.Linear(hidden, len(OUTPUTS)),
        )  # fmt: skip
        last = self.head[-1]
        assert isinstance(last, nn.Linear)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        self.register_buffer("steps", (torch.arange(POINTS) + 0.5) / POINTS, persistent=False)
        self.steps: Tensor
        self.register_buffer("of_error", torch.tensor([1.0, 0.0, 1.0, 1.0]), persistent=False)
        self.of_error: Tensor

    def forward(self, image: Tensor, rectangles: Tensor, analytic: Tensor) -> Tensor:
        features = self.backbone(image)
        b, r = rectangles.shape[:2]
        points, tangent = sample_perimeters(rectangles, self.steps)
        seen = _sample(image, points)  # (b, c, r, p)
        local = torch.cat([points - rectangles[..., None, :2], tangent, points], dim=-1).permute(0, 3, 1, 2)
        x = self.point(torch.cat([_sample(features, points), seen, local], dim=1))  # (b, hidden, r, p)
        for layer in self.along:
            x = layer(x)
        directions = _SHARP * self.directions(x).reshape(b, _DIRECTIONS, 3, r, POINTS).permute(0, 3, 1, 4, 2)
        middle, radius = locate_object(image)
        arms = seen[:, :3].permute(0, 2, 3, 1) - middle[:, None, None]
        left = predict_variances(arms[:, :, None], directions)  # (b, r, 6)
        turned, moved = left[..., :3].sum(dim=-1), left[..., 3:].sum(dim=-1)
        by_information = 0.5 * torch.log(moved + radius[:, None] ** 2 * 2.0 / 3.0 * turned) + math.log(LENGTH)
        logs = torch.stack([by_information, torch.log(analytic)], dim=-1)
        whole = self.whole(features.mean(dim=(2, 3)))[:, None].expand(b, r, -1)
        size = image[:, -1, 0, 0][:, None, None].expand(b, r, 1)
        context = [torch.log(left), logs - math.log(_USUAL), torch.log(rectangles[..., 2:4]), size, whole]
        pooled = torch.cat([x.mean(dim=3).transpose(1, 2), x.amax(dim=3).transpose(1, 2), *context], dim=2)
        out: Tensor = self.head(pooled) + logs[..., 1:] * self.of_error
        return out


def sample_perimeters(rectangles: Tensor, steps: Tensor) -> tuple[Tensor, Tensor]:
    """Points and unit tangents (..., p, 2) at the shares `steps` (p,) of the way round rectangles (..., 5)."""
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
    return points, tangent


def _sample(image: Tensor, points: Tensor) -> Tensor:
    """(b, c, r, p): bilinear values of image (b, c, s, s) at points (b, r, p, 2) in [-1, 1]; 0 outside."""
    return nn.functional.grid_sample(image, points, mode="bilinear", padding_mode="zeros", align_corners=False)
