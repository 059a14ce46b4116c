"""Real depth frames, and the same worlds seen by simulated cameras."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pretouch_simulation.depth_cameras import CameraModel, realise
from pretouch_simulation.evaluation_tasks import MIN_PIXELS
from pretouch_simulation.frames import frame_case, load_frame, load_images
from pretouch_simulation.objects import MAKERS
from pretouch_simulation.protocol import Case, generator, make_case
from pretouch_simulation.world import World
from scipy import ndimage

from experiments.camera_residuals import NEAR, SCALES, Mask, Residuals, Truth, residuals, smooth, truth_of
from pretouch.camera import Camera
from pretouch.geometry import Array, Plane, Pose

REAL = "real"
CAMERAS = (REAL, *(model.value for model in CameraModel))
_BORDER = 4
"""px of the labelled table that are left out along its border."""


@dataclass(frozen=True, eq=False)
class View:
    """An object as one camera sees it.

    Attributes:
        camera: one of `CAMERAS`.
        measured: (h, w), m.
        mask: (h, w), the client's.
    """

    frame: str
    name: str
    camera: str
    truth: Truth
    measured: Array
    mask: Mask

    @property
    def residuals(self) -> Residuals:
        return residuals(self.truth, self.measured, self.mask)


def views_of(path: Path) -> Iterator[View]:
    """Every object of a frame with over 1000 pixels of depth, as the real camera and each simulated one sees it."""
    frame = load_frame(path)
    for thing in frame.objects:
        if frame.mask(thing.name).sum() > MIN_PIXELS:
            case = frame_case(frame, thing.name, 0)
            yield from _views(frame.name, thing.name, case)


def _views(frame: str, name: str, case: Case) -> Iterator[View]:
    base_T_camera = case.truth @ case.base_T_camera
    shape = (case.depth.height, case.depth.width)
    truth = truth_of(case.world, case.camera, base_T_camera, shape)
    yield View(frame, name, REAL, truth, case.depth.metres.astype(np.float64), case.mask)
    for model in CameraModel:
        camera = realise(model, generator("cameras of", model, frame, name))
        rng = generator("cameras", model, frame, name)
        image = camera.render(case.world, case.camera, base_T_camera, rng, shape)
        yield View(frame, name, model.value, truth, image.depth.metres.astype(np.float64), image.mask)


def protocol_views() -> Iterator[View]:
    """One view of each object made in code, as the evaluation protocol has them, by each simulated camera."""
    for name, make in MAKERS.items():
        for model in CameraModel:
            case = make_case(name, make(), 0, 0, model)
            metres, shape = case.depth.metres.astype(np.float64), (case.depth.height, case.depth.width)
            truth = truth_of(case.world, case.camera, case.truth @ case.base_T_camera, shape)
            yield View("", name, model.value, truth, metres, case.mask)


def table_stds(path: Path) -> dict[str, Array]:
    """(7,), m, of the table of a frame without poses, for each of `CAMERAS`: std against the plane that fits best.

    Along z, the same smoothed over `SCALES`, and at right angles to the plane.
    """
    images = load_images(path)
    if images.labels is None:
        return {}
    real = images.depth.metres.astype(np.float64)
    plane = np.array(json.loads(path.read_text())["table_plane_cam_abcd"])
    plane = plane / np.linalg.norm(plane[:3]) * np.sign(plane[3])
    world = World([], Plane(plane[:3], -plane[3]))
    shape = (images.depth.height, images.depth.width)
    truth = truth_of(world, images.camera, Pose.identity(), shape)
    inside = ndimage.binary_erosion(images.labels == 1, iterations=_BORDER)
    found = {REAL: _table(truth, real, inside, images.camera)}
    for model in CameraModel:
        camera = realise(model, generator("cameras of", model, path.stem))
        image = camera.render(world, images.camera, Pose.identity(), generator("cameras", model, path.stem), shape)
        found[model.value] = _table(truth, image.depth.metres.astype(np.float64), inside, images.camera)
    return found


def _table(truth: Truth, measured: Array, inside: Mask, camera: Camera) -> Array:
    counted = inside & (measured > 0) & (np.abs(measured - truth.depth) < NEAR)
    points = camera.back_project_image(measured)[counted]
    spread, axes = np.linalg.eigh(np.cov(points.T))
    v, u = np.nonzero(counted)
    rays = camera.back_project(np.stack([u, v], axis=-1), np.ones(len(u)))
    residual = np.zeros(measured.shape)
    residual[counted] = measured[counted] - (points.mean(axis=0) @ axes[:, 0]) / (rays @ axes[:, 0])
    levels = [smooth(residual, counted, scale)[counted].std() for scale in SCALES]
    return np.array([residual[counted].std(), *levels, np.sqrt(spread[0])])


def select_camera(views: Sequence[tuple[View, Residuals]], camera: str) -> list[Residuals]:
    """Those of one camera."""
    return [found for view, found in views if view.camera == camera]
