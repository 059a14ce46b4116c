"""Two engines compared by object."""

from helpers.made_runs import KEY, run_of
from pretouch_simulation.evaluation_comparison import compare_engines, comparison_table

BOX = KEY._replace(mesh="box")
RUNS = [
    run_of(KEY, 0.010, 0.004),
    run_of(KEY._replace(view=1), 0.006, 0.002),
    run_of(BOX, 0.010, 0.010),
    run_of(KEY._replace(engine="posterior"), 0.005, 0.001),
    run_of(KEY._replace(engine="posterior", view=1), 0.005, 0.001),
    run_of(BOX._replace(engine="posterior"), 0.011, 0.012),
    run_of(KEY._replace(engine="posterior", sensor="vl6180x"), 0.011, 0.012),
]


def test_only_pairs_that_are_lost_are_listed() -> None:
    pairs = compare_engines(RUNS, 2, "posterior", "point_to_plane")
    assert [(pair.mesh, pair.sensor, pair.n) for pair in pairs] == [("box", "ideal", 1), ("mug", "ideal", 2)]
    table = comparison_table(pairs, "posterior", "point_to_plane")
    assert table.startswith("`posterior` is worse than `point_to_plane` on 1 of 2 pairs")
    assert "| box | kinect | ideal | 1 | 1.20 | 1.00 | 0.20 |" in table
    assert "mug" not in table
