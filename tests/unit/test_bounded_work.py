"""Neither time nor memory grows with a number in a request: numbers at their limits, scenes that no camera sees."""

from __future__ import annotations

import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from helpers.loop_fakes import MASK, FormulaRegistrar, RandomDetector, answer, asked, misses, opened, samples_of
from helpers.scenes import KINECT, Box, View, World, looking
from pretouch_detector.model.encoding import encode
from pretouch_orchestrator.perception import preparation
from pretouch_orchestrator.perception.preparation import prepare_scene
from pretouch_orchestrator.planning.coverage import CoveragePredictor
from pretouch_orchestrator.sessions import loop as loop_module
from pretouch_orchestrator.sessions.loop import Loop
from pretouch_registrar.engines import camera_model
from pretouch_registrar.lru_cache import LruCache
from pretouch_registrar.registration import Registrar, Settings

from pretouch.camera import Camera, DepthImage
from pretouch.cancellation import Cancellation, Cancelled, bind_cancellation
from pretouch.errors import InvalidInput, RefusedForSize, TooLarge, UnknownScene
from pretouch.geometry import Plane, Pose
from pretouch.prior import Prior
from pretouch.scan_prediction import Candidate
from pretouch.scene import Scene
from pretouch.session import ScanSettings, State
from pretouch.tof import Scan, Sensor
from pretouch.trajectory import Trajectory
from pretouch.wire.common import scene_from_proto, scene_to_proto

REGISTRAR = Registrar()
WORLD = World((Box.standing((0.10, 0.06, 0.05), yaw=0.4),))
SCENE = WORLD.scene(KINECT, np.random.default_rng(5)).cropped(0.1)[0]
UP = Plane(np.array([0.0, 0.0, 1.0]), 0.0)
ABOVE = Pose.of(np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, 1.0])


def flat_scene(shape: tuple[int, int], focal: float, share: float, height: float = 0.05) -> Scene:
    """A block in the middle of an image (h, w), seen from 1 m above, over `share` of each side."""
    sides = [max(1, int(n * share)) for n in shape]
    mask = np.zeros(shape, bool)
    mask[tuple(slice((n - side) // 2, (n - side) // 2 + side) for n, side in zip(shape, sides, strict=True))] = True
    camera = Camera(focal, focal, *(min((n - 1) / 2, 1e6) for n in reversed(shape)))
    return Scene(DepthImage(np.where(mask, 1.0 - height, 1.0)), camera, ABOVE, mask, UP)


def scan_over(scene: Scene, n: int = 60) -> Scan:
    tips = scene.centroid + np.column_stack([np.linspace(-0.05, 0.05, n), np.zeros(n), np.full(n, 0.05)])
    return Scan(tips, np.tile([0.0, 0.0, -1.0], (n, 1)), np.full(n, 0.05))


def path_over(scene: Scene) -> Trajectory:
    tips = np.tile(np.eye(4), (20, 1, 1))
    tips[:, :3, :3] = np.diag([1.0, -1.0, -1.0])
    tips[:, :3, 3] = scan_over(scene, 20).origins
    return Trajectory(np.arange(20.0), tips)


def test_an_object_in_millimetres_or_with_outliers_is_refused_before_its_grid_is_made() -> None:
    outliers = np.arange(SCENE.mask.size).reshape(SCENE.mask.shape) % 97 == 0
    for depth in (1000.0 * SCENE.depth.metres, np.where(outliers, 9000.0, SCENE.depth.metres)):
        absurd = replace(SCENE, depth=DepthImage(np.asarray(depth, np.float32)))
        with pytest.raises(InvalidInput, match="limit is 2 m"):
            REGISTRAR.register(absurd, [scan_over(SCENE)], Settings())


def test_the_model_of_a_large_object_takes_no_longer_than_its_cells() -> None:
    """An object of 1.6 m took over twenty seconds: for each height of a cell, all cells were looked at once more."""
    world = World((Box.standing((1.6, 1.1, 0.64), yaw=0.4),))
    view = View(looking((0.0, 0.0, 0.02), 2.7), Camera(262.5, 262.5, 159.5, 119.5), 320, 240)
    scene = world.scene(view, np.random.default_rng(0))
    camera_model.build(SCENE)
    began = time.process_time()
    model = camera_model.build(scene)
    assert time.process_time() - began < 10
    assert model.footprint.high.max() < 0.7
    hidden = model.footprint.high > model.footprint.low + 0.1
    assert hidden.any()


@pytest.mark.parametrize("shape", [(1, 200_000), (200_000, 1), (2, 100_000)])
def test_images_that_no_camera_makes_are_registered_or_refused(shape: tuple[int, int]) -> None:
    scene = flat_scene(shape, 1e6, 0.4)
    assert REGISTRAR.register(scene, [scan_over(scene)], Settings()).samples > 0
    assert encode(scene).image.nbytes < 2**20


def test_a_slow_finger_with_a_fast_sensor_is_predicted_at_the_pace_of_its_path() -> None:
    path = path_over(SCENE)
    slow = Trajectory(path.t * 1e6, path.base_T_tip)
    predict = CoveragePredictor(SCENE.cloud, [], Sensor(rate=10_000.0), np.diag([1.0, -1.0, -1.0])).predict_fractions
    usual = CoveragePredictor(SCENE.cloud, [], Sensor(), np.diag([1.0, -1.0, -1.0])).predict_fractions
    spans = [(0.0, slow.duration), (0.0, slow.duration / 2)]
    np.testing.assert_allclose(predict(slow, spans), usual(path, [(a / 1e6, b / 1e6) for a, b in spans]), atol=0.02)
    request = asked(scan=ScanSettings(speed=1e-6), sensor=Sensor(rate=1e4))
    record = opened(Loop(RandomDetector(2), FormulaRegistrar()), request)
    assert record.state is State.EXHAUSTED


def test_a_large_image_is_thinned_out_and_planned_in_the_clients_pixels(monkeypatch: pytest.MonkeyPatch) -> None:
    small = opened(Loop(RandomDetector(), FormulaRegistrar()), asked())
    monkeypatch.setattr(preparation, "_MAX_PIXELS", MASK.size // 4)
    thinned = opened(Loop(RandomDetector(), FormulaRegistrar()), asked())
    assert (small.step, thinned.step) == (1, 2)
    np.testing.assert_allclose(thinned.scene.centroid, small.scene.centroid, atol=1e-3)
    v, u = np.nonzero(MASK)
    for region in thinned.regions:
        x, y = region.rectangle.x, region.rectangle.y
        assert u.min() - 3 <= x <= u.max() + 3
        assert v.min() - 3 <= y <= v.max() + 3
        assert thinned.to_scene(region.rectangle).scaled(2).shifted(*thinned.origin).as_list() == pytest.approx(
            region.rectangle.as_list()
        )
    assert thinned.next_scan is not None
    assert thinned.next_scan.path.base_T_tip[:, 2, 3].min() > 0.05


def test_a_large_object_is_thinned_out_too(monkeypatch: pytest.MonkeyPatch) -> None:
    whole, before, _ = prepare_scene(asked(), *WORLD.depth(View()))
    monkeypatch.setattr(preparation, "_MAX_OBJECT_PIXELS", 500)
    scene, origin, _ = prepare_scene(asked(), *WORLD.depth(View()))
    step = round(whole.camera.fx / scene.camera.fx)
    assert step > 1
    assert origin == before
    assert scene.digest == whole.subsampled(step).digest
    assert scene.mask.sum() <= 600


def test_a_session_takes_no_more_samples_than_a_message_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    loop = Loop(RandomDetector(), FormulaRegistrar(1e-4))
    record = opened(loop, asked())
    record = answer(loop, record, samples_of(record))
    monkeypatch.setattr(loop_module, "MAX_SAMPLES", record.scans[0].samples + 50)
    with pytest.raises(TooLarge, match="the limit is"):
        answer(loop, record, misses(60))
    assert len(answer(loop, record, misses(40)).scans) == 2


@pytest.mark.parametrize("method", ["register", "predict"])
def test_a_session_that_has_become_too_large_to_be_sent_fails_and_says_so(
    monkeypatch: pytest.MonkeyPatch, method: str
) -> None:
    registrar = FormulaRegistrar(1e-4)
    loop = Loop(RandomDetector(), registrar)
    record = opened(loop, asked())

    async def refuse(*_: object) -> None:
        raise RefusedForSize("What the registrar would be sent is larger than a message may be.", "Send fewer samples.")

    monkeypatch.setattr(registrar, method, refuse)
    after = answer(loop, record, samples_of(record))
    assert after.state is State.FAILED
    assert after.reason is not None
    assert after.reason["type"].endswith("too-large")
    assert after.next_scan is None


def test_the_registrar_takes_so_many_samples_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pretouch_registrar.registration.MAX_SAMPLES", 100)
    with pytest.raises(TooLarge, match="limit is 100"):
        REGISTRAR.register(SCENE, [scan_over(SCENE), scan_over(SCENE, 61)], Settings())


def test_a_scene_is_recalled_by_its_content_and_by_nothing_else() -> None:
    registrar = Registrar()
    with pytest.raises(UnknownScene):
        registrar.recall(SCENE.digest)
    sent = scene_from_proto(scene_to_proto(SCENE))
    assert sent.digest == SCENE.digest
    registrar.remember(sent)
    whole = registrar.register(SCENE, [scan_over(SCENE)], Settings())
    by_digest = registrar.register(registrar.recall(SCENE.digest), [scan_over(SCENE)], Settings())
    np.testing.assert_array_equal(by_digest.covariance, whole.covariance)
    for digest in (b"", bytes(32), SCENE.digest[:31]):
        with pytest.raises(UnknownScene):
            registrar.recall(digest)


def test_a_table_read_back_has_the_same_digest() -> None:
    rng = np.random.default_rng(0)
    for _ in range(200):
        normal = rng.normal(size=3)
        once = Plane(normal / np.linalg.norm(normal), 0.1)
        np.testing.assert_array_equal(Plane(once.normal, once.offset).normal, once.normal)


def test_a_cache_holds_so_many_bytes_and_what_was_used_last() -> None:
    cache: LruCache[str, int] = LruCache(10, lambda weight: weight)
    for key, weight in (("a", 4), ("b", 4), ("c", 2)):
        cache.put(key, weight)
    assert cache.get("a") == 4
    cache.put("d", 3)
    assert [cache.get(key) for key in "abcd"] == [4, None, 2, 3]
    cache.put("d", 5)
    cache.put("e", 100)
    assert [cache.get(key) for key in "acde"] == [None, None, None, 100]


def test_a_registration_ends_soon_after_it_is_cancelled() -> None:
    cancellation = Cancellation()
    candidates = [Candidate(path_over(SCENE)) for _ in range(2000)]
    REGISTRAR.predict(SCENE, [scan_over(SCENE)], Settings(), candidates[:2])
    outcome: list[BaseException] = []
    started = threading.Event()

    def compute() -> None:
        bind_cancellation(cancellation)
        started.set()
        try:
            REGISTRAR.predict(SCENE, [scan_over(SCENE)], Settings(), candidates)
        except BaseException as error:
            outcome.append(error)

    thread = threading.Thread(target=compute)
    thread.start()
    started.wait(30)
    cancellation.cancel()
    thread.join(30)
    assert not thread.is_alive()
    assert isinstance(outcome[0], Cancelled)


def test_the_prior_may_be_as_wide_as_allowed() -> None:
    estimate = REGISTRAR.register(SCENE, [scan_over(SCENE)], Settings(prior=Prior(1.0, 1.0)))
    assert np.isfinite(estimate.covariance).all()
