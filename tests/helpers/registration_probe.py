"""Registers one made-up session and prints all that the estimate says, bit by bit: for tests of other processes."""

import sys

import numpy as np
from pretouch_registrar.registration import Registrar, Settings

from helpers.scenes import KINECT, Box, World
from pretouch.estimate import Estimate
from pretouch.geometry import Pose
from pretouch.scene import Scene
from pretouch.tof import Scan, Sensor
from pretouch.trajectory import Trajectory

WORLD = World((Box.standing((0.10, 0.06, 0.05), (0.0, 0.0), 0.4),))
TRUTH = Pose.from_rotation_vector((0.02, -0.01, 0.05), (0.008, -0.006, 0.01))


def session(half_angle: float) -> tuple[Scene, list[Scan], Settings]:
    """A box, three scans of it under a hidden offset, and what the registrar is told of the sensor."""
    scene = WORLD.scene(KINECT, np.random.default_rng(5)).cropped(0.1)[0]
    sensor, rng = Sensor(beam_half_angle=half_angle), np.random.default_rng(0)
    world = WORLD.moved(TRUTH)
    ends = (((-0.08, -0.01), (0.08, 0.01)), ((0.01, -0.08), (-0.01, 0.08)), ((-0.07, 0.05), (0.07, -0.04)))
    return scene, [world.scanned(line(*pair), sensor, rng).beams(sensor) for pair in ends], Settings(sensor=sensor)


def line(start: tuple[float, float], end: tuple[float, float]) -> Trajectory:
    tip = np.tile(np.eye(4), (2, 1, 1))
    tip[:, :3, :3] = np.diag([1.0, -1.0, -1.0])
    tip[:, :2, 3] = start, end
    tip[:, 2, 3] = 0.085
    return Trajectory(np.array([0.0, np.linalg.norm(np.subtract(end, start)) / 0.05]), tip)


def bits(estimate: Estimate) -> str:
    """Pose, covariance, errors and counts, in hexadecimal."""
    numbers = [*estimate.base_T_correction.matrix.ravel(), *estimate.covariance.ravel()]
    numbers += [estimate.expected_error, estimate.error_quantile, estimate.rmse, estimate.inliers, estimate.samples]
    return np.array(numbers, dtype=np.float64).tobytes().hex()


if __name__ == "__main__":
    print(bits(Registrar().register(*session(float(sys.argv[1])))))
