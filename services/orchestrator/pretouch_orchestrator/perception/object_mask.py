"""A client's mask is evidence of where the object is: what the depth image contradicts is left out, or refused."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from pretouch.camera import DepthImage
from pretouch.errors import InvalidInput
from pretouch.geometry import Array
from pretouch.scene import MIN_OBJECT_PIXELS
from pretouch.session_warning import SessionWarning
from pretouch_orchestrator.perception.clusters import depth_jump_threshold
from pretouch_orchestrator.perception.depth_check import describe_depth
from pretouch_orchestrator.perception.table_view import Pixels, TableView

_MAX_CLUSTERS = 20
_BELOW_TABLE = 0.01
"""m below the table, besides noise, beyond which nothing belongs to an object on it."""
_BESIDE_TABLE = 0.3
"""Weight of a part that is not over the table: an object may reach beyond its edge, but most often it is background."""
_MAX_GAP = 0.1
"""m between an object's parts that something in front of it separates, where they are not over the table."""
_MIN_RAISED, _USUAL_RAISED = 0.15, 0.3
"""Share of a mask that rises above the table: with less it marks no object that the camera sees; less is unusual."""
_INVERTED_SHARE, _INVERTED_TABLE, _INVERTED_REST = 0.5, 0.8, 0.5
"""An inverted mask covers so much of the depth and of the table, and so much of the rest rises above the table."""


class CleanMask(NamedTuple):
    """Pixels (h, w) of the object, and what is odd about the mask that they were cleaned from."""

    pixels: Pixels
    warnings: tuple[SessionWarning, ...]


def check_mask(mask: Pixels, area: Pixels, depth: DepthImage) -> Pixels:
    """The mask (h, w) within the roi's `area` (h, w).

    Raises:
        InvalidInput: a mask of another size, or without pixels with depth.
    """
    seen = depth.metres > 0
    if mask.shape != seen.shape:
        raise InvalidInput(
            f"The mask is {list(mask.shape)} pixels (h, w), the depth image {list(seen.shape)}.",
            "Send a mask of the depth image's size.",
        )
    if not mask.any():
        raise InvalidInput("The mask is empty.", "Mark the object's pixels with a value other than 0, or send no mask.")
    if not (mask & area).any():
        raise InvalidInput("The mask is empty within the roi.", "Send a roi that holds the object, or none.")
    if not (mask & area & seen).any():
        raise InvalidInput(
            f"The depth image has no data within the mask. {describe_depth(depth)}",
            "Check that the mask belongs to the depth image.",
        )
    return mask & area


def is_large(mask: Pixels, seen: Pixels) -> bool:
    """Whether a mask covers so much of what was `seen` that it may be inverted."""
    return float(mask[seen].mean()) > _INVERTED_SHARE


def refuse_inverted(view: TableView, mask: Pixels) -> None:
    """Raises `InvalidInput` if the mask covers the table, and leaves out what rises above it.

    Args:
        view: with a table that was found regardless of the mask.
    """
    rest = (view.depth > 0) & ~mask
    left_out = view.label(rest & view.raised) == 1
    if mask[view.level].mean() < _INVERTED_TABLE or left_out.sum() < max(
        MIN_OBJECT_PIXELS, _INVERTED_REST * rest.sum()
    ):
        return
    raise InvalidInput(
        f"The mask looks inverted: it covers {mask[view.depth > 0].mean():.0%} of the depth image with the table, and "
        f"leaves out {int(left_out.sum())} pixels that rise above the table.",
        "Mark the object's pixels with a value other than 0, and all others with 0.",
    )


def clean_mask(view: TableView, mask: Pixels) -> CleanMask:
    """The object's pixels in a mask: without those below the table, flying pixels, specks and background in mid-air.

    The largest part is kept, and others over the table or near it; of small ones those without a jump in depth between.

    Raises:
        InvalidInput: nothing in it rises above the table.
    """
    window = ndimage.find_objects(mask.astype(np.int8))[0]
    near, marked = view.cropped(window), mask[window] & (view.depth[window] > 0)
    low = near.heights < -3 * near.std - _BELOW_TABLE
    pixels = np.zeros_like(mask)
    pixels[window] = _select_parts(view, near, near.label(mask[window] & ~(marked & low)))
    _refuse_level(near, marked, pixels[window])
    return CleanMask(pixels, tuple(_describe(near, marked, pixels[window])))


def _select_parts(view: TableView, near: TableView, labels: NDArray[np.intp]) -> Pixels:
    """The labelled parts that belong to the object; `near` is the part of `view` with `labels`."""
    sizes = np.bincount(labels.ravel())
    if len(sizes) == 1:
        return np.zeros(labels.shape, dtype=bool)
    large = [k for k in range(1, min(len(sizes), _MAX_CLUSTERS + 1)) if sizes[k] >= MIN_OBJECT_PIXELS] or [1]
    over = large if len(large) == 1 else [k for k in large if view.is_over_table(near.points[labels == k])]
    main = max(large, key=lambda k: sizes[k] * (1.0 if k in over else _BESIDE_TABLE))
    pixels = np.isin(labels, [main, *over])
    for k in large:
        if k != main and k not in over and _measure_gaps(near, labels == k, pixels).min() <= _MAX_GAP:
            pixels |= labels == k
    small = (labels > 0) & ~np.isin(labels, large)
    pixels[small] = _measure_gaps(near, small, pixels) <= depth_jump_threshold(near.depth[small])
    return np.asarray(pixels, dtype=bool)


def _measure_gaps(view: TableView, part: Pixels, object: Pixels) -> Array:
    """(n,), m: the distance of each of the pixels of `part` (h, w) from the object, at most _MAX_GAP or else inf."""
    if not part.any():
        return np.zeros(0)
    distance, _ = cKDTree(view.points[object]).query(view.points[part], distance_upper_bound=_MAX_GAP)
    return np.asarray(distance, dtype=np.float64)


def _refuse_level(view: TableView, marked: Pixels, pixels: Pixels) -> None:
    """Raises `InvalidInput` if of the `marked` pixels (h, w) with depth hardly one of the clean ones is raised."""
    if (pixels & view.raised).sum() >= _MIN_RAISED * max(MIN_OBJECT_PIXELS, pixels.sum()):
        return
    height = float(np.median(view.heights[marked]))
    raise InvalidInput(
        f"Nothing in the mask rises above the table: in the median its {int(marked.sum())} pixels with depth are "
        f"{1000 * abs(height):.0f} mm {'below' if height < 0 else 'above'} it.",
        "Check that the mask belongs to the depth image, and the table if one was sent. If the object is transparent, "
        "black or thinner than 5 mm, the camera does not see it: the finger could run into it.",
    )


def _describe(view: TableView, marked: Pixels, pixels: Pixels) -> list[SessionWarning]:
    dropped, raised = 1 - pixels.sum() / marked.sum(), float(view.raised[pixels].mean())
    warnings = []
    if dropped > 0.2:
        warnings.append(
            SessionWarning(
                "mask-background",
                f"{dropped:.0%} of the mask's {int(marked.sum())} pixels with depth are below the table, behind it or "
                "in mid-air: they are left out.",
                "Check that mask and depth image belong together pixel by pixel, and the table if one was sent.",
            )
        )
    if raised < _USUAL_RAISED:
        warnings.append(
            SessionWarning(
                "mask-table",
                f"{1 - raised:.0%} of the mask's pixels lie on the table.",
                "Mark the object alone. If it is transparent, the camera sees the table through it, and the finger "
                "could run into it.",
            )
        )
    return warnings
