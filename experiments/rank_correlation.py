"""Spearman's rank correlation."""

from __future__ import annotations

import numpy as np
from scipy.stats import spearmanr

from pretouch.geometry import Array


def rank_correlation(a: Array, b: Array) -> float:
    """Of the pairs that are finite; 0 if one of the two is constant there, or fewer than two pairs are left."""
    both = np.isfinite(a) & np.isfinite(b)
    if both.sum() < 2 or np.ptp(a[both]) == 0 or np.ptp(b[both]) == 0:
        return 0.0
    return float(spearmanr(a[both], b[both])[0])
