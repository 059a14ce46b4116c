"""`experiments.pieces` groups what was predicted by the share of the samples that returned."""

import numpy as np
import pytest

from experiments.pieces import LIFTS, Piece, draw_piece, format_table
from pretouch.trajectory import Trajectory


def test_a_line_of_the_table_is_a_group_of_one_stage() -> None:
    pieces = [
        Piece("mug", 0, 0.2, 0.0, 0.02, 0.018, 0.02, 0.021),
        Piece("box", 0, 0.4, 0.05, 0.02, 0.016, 0.018, 0.019),
        Piece("box", 1, 1.0, 1.0, 0.01, 0.005, 0.006, 0.004),
    ]
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in format_table(pieces).strip().splitlines()]
    assert cells[2:] == [
        ["0", "0% to 10%", "2", "2%", "30%", "2.00", "1.70", "1.90", "2.00"],
        ["1", "90% to 100%", "1", "100%", "100%", "1.00", "0.50", "0.60", "0.40"],
    ]


@pytest.mark.parametrize("seed", range(20))
def test_a_piece_is_part_of_a_path_raised_along_the_beam(seed: int) -> None:
    poses = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (2, 1, 1))
    poses[:, 0, 3], poses[:, 2, 3] = (0.0, 0.2), 0.05
    path = Trajectory(np.array([0.0, 4.0]), poses)
    piece = draw_piece([path], np.random.default_rng(seed))
    assert 0.0 <= piece.t[0] < piece.t[-1] <= 4.0
    (lift,) = set(np.round(piece.base_T_tip[:, 2, 3] - 0.05, 9))
    assert lift in LIFTS
    np.testing.assert_allclose(piece.base_T_tip[:, 0, 3], 0.05 * piece.t)
