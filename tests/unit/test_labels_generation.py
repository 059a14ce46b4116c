"""Labels of a view: which rectangles are scored and kept; meshes of any origin; the page that shows a dataset."""

from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from helpers.label_cases import example
from helpers.made_frame import write_mesh
from PIL import Image
from pretouch_detector.training.dataset import Dataset, Example, read, write
from pretouch_registrar.engines import Engine
from pretouch_simulation.finger import FingerModel
from pretouch_simulation.labels.generation import Kind, Outcome, Recipe, describe, label, try_to_label
from pretouch_simulation.labels.pictures import save_contact_sheet, save_statistics
from pretouch_simulation.labels.procedural import make_procedural
from pretouch_simulation.labels.scans import Scoring, scan_and_register
from pretouch_simulation.labels.statistics import statistics, statistics_of, table
from pretouch_simulation.labels.task import Task
from pretouch_simulation.mesh import Mesh
from pretouch_simulation.objects import mug
from pretouch_simulation.stable_pose import find_resting_poses
from rich.console import Console

from pretouch.errors import NotFound
from pretouch.estimate import from_prior
from pretouch.geometry import Pose
from pretouch.prior import Prior
from pretouch.tof import Sensor

TRIALS = Recipe(Kind.TRIALS, Engine.PAPER, rectangles=12, scanned=0, trials=3)


def made(task: Task, recipe: Recipe, folder: Path) -> Example:
    dataset = Dataset.create(folder, describe(recipe, "pretouch labels generate"))
    label(task, recipe, folder)
    return read(dataset.path(task.side, task.name))


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Example:
    return made(Task(6, 0, 0), TRIALS, tmp_path_factory.mktemp("full"))


def test_every_rectangle_of_algorithm_1_keeps_all_its_scores(full: Example) -> None:
    assert full.scores.shape == (12, 3)
    assert np.isfinite(full.scores).all()
    assert np.isnan(full.expected).all()
    assert np.isnan(full.predicted).all()
    assert full.object == "code__blocks_006"
    assert full.provenance["source"] == "made in code"
    u0, v0 = full.provenance["first_pixel"]
    assert full.scene.camera.cx == 319.5 - u0
    assert full.scene.camera.cy == 239.5 - v0


def test_pruning_finds_the_same_winner_with_the_same_scores(full: Example, tmp_path: Path) -> None:
    pruned = made(Task(6, 0, 0), replace(TRIALS, best_only=True), tmp_path)
    np.testing.assert_array_equal(pruned.rectangles, full.rectangles)
    winner = int(np.argmin(full.compute_errors(worst=True)))
    np.testing.assert_array_equal(pruned.scores[winner], full.scores[winner])
    assert np.isnan(np.delete(pruned.scores, winner, axis=0)).all()


def test_a_scanned_view_keeps_what_was_predicted_and_what_came_of_it(tmp_path: Path) -> None:
    recipe = Recipe(Kind.SCANS, Engine.POSTERIOR, rectangles=5, scanned=2, trials=1)
    view = made(Task(0, 1, 0), recipe, tmp_path)
    scanned = np.isfinite(view.scores[:, 0])
    assert scanned.sum() == 2
    assert scanned[np.argmin(view.predicted)]
    np.testing.assert_array_equal(np.isfinite(view.expected[:, 0]), scanned)
    left = from_prior(Prior(), view.scene.cloud).expected_error
    assert (view.predicted > 0).all()
    assert (view.predicted < 1.001 * left).all()
    assert (view.scores[scanned] < 0.06).all()
    again = made(Task(0, 1, 0), recipe, tmp_path / "again")
    np.testing.assert_array_equal(again.scores, view.scores)
    other = made(Task(0, 1, 0), replace(recipe, seed=1), tmp_path / "other")
    assert not np.array_equal(other.rectangles, view.rectangles)


def test_a_view_is_scanned_by_a_finger_of_its_own(tmp_path: Path) -> None:
    recipe = Recipe(Kind.SCANS, Engine.POSTERIOR, rectangles=3, scanned=1, trials=1, finger=FingerModel.RANDOM)
    view = made(Task(0, 1, 0), recipe, tmp_path)
    again = made(Task(0, 1, 0), recipe, tmp_path / "again")
    ideal = made(Task(0, 1, 0), replace(recipe, finger=FingerModel.IDEAL), tmp_path / "ideal")
    assert np.isfinite(view.scores).sum() == 1
    np.testing.assert_array_equal(again.scores, view.scores)
    assert (view.predicted != ideal.predicted).any()
    assert (ideal.sensor.range_std, ideal.sensor.beam_half_angle) == (Sensor().range_std, 0.0)
    others = [made(task, recipe, tmp_path) for task in (Task(0, 0, 0), Task(0, 1, 1))]
    assert len({each.sensor.range_std for each in (view, *others)}) == 3


def test_where_the_clients_mask_strays_the_objects_true_points_are_scored(tmp_path: Path) -> None:
    view = Task(0, 1, 0).load_view(0)
    truth = Pose.of(np.eye(3), np.array([0.01, 0.0, 0.0])) @ Pose.from_rotation_vector([0.0, 0.0, 0.2], np.zeros(3))
    strayed = replace(view.scene, mask=view.scene.depth.metres > 0)
    errors = [
        scan_and_register(replace(view, scene=scene), None, truth, Scoring(), np.random.default_rng(0))[0]
        for scene in (view.scene, strayed)
    ]
    cloud = view.case.cloud
    assert errors == [pytest.approx(np.linalg.norm(truth.apply(cloud) - cloud, axis=1).mean())] * 2


def test_a_mesh_in_millimetres_is_named_and_said_how_to_mend(tmp_path: Path) -> None:
    cup = mug()
    write_mesh(tmp_path / "cup.obj", Mesh(1000 * cup.vertices, cup.faces))
    outcome = try_to_label(Task(tmp_path / "cup.obj", 0, 0), TRIALS, tmp_path)
    assert outcome.problem.startswith("cup.obj is ")
    assert "as if it were in millimetres" in outcome.problem
    assert "Scale it to metres" in outcome.problem
    assert not outcome.defect


def test_a_mesh_that_is_not_watertight_is_labelled(tmp_path: Path) -> None:
    whole = make_procedural(6)[1]
    broken = Mesh(whole.vertices, whole.faces[np.arange(len(whole.faces)) % 7 != 0])
    assert not broken.watertight
    write_mesh(tmp_path / "broken.obj", broken)
    view = made(Task(tmp_path / "broken.obj", 0, 0), TRIALS, tmp_path / "labels")
    assert np.isfinite(view.scores).all()


def million() -> Mesh:
    """A lumpy ellipsoid with a million faces."""
    n = 708
    down, around = np.meshgrid(np.linspace(0, np.pi, n), np.arange(n) * 2 * np.pi / n, indexing="ij")
    radius = 0.04 * (1 + 0.05 * np.sin(9 * down) * np.cos(7 * around))
    x, y = (1.3 * radius * np.sin(down) * turned(around) for turned in (np.cos, np.sin))
    index = np.arange(n * n).reshape(n, n)
    a, c = index[:-1], index[1:]
    b, d = np.roll(a, -1, axis=1), np.roll(c, -1, axis=1)
    faces = [np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, c, b), (b, c, d))]
    return Mesh(np.stack([x, y, 0.8 * radius * np.cos(down)], axis=-1).reshape(-1, 3), np.concatenate(faces))


@pytest.mark.timeout(120)  # without care it takes hours
def test_a_mesh_with_a_million_faces_is_labelled(tmp_path: Path) -> None:
    mesh = million()
    assert len(mesh.faces) > 1_000_000
    path = tmp_path / "lump.stl"
    faces = np.zeros(len(mesh.faces), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    faces["corners"] = mesh.vertices[mesh.faces]
    path.write_bytes(bytes(80) + np.uint32(len(faces)).tobytes() + faces.tobytes())
    view = made(Task(path, 0, 0), TRIALS, tmp_path / "labels")
    assert view.scene.mask.sum() > 1000
    assert np.isfinite(view.scores).all()


def test_a_fine_mesh_rests_as_a_coarse_one_does() -> None:
    mesh = make_procedural(7)[1]
    fine = mesh
    while len(fine.vertices) < 25_000:
        a, b, c = (fine.vertices[fine.faces[:, k]] for k in range(3))
        corners = [(a, (a + b) / 2, (c + a) / 2), ((a + b) / 2, b, (b + c) / 2)]
        corners += [((c + a) / 2, (b + c) / 2, c), ((a + b) / 2, (b + c) / 2, (c + a) / 2)]
        places = np.concatenate([np.stack(three, axis=1) for three in corners]).reshape(-1, 3)
        fine = Mesh(places, np.arange(len(places)).reshape(-1, 3))
    for coarse_pose, fine_pose in zip(find_resting_poses(mesh, 3), find_resting_poses(fine, 3), strict=True):
        np.testing.assert_allclose(fine_pose.extents, coarse_pose.extents, atol=1e-6)


def test_statistics_count_objects_views_and_rectangles(tmp_path: Path) -> None:
    dataset = Dataset.create(tmp_path, {"recipe": {"kind": "scans"}})
    with pytest.raises(NotFound, match="no labelled view yet"):
        statistics(dataset)
    for side, name in (("train", "box-0-0"), ("train", "box-0-1"), ("validation", "can-0-0")):
        write(dataset.path(side, name), example(name))
    views = statistics(dataset)
    screen = StringIO()
    Console(file=screen, width=60).print(table(views))
    assert "…" not in screen.getvalue()
    rows = [[cell.strip() for cell in line.strip("│").split("│")] for line in screen.getvalue().splitlines()]
    for row in (["objects", "1", "1", "2"], ["views", "2", "1", "3"], ["rectangles", "12", "6", "18"]):
        assert row in rows
    assert ["with trials", "6", "3", "9"] in rows


def test_statistics_of_a_view_know_best_median_and_what_cannot_be_scanned() -> None:
    view = example(rectangles=4, trials=2)
    left = from_prior(Prior(), view.scene.cloud).expected_error
    scores = np.array([[0.03, 0.01], [0.02, 0.022], [np.nan, np.nan], [0.04, 0.01]])
    changed = replace(view, scores=scores, predicted=np.array([0.01, left, np.float32(left), 0.5 * left]))
    mean = statistics_of(changed, "train", worst=False)
    assert (mean.best, mean.median, mean.unscannable) == (pytest.approx(0.02), pytest.approx(0.021), 0.5)
    worst = statistics_of(changed, "train", worst=True)
    assert (worst.best, worst.median) == (pytest.approx(0.022), pytest.approx(0.03))
    assert np.isnan(statistics_of(replace(view, predicted=np.full(4, np.nan)), "train", True).unscannable)


def test_statistics_tell_what_of_a_score_is_luck() -> None:
    view = example(rectangles=6, trials=4)
    good = np.arange(6.0)[:, None] * 0.01 + [0.0, 0.001, 0.002, 0.001]
    assert statistics_of(replace(view, scores=good), "train", worst=True).agreement == pytest.approx(1.0)
    luck = np.column_stack([good[:, :2], good[::-1, :2]])
    assert statistics_of(replace(view, scores=luck), "train", worst=False).agreement == pytest.approx(-1.0)
    assert np.isnan(statistics_of(example(rectangles=6, trials=1), "train", worst=False).agreement)
    few = np.where(np.arange(6)[:, None] < 4, good, np.nan)
    assert np.isnan(statistics_of(replace(view, scores=few), "train", worst=False).agreement)


def test_the_pictures_show_each_object_before_any_again(tmp_path: Path) -> None:
    dataset = Dataset.create(tmp_path, {"recipe": {"kind": "scans"}})
    for name in (*(f"thing_{k}-0-0" for k in range(7)), *(f"thing_0-0-{k}" for k in range(1, 9))):
        write(dataset.path("train", name), example(name))
    shown = save_contact_sheet(dataset, tmp_path / "sheet.png", rows=1)
    assert len(shown) == 8
    assert len({name.partition("-")[0] for name in shown[:7]}) == 7
    save_statistics(statistics(dataset), "title", tmp_path / "page.png")
    for picture in ("sheet.png", "page.png"):
        with Image.open(tmp_path / picture) as image:
            assert image.width > 600
            assert len(image.convert("RGB").getcolors(1 << 20) or []) > 20


def test_an_outcome_without_a_problem_is_a_label(tmp_path: Path) -> None:
    dataset = Dataset.create(tmp_path, describe(TRIALS, ""))
    task = Task(0, 0, 0)
    assert try_to_label(task, TRIALS, tmp_path) == Outcome(task.name)
    assert [path.stem for path in dataset.list_paths("train")] == [task.name]
