"""The tables of an evaluation: errors, and whether the covariances were honest."""

from dataclasses import replace
from io import StringIO

import pytest
from helpers.made_runs import KEY, ended, run_of
from pretouch_simulation.evaluation_rows import Run
from pretouch_simulation.evaluation_table import (
    Table,
    convergence_by_scan_table,
    convergence_table,
    honesty_table,
    tabulate_by_object,
    tabulate_by_scan,
)
from rich.console import Console

RUNS = [
    run_of(KEY, 0.012, 0.004, 0.002),
    run_of(KEY._replace(view=1), 0.006),
    run_of(KEY._replace(mesh="box")),
]
FRAME = KEY._replace(camera="real", frame="0001")


def cells(table: Table, line: int) -> dict[str, str]:
    """The first cell under each heading of a line."""
    return dict(reversed(list(zip(table.headings, table.lines[line], strict=True))))


def test_the_table_by_scan_counts_all_runs() -> None:
    table = tabulate_by_scan(RUNS, (0, 1, 3))
    assert table.headings[:4] == ("scan", "n", "made", "mean cm")
    before, first, third = table.lines
    assert before[:8] == ("0", "3", "0", "2.00", "2.00", "0.00", "2.00", "100%")
    assert set(before[8:]) == {""}
    assert first == (
        *("1", "3", "2", "1.27", "1.20", "0.57", "1.92", "67%"),
        *("0%", "0.40", "10.0%", "8.0", "50", "50"),
    )
    assert third[:5] == ("3", "3", "1", "0.93", "0.60")


def test_engines_stand_under_each_other_by_camera_sensor_and_scan() -> None:
    worlds = [
        {"engine": "point_to_plane"},
        {"engine": "paper"},
        {"engine": "point_to_plane", "sensor": "vl6180x"},
        {"camera": "window"},
    ]
    runs = [run_of(KEY._replace(**world), 0.01) for world in worlds]
    broken = Run(**KEY._replace(engine="paper", view=1)._asdict(), initial_error=None, problem="broken")
    table = tabulate_by_scan([*runs, broken], (0, 1))
    assert table.headings[:4] == ("camera", "sensor", "engine", "scan")
    assert [line[:5] for line in table.lines] == [
        ("kinect", "ideal", "point_to_plane", "0", "1"),
        ("kinect", "ideal", "point_to_plane", "1", "1"),
        ("kinect", "ideal", "paper", "1", "1"),
        ("kinect", "vl6180x", "point_to_plane", "0", "1"),
        ("kinect", "vl6180x", "point_to_plane", "1", "1"),
        ("window", "ideal", "point_to_plane", "0", "1"),
        ("window", "ideal", "point_to_plane", "1", "1"),
    ]


def test_the_table_by_object_has_a_line_for_each() -> None:
    box, mug = tabulate_by_object(RUNS, 3).lines
    assert box[:4] == ("box", "1", "2.00", "2.00")
    assert mug[:6] == ("mug", "2", "2.00", "0.90", "0.40", "0.40")


def test_real_frames_have_their_fitted_error_told() -> None:
    runs = [
        ended(run_of(FRAME, 0.006), "exhausted", 0.004),
        ended(run_of(FRAME._replace(view=1), 0.006), "exhausted", 0.003),
    ]
    assert cells(tabulate_by_scan(runs, (0, 1)), 1)["fitted"] == "0.35"
    assert cells(tabulate_by_object(runs, 1), 0)["fitted"] == "0.35"
    assert "fitted" not in tabulate_by_scan(RUNS, (1,)).headings


def test_honesty_counts_the_truths_in_each_region_of_all_and_of_the_hardest_quarter() -> None:
    distances2 = (5.0, 5.4, 8.6, 12.6, 1.0, 1.0, 1.0, 1.0)
    errors = (0.03, 0.02, 0.001, 0.001, 0.001, 0.001, 0.001, 0.001)
    runs = [
        run_of(KEY._replace(view=view), error, distances2=(d2,))
        for view, (error, d2) in enumerate(zip(errors, distances2, strict=True))
    ]
    table = honesty_table([*runs, run_of(KEY._replace(view=8))], (0, 1))
    ((scan, n, *shares, stated, true, wrong),) = table.lines
    assert (scan, n) == ("1", "8")
    assert shares == ["62%", "75%", "88%", "50%", "100%", "100%"]
    assert (stated, true, wrong) == ("0.40", "0.70", "25%")


def test_a_doubtful_estimate_is_not_called_sure() -> None:
    run = run_of(KEY, 0.03)
    doubtful = replace(run, rows=tuple(replace(row, expected_error=0.006) for row in run.rows))
    assert cells(honesty_table([run], (1,)), 0)["sure, wrong"] == "100%"
    assert cells(honesty_table([doubtful], (1,)), 0)["sure, wrong"] == "0%"


def test_convergence_tells_how_many_how_rightly_and_how_fast() -> None:
    right, wrong, late = (
        ended(run_of(KEY._replace(view=view), *errors), "converged")
        for view, errors in enumerate([(0.002,), (0.01, 0.004), (0.01, 0.01, 0.003)])
    )
    never = ended(run_of(KEY._replace(view=3), 0.001), "exhausted")
    runs = [right, wrong, late, never, run_of(KEY._replace(view=4))]
    (line,) = convergence_table(runs, 0.003).lines
    assert line == ("5", "60%", "67%", "16.0", "22.4", "19.0", "26.6", "50%")
    by_scan = convergence_by_scan_table(runs, 0.003)
    assert by_scan.headings == ("n", "1", "2", "3")
    assert by_scan.lines == (("5", "20%", "40%", "60%"),)


def test_a_setup_of_fewer_scans_keeps_its_share_of_converged_sessions() -> None:
    short = ended(run_of(KEY, 0.002), "converged")
    long = ended(run_of(KEY._replace(sensor="cone"), 0.01, 0.002), "converged")
    assert convergence_by_scan_table([short, long], 0.003).lines == (
        ("ideal", "1", "100%", "100%"),
        ("cone", "1", "0%", "100%"),
    )


def test_points_have_no_share_of_returns() -> None:
    run = run_of(KEY, 0.01)
    points = replace(run, rows=(replace(run.rows[0], returns=None),))
    assert convergence_table([points], 0.003).lines[0][-1] == ""


def test_on_real_frames_the_fitted_error_and_two_millimetres_count() -> None:
    runs = [
        ended(run_of(FRAME._replace(view=k), 0.006), "converged", fitted) for k, fitted in enumerate((0.0049, 0.0051))
    ]
    assert cells(convergence_table(runs, 0.003), 0)["of those within 3 mm + 2 mm, fitted"] == "50%"


def test_where_nothing_converged_nothing_is_said_of_it() -> None:
    (line,) = convergence_table([ended(run_of(KEY, 0.001), "exhausted")], 0.003).lines
    assert line == ("1", "0%", "", "", "", "", "", "50%")


def test_a_terminal_and_markdown_hold_the_same_cells() -> None:
    table = tabulate_by_scan(RUNS, (1,))
    screen = StringIO()
    Console(file=screen, width=200).print(*table.rich(200))
    shown = screen.getvalue().splitlines()[-2]
    assert [cell.strip() for cell in shown.strip("│").split("│")] == list(table.lines[0])
    assert [cell.strip() for cell in table.to_markdown().splitlines()[-1].strip("|").split("|")] == list(table.lines[0])


@pytest.mark.parametrize("width", [40, 60, 80])
def test_a_narrow_terminal_gets_parts_of_which_none_is_cut(width: int) -> None:
    for table in (tabulate_by_scan(RUNS, (0, 1)), tabulate_by_object(RUNS, 1), honesty_table(RUNS, (1,))):
        screen = StringIO()
        parts = table.rich(width)
        for part in parts:
            Console(file=screen, width=width).print(part)
        text = screen.getvalue()
        assert len(parts) > 1
        assert "…" not in text
        assert max(map(len, text.splitlines())) <= width
        for k, heading in enumerate(table.headings):
            assert text.count(f" {heading} ") >= (len(parts) if k < table.keys else 1)
