"""Hand-eye calibration from two recordings of poses: base_T_hand X camera_T_target = base_T_target, both unknown.

The clocks of both recordings may differ by a constant, which the rates of rotation give away.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation, Slerp

from pretouch.errors import InvalidInput, NotFound
from pretouch.geometry import Array, Pose

_RATE = 50.0
_LONGEST_OFFSET = 5.0
_MAX_GAP = 0.2
_SMOOTH = 0.2
_ARM = 0.3
"""m: a residual rotation counts as the shift of a point so far away."""
_OUTLIER = 0.01
"""m: residuals well above this lose their weight (soft L1)."""


@dataclass(frozen=True, eq=False)
class Track:
    """Attributes: times (n,) in s, rotations, and positions (n, 3) in m."""

    times: Array
    rotations: Rotation
    positions: Array

    def at(self, times: Array) -> Track:
        """Slerp and straight lines between the poses."""
        places = np.stack([np.interp(times, self.times, axis) for axis in self.positions.T], axis=1)
        return Track(times, Slerp(self.times, self.rotations)(times), places)

    def part(self, chosen: NDArray[np.intp]) -> Track:
        return Track(self.times[chosen], self.rotations[chosen], self.positions[chosen])

    def inverse(self) -> Track:
        """The inverse poses."""
        turns = self.rotations.inv()
        return Track(self.times, turns, -turns.apply(self.positions))

    def pose(self, k: int) -> Pose:
        return Pose.of(self.rotations[k].as_matrix(), self.positions[k])


def read_track(path: Path) -> Track:
    """Lines of time, x, y, z, qx, qy, qz, qw; repeated times are left out.

    Raises:
        NotFound: there is no such file.
        InvalidInput: it does not hold such lines.
    """
    if not path.is_file():
        raise NotFound(f"There is no {path}.", "Give the path of a recording of poses.")
    try:
        rows = np.loadtxt(path, delimiter=",", ndmin=2)
    except ValueError as error:
        raise InvalidInput(
            f"{path} holds no numbers: {error}.", "Write time, x, y, z, qx, qy, qz, qw a line."
        ) from error
    if rows.shape[1] != 8 or len(rows) < 10 or not np.isfinite(rows).all():
        raise InvalidInput(
            f"{path} has {rows.shape} numbers.", "Need 10 or more lines of time, x, y, z, qx, qy, qz, qw."
        )
    rows = rows[np.unique(rows[:, 0], return_index=True)[1]]
    return Track(rows[:, 0], Rotation.from_quat(rows[:, 4:]), rows[:, 1:4])


def time_offset(hand: Track, camera: Track) -> float:
    """s to add to the camera's times: where the rates of rotation of both correlate best."""
    of_hand, of_camera = _rates(hand), _rates(camera)
    start, end = max(hand.times[0], camera.times[0]), min(hand.times[-1], camera.times[-1])
    grid = np.arange(start + _LONGEST_OFFSET, end - _LONGEST_OFFSET, 1 / _RATE)
    if len(grid) < _RATE:
        raise InvalidInput("The recordings overlap by less than 11 s.", "Give recordings of the same motion.")
    offsets = np.arange(-_LONGEST_OFFSET, _LONGEST_OFFSET, 1 / _RATE)
    scores = np.array([np.corrcoef(of_hand(grid + offset), of_camera(grid))[0, 1] for offset in offsets])
    k = int(np.clip(scores.argmax(), 1, len(scores) - 2))
    before, best, after = scores[k - 1 : k + 2]
    return float(offsets[k] + 0.5 * (before - after) / (before - 2 * best + after) / _RATE)


def _rates(track: Track) -> Callable[[Array], Array]:
    """The rate of rotation, rad/s, as a function of times (n,)."""
    times = np.arange(track.times[0] + _SMOOTH / 2, track.times[-1] - _SMOOTH / 2, 1 / _RATE)
    first, second = track.at(times - _SMOOTH / 2), track.at(times + _SMOOTH / 2)
    rates = (first.rotations.inv() * second.rotations).magnitude() / _SMOOTH
    return lambda at: np.interp(at, times, rates)


def pair(hand: Track, camera: Track) -> tuple[Track, Track, float]:
    """Both at the camera's times, corrected by their offset, where the hand's recording has no gap; the offset, s."""
    offset = time_offset(hand, camera)
    times = camera.times + offset
    after = np.clip(np.searchsorted(hand.times, times), 1, len(hand.times) - 1)
    inside = (times > hand.times[0]) & (times < hand.times[-1])
    inside &= hand.times[after] - hand.times[after - 1] < _MAX_GAP
    chosen = camera.part(inside)
    return hand.at(times[inside]), chosen, offset


def spread(count: int, most: int) -> NDArray[np.int64]:
    """At most `most` of `count` numbers, evenly."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.int64))


def solve(hand: Track, camera: Track) -> tuple[Pose, Pose]:
    """(hand_T_camera, base_T_target), from pairs: rotations' axes first, then all residuals, robustly."""
    turns_hand, turns_camera = (_relative(turns) for turns in (hand.rotations, camera.rotations.inv()))
    first = Rotation.align_vectors(turns_hand, turns_camera)[0]
    places = first.apply(camera.positions)
    # R_i (R_X t_c + t_X) + t_i = t_Y, linear in t_X and t_Y
    rows = np.concatenate([hand.rotations.as_matrix(), np.tile(-np.eye(3), (len(places), 1, 1))], axis=2).reshape(-1, 6)
    right = -(hand.rotations.apply(places) + hand.positions).ravel()
    shifts = np.linalg.lstsq(rows, right, rcond=None)[0]
    target = (hand.rotations * first * camera.rotations).mean()
    start = np.concatenate([first.as_rotvec(), shifts[:3], target.as_rotvec(), shifts[3:]])
    found = least_squares(_residuals, start, args=(hand, camera), loss="soft_l1", f_scale=_OUTLIER).x
    return Pose.from_rotation_vector(found[:3], found[3:6]), Pose.from_rotation_vector(found[6:9], found[9:])


def _relative(rotations: Rotation) -> Array:
    """Rotation vectors between poses that are a quarter of the recording apart."""
    apart = max(1, len(rotations) // 4)
    return np.asarray((rotations[:-apart].inv() * rotations[apart:]).as_rotvec(), dtype=np.float64)


def _residuals(x: Array, hand: Track, camera: Track) -> Array:
    turn, target = Rotation.from_rotvec(x[:3]), Rotation.from_rotvec(x[6:9])
    turned = (target.inv() * hand.rotations * turn * camera.rotations).as_rotvec()
    shifted = hand.rotations.apply(turn.apply(camera.positions) + x[3:6]) + hand.positions - x[9:]
    return np.concatenate([_ARM * turned, shifted], axis=1).ravel()
