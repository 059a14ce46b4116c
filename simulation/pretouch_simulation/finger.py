"""The simulated fingertips and their interface."""

from __future__ import annotations

from enum import StrEnum
from importlib import import_module
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch.tof import Sensor
from pretouch_simulation.world import World


class FingerModel(StrEnum):
    """Which fingertip is simulated: each is the module of its name in `fingers`, with a function `draw(rng) -> Finger`.

    `IDEAL`: the paper's thin beam. `VL6180X`: the real module's cone, steps and errors. `CONE`: a cone that sees near
    parts first, of a width and a nearness that vary from one finger to the next. `RANDOM`: beam or cone, everything
    drawn anew for each finger.
    """

    IDEAL = "ideal"
    VL6180X = "vl6180x"
    CONE = "cone"
    RANDOM = "random"
    GRIPPER = "gripper"
    ZONES = "zones"


class Measurements(Protocol):
    """The measurements of one scan, taken all at once or step by step: what is random about them is drawn already."""

    def take(self, world: World, base_T_module: Array, first: int = 0) -> tuple[Array, NDArray[np.int64]]:
        """The scan's measurements from number `first` on, at the modules' poses (n, 4, 4) in base, beams along their z.

        Returns:
            Ranges (n,), m along the beam, NaN where the module gave none; status codes (n,), 0 is good.
        """


class Finger(Protocol):
    """One fingertip, its parameters fixed. Its modules take turns."""

    @property
    def sensor(self) -> Sensor:
        """The description that a client sends when it creates a session, right or wrong."""

    def begin_scan(self, count: int, rng: np.random.Generator) -> Measurements:
        """Draws what is random about a scan of `count` measurements, such as the bias that its ranges share."""


def measure_scan(
    finger: Finger, world: World, base_T_module: Array, rng: np.random.Generator
) -> tuple[Array, NDArray[np.int64]]:
    """A whole scan at the modules' poses (n, 4, 4) in base: see `Measurements.take`."""
    return finger.begin_scan(len(base_T_module), rng).take(world, base_T_module)


def realise(model: FingerModel, rng: np.random.Generator) -> Finger:
    """A fingertip of the model, what varies between such fingertips drawn from `rng`; IDEAL and VL6180X never vary."""
    finger: Finger = import_module(f"pretouch_simulation.fingers.{model.value}").draw(rng)
    return finger
