"""The network's input: metric heights and places that do not depend on the camera; normalised rectangles."""

from dataclasses import replace

import numpy as np
from helpers.scenes import KINECT, Box, View, World, looking
from pretouch_detector.model.encoding import CHANNELS, LENGTH, SCALE, SIZE, Encoding, encode

from pretouch.camera import Camera
from pretouch.geometry import Pose

HEIGHT, AWAY, ACROSS, OBJECT, SEEN, LOG_SIZE = (CHANNELS.index(name) for name in CHANNELS)
BOX = World((Box.standing((0.10, 0.06, 0.05), yaw=0.4),))


def test_channels_are_heights_and_places_in_the_tables_frame() -> None:
    scene = BOX.scene(KINECT)
    encoding = encode(scene)
    image = encoding.image
    assert image.shape == (len(CHANNELS), SIZE, SIZE)
    on, seen = image[OBJECT] > 0, image[SEEN] > 0
    assert abs(np.quantile(image[HEIGHT][on], 0.99) * LENGTH - 0.05) < 0.002
    assert np.abs(image[HEIGHT][seen & ~on]).max() * LENGTH < 0.003
    assert abs(image[AWAY][on].mean()) < 0.1  # places count from the object's centroid
    assert abs(image[ACROSS][on].mean()) < 0.1
    span = np.ptp(image[ACROSS][on]) * LENGTH
    assert 0.06 < span < np.hypot(0.10, 0.06)
    half = SCALE * np.exp(image[LOG_SIZE, 0, 0])
    assert abs(half - encoding.half * 0.8 / 525) < 0.01
    assert (np.diff(image[AWAY][:, SIZE // 2][seen[:, SIZE // 2]]) < 0.1).all()  # further away is higher in the image


def test_a_finer_camera_sees_the_same() -> None:
    fine = Camera(1050.0, 1050.0, 639.5, 479.5)
    views = [KINECT, View(camera=fine, width=1280, height=960)]
    coarse, sharp = (encode(BOX.scene(view)).image for view in views)
    assert (np.abs(coarse - sharp).max(axis=0) < 0.2).mean() > 0.97


def test_places_do_not_depend_on_where_base_is() -> None:
    scene = BOX.scene(KINECT)
    a_T_base = Pose.from_rotation_vector([0.0, 0.0, 1.2], [0.3, -0.2, 0.7])
    moved = replace(scene, base_T_camera=a_T_base @ scene.base_T_camera, table=scene.table.moved(a_T_base))
    np.testing.assert_allclose(encode(moved).image, encode(scene).image, atol=1e-4)


def test_an_object_at_the_images_border_and_a_camera_that_looks_straight_down() -> None:
    aside = View(base_T_camera=looking((0.28, 0.0, 0.02)), camera=KINECT.camera, width=640, height=480)
    above = View(base_T_camera=looking((0.0, 0.0, 0.02), down=90.0), camera=KINECT.camera, width=640, height=480)
    for view in (aside, above):
        image = encode(BOX.scene(view)).image
        assert np.isfinite(image).all()
        assert (image[OBJECT] > 0).sum() > 500


def test_in_the_squares_units_a_rectangle_keeps_its_direction_and_the_square_reaches_from_minus_1_to_1() -> None:
    encoding = Encoding(np.zeros((len(CHANNELS), SIZE, SIZE), np.float32), (321.5, 77.0), 50.0)
    given = [(271.5, 27.0, 100.0, 25.0, 0.3), (371.5, 127.0, 50.0, 200.0, -1.5)]
    np.testing.assert_allclose(encoding.normalise(given), [(-1, -1, 2, 0.5, 0.3), (1, 1, 1, 4, -1.5)], rtol=1e-6)
