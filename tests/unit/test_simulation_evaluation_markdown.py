"""The report's tables: engines side by side, and where one loses against another."""

from pretouch_simulation.evaluation_markdown import compared, comparison_table, engine_table
from pretouch_simulation.evaluation_rows import Detail, Row, Run


def run_of(mesh: str, view: int, engine: str, sensor: str, *errors: float) -> Run:
    rows = [
        Row(mesh, view, k, "random", engine, "information", sensor, 0.02, error, 0.005, True, 0.1, 5.0, 40.0)
        for k, error in enumerate(errors, start=1)
    ]
    detail = Detail((0.0,) * 6, (1.0,) * 6, 6.0, 0.01, "", 100, 50)
    return Run(mesh, view, engine, sensor, 0.02, tuple(rows), (detail,) * len(rows))


RUNS = [
    run_of("mug", 0, "point_to_plane", "ideal", 0.010, 0.004),
    run_of("mug", 1, "point_to_plane", "ideal", 0.006, 0.002),
    run_of("box", 0, "point_to_plane", "ideal", 0.010, 0.010),
    run_of("mug", 0, "posterior", "ideal", 0.005, 0.001),
    run_of("mug", 1, "posterior", "ideal", 0.005, 0.001),
    run_of("box", 0, "posterior", "ideal", 0.011, 0.012),
    run_of("mug", 0, "posterior", "vl6180x", 0.011, 0.012),
]


def test_engines_stand_under_each_other_by_sensor_and_scans() -> None:
    lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in engine_table(RUNS, (0, 2)).splitlines()]
    assert len({len(line) for line in lines}) == 1
    assert [line[:5] for line in lines[2:]] == [
        ["ideal", "", "0", "3", "2.00"],
        ["ideal", "point_to_plane", "2", "3", "0.53"],
        ["ideal", "posterior", "2", "3", "0.47"],
        ["vl6180x", "", "0", "1", "2.00"],
        ["vl6180x", "posterior", "2", "1", "1.20"],
    ]


def test_only_pairs_that_are_lost_are_listed() -> None:
    pairs = compared(RUNS, 2, "posterior", "point_to_plane")
    assert [(pair.mesh, pair.sensor, pair.n) for pair in pairs] == [("box", "ideal", 1), ("mug", "ideal", 2)]
    table = comparison_table(pairs, "posterior", "point_to_plane")
    assert table.startswith("`posterior` is worse than `point_to_plane` on 1 of 2 pairs")
    assert "| box | ideal | 1 | 1.20 | 1.00 | 0.20 |" in table
    assert "mug" not in table
