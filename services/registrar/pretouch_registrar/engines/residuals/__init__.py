"""The kinds of residual, a file each: a return's point, a thin beam's miss, and the range of a wide beam."""
