"""Tables of the errors of depth images, real and simulated."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence

import numpy as np
from pretouch_simulation.markdown import markdown_table

from experiments.camera_residuals import SCALES, Residuals
from experiments.camera_scenes import CAMERAS, View, select_camera
from pretouch.geometry import Array

_MM = 1e3
_RIDGE_AT = (1, 4, 8, 12, 18)
_EDGE_AT = (1, 3, 5, 8, 12)
"""px."""


def residual_table(views: Sequence[tuple[View, Residuals]]) -> str:
    """Mean over the objects, in mm."""
    headings = ["camera", "n", "mean: lowest to highest", "std", *_make_smoothed_headings()]
    lines = []
    for camera in CAMERAS:
        found = select_camera(views, camera)
        if not found:
            continue
        means = _MM * np.array([one.mean for one in found])
        stds = _MM * np.array([[one.std, *one.smoothed] for one in found]).mean(axis=0)
        lines.append([camera, str(len(found)), f"{means.min():.1f} to {means.max():.1f}", *_numbers(stds)])
    return markdown_table(headings, lines)


def edge_table(views: Sequence[tuple[View, Residuals]]) -> str:
    """Ridges, silhouettes and outlines."""
    headings = (
        *("camera", f"ridge, mm at {_list(_RIDGE_AT)} px", f"no depth, % at {_list(_EDGE_AT)} px"),
        *("background, % at 1, 3 px", "depth's outline, px p50, p95", "mask's outline, px p50, p95"),
    )
    lines = []
    for camera in CAMERAS:
        found = select_camera(views, camera)
        if not found:
            continue
        ridge, missing, eaten = (profile(found, name) for name in ("ridge", "missing", "eaten"))
        outlines, masks = (
            np.concatenate([getattr(one, name) for one in found]) for name in ("outlines", "mask_outlines")
        )
        lines.append(
            [
                camera,
                " / ".join(f"{_MM * ridge[at - 1]:.1f}" for at in _RIDGE_AT),
                " / ".join(f"{100 * missing[at - 1]:.0f}" for at in _EDGE_AT),
                " / ".join(f"{100 * eaten[at - 1]:.0f}" for at in (1, 3)),
                " / ".join(_numbers(np.percentile(outlines, [50, 95]))),
                " / ".join(_numbers(np.percentile(masks, [50, 95]))),
            ]
        )
    return markdown_table(headings, lines)


def plane_table(planes: Sequence[Mapping[str, Array]]) -> str:
    """Medians over the scenes, in mm."""
    headings = ["camera", "n", "std along z", *_make_smoothed_headings(), "across"]
    lines = []
    for camera in CAMERAS:
        values = _MM * np.median([plane[camera] for plane in planes], axis=0)
        lines.append([camera, str(len(planes)), *_numbers(values)])
    return markdown_table(headings, lines)


def profile(found: Sequence[Residuals], name: str) -> Array:
    """(REACH,): mean over objects of the profile `name`."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.asarray(np.nanmean([getattr(one, name) for one in found], axis=0))


def _list(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers))


def _numbers(values: Array) -> list[str]:
    return [f"{value:.1f}" for value in values]


def _make_smoothed_headings() -> list[str]:
    first, *others = (f"{scale} px" for scale in SCALES)
    return [f"smoothed: {first}", *others]
