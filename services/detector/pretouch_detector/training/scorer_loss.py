"""What the single-stage design is taught by."""

from __future__ import annotations

from torch import Tensor

from pretouch_detector.model.scorer import Scorer
from pretouch_detector.training.batch import Batch
from pretouch_detector.training.error_terms import error_terms


def scorer_loss(model: Scorer, batch: Batch) -> dict[str, Tensor]:
    """The terms of the loss, by name."""
    return error_terms(model(batch.image, batch.rectangles, batch.analytic), batch.errors)
