"""Datasets are read back as written; damaged ones, and those of another version or recipe, are refused."""

import json
import tempfile
from pathlib import Path

import numpy as np
import pytest
from helpers.label_cases import SENSOR, example, scene
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_detector.training.dataset import DEPTH_UNIT, FORMAT, Dataset, Example, read, write

from pretouch.errors import Conflict, InvalidInput, Malformed, NotFound

ERRORS = st.one_of(st.just(float("nan")), st.floats(0, 0.125, width=32))
TEXTS = st.text(st.characters(codec="utf-8"), max_size=12)


@st.composite
def examples(draw: st.DrawFn) -> Example:
    count, trials = draw(st.integers(0, 5)), draw(st.integers(1, 3))
    rng = np.random.default_rng(draw(st.integers(0, 99)))

    def errors(*shape: int) -> np.ndarray:
        return np.array(draw(st.lists(ERRORS, min_size=int(np.prod(shape)), max_size=int(np.prod(shape))))).reshape(
            shape
        )

    return Example(
        draw(TEXTS), draw(TEXTS), scene(draw(st.integers(16, 30)), draw(st.integers(18, 40))), SENSOR,
        rng.uniform(1, 20, (count, 5)).astype(np.float32), errors(count, trials), errors(count, trials), errors(count),
        draw(st.dictionaries(TEXTS, st.one_of(st.integers(), TEXTS, st.none()), max_size=3)),
    )  # fmt: skip


@given(examples())
@settings(max_examples=40)
def test_a_view_is_read_back_as_it_was_written(written: Example) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "train" / "view.npz"
        write(path, written)
        found = read(path)
        assert [other.name for other in path.parent.iterdir()] == ["view.npz"]
    assert (found.name, found.object, found.provenance) == (written.name, written.object, written.provenance)
    np.testing.assert_allclose(found.scene.depth.metres, written.scene.depth.metres, atol=0.51 * DEPTH_UNIT)
    for name in ("range_min", "range_max", "range_std", "beam_half_angle"):
        assert getattr(found.sensor, name) == getattr(written.sensor, name)
    np.testing.assert_array_equal(found.scene.mask, written.scene.mask)
    assert found.scene.camera == written.scene.camera
    assert found.scene.base_T_camera.is_close(written.scene.base_T_camera, 0)
    np.testing.assert_array_equal(found.scene.table.normal, written.scene.table.normal)
    assert found.scene.table.offset == written.scene.table.offset
    for name in ("rectangles", "scores", "expected", "predicted"):
        np.testing.assert_array_equal(getattr(found, name), getattr(written, name))


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("whole") / "view.npz"
    write(path, example())
    return path.read_bytes()


@given(st.data())
@settings(max_examples=150)
def test_a_damaged_file_is_named_with_a_remedy_or_reads(whole: bytes, data: st.DataObject) -> None:
    damaged = bytearray(whole)
    for place in data.draw(st.lists(st.integers(0, len(whole) - 1), min_size=1, max_size=4)):
        damaged[place] ^= data.draw(st.integers(1, 255))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "view.npz"
        path.write_bytes(damaged)
        said = None
        try:
            read(path)
        except Malformed as error:
            said = error
    assert said is None or (str(path) in said.detail and "Delete it" in said.remedy)


@given(st.floats(0, 0.999))
@settings(max_examples=40)
def test_a_truncated_file_is_named_with_a_remedy(whole: bytes, share: float) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "view.npz"
        path.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(Malformed, match=r"view\.npz") as refused:
            read(path)
    assert "generate" in refused.value.remedy


def test_a_dataset_goes_on_by_the_same_recipe_only(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "labels"
    Dataset.create(folder, {"recipe": {"seed": 0}, "command": "one"})
    again = Dataset.create(folder, {"recipe": {"seed": 0}, "command": "two"})
    assert again.description == {"format": FORMAT, "recipe": {"seed": 0}, "command": "one"}
    with pytest.raises(Conflict, match="another recipe") as refused:
        Dataset.create(folder, {"recipe": {"seed": 1}, "command": "one"})
    assert "another folder" in refused.value.remedy


def test_another_version_and_no_dataset_are_told_apart(tmp_path: Path) -> None:
    with pytest.raises(NotFound, match=r"no dataset\.json"):
        Dataset(tmp_path)
    (tmp_path / "dataset.json").write_text(json.dumps({"format": FORMAT + 1}))
    with pytest.raises(InvalidInput, match=f"format {FORMAT + 1}; this version reads {FORMAT}") as refused:
        Dataset(tmp_path)
    assert not isinstance(refused.value, Malformed)
    for text in ("{", "[]", "{}"):
        (tmp_path / "dataset.json").write_text(text)
        with pytest.raises(Malformed, match=r"dataset\.json cannot be read"):
            Dataset(tmp_path)


def test_half_written_files_do_not_count(tmp_path: Path) -> None:
    dataset = Dataset.create(tmp_path, {})
    write(dataset.path("train", "box-0-0"), example())
    (tmp_path / "train" / ".can-0-0.npz.1234").write_bytes(b"PK")
    assert [found.name for found in dataset.read_examples("train")] == ["box-0-0"]
    assert list(dataset.read_examples("validation")) == []


def test_a_rectangle_is_as_good_as_its_trials() -> None:
    given_scores = np.array([[0.01, 0.03], [np.nan, np.nan], [np.nan, 0.02]])
    view = Example("a", "a", scene(), SENSOR, np.ones((3, 5)), given_scores, given_scores, given_scores[:, 0], {})
    np.testing.assert_allclose(view.compute_errors(worst=True), [0.03, np.nan, 0.02])
    np.testing.assert_allclose(view.compute_errors(worst=False), [0.02, np.nan, 0.02])
