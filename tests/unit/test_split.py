"""Meshes are split by the object that they show, in the same way everywhere."""

from collections import Counter
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pretouch_simulation.mesh_folder import meshes_in
from pretouch_simulation.split import Split, compute_mixing_key, object_of, split_of

from pretouch.errors import NotFound

DUPLICATES = [
    ("cram__bowl", "cram__bowl_b"),
    ("cram__fork", "cram__fork_b"),
    ("gso__black_razer_mouse", "gso__white_razer_mouse"),
    ("gso__red_and_white_striped_towel", "gso__green_and_white_striped_towel"),
    ("gso__black_shoe_with_green_stripes", "gso__black_shoe_with_orange_stripes"),
    ("urdfmodels__book_holder_1", "urdfmodels__book_holder_3"),
    ("egad__train_B25_0", "egad__train_B25_2"),
    ("objsim__mug", "cram__mug"),
]


@pytest.mark.parametrize(("one", "other"), DUPLICATES)
def test_near_duplicates_are_one_object(one: str, other: str) -> None:
    assert object_of(one) == object_of(other)
    assert split_of(one) is split_of(other)


def test_different_objects_are_told_apart() -> None:
    names = ("egad__eval_A0", "egad__eval_A1", "cram__plate", "drake__plate_8in", "cram__cup", "gso__porcelain_cup")
    assert len({object_of(name) for name in names}) == len(names)
    assert object_of("source__red") == "red"
    assert object_of("7") == "7"


def test_the_sides_are_fixed() -> None:
    sides = {name: split_of(name).value for name in ("cram__plate", "cram__fork", "cram__bowl", "gso__red_cup", "toy")}
    assert sides == {
        "cram__plate": "validation",
        "cram__fork": "validation",
        "cram__bowl": "train",
        "gso__red_cup": "train",
        "toy": "train",
    }


def test_about_a_fifth_is_kept_for_reporting() -> None:
    sides = Counter(split_of(f"source__thing{k}") for k in range(2000))
    assert 0.17 < sides[Split.VALIDATION] / 2000 < 0.23


@given(st.text(alphabet="abcdefgh_0123", min_size=1), st.sampled_from(["red", "blue", "and_white"]))
def test_any_name_has_a_side_and_a_place(stem: str, colour: str) -> None:
    assert split_of(stem) in Split
    assert 0 <= compute_mixing_key(stem) < 1
    assert object_of(f"a__{colour}_{stem}x_body") == object_of(f"b__{stem}x_body_2")


def test_a_folder_is_split_without_overlap_and_its_sources_mixed(tmp_path: Path) -> None:
    stems = {f"{source}__thing{k}" for source in ("one", "two", "three") for k in range(40)}
    for stem in stems:
        (tmp_path / f"{stem}.ply").touch()
    train, validation = (meshes_in(tmp_path, split=side) for side in Split)
    assert {path.stem for path in [*train, *validation]} == stems
    assert len(train) + len(validation) == len(stems)
    first = meshes_in(tmp_path, limit=9, split=Split.VALIDATION)
    assert first == validation[:9]
    assert len({path.stem.split("__")[0] for path in first}) == 3


def test_an_empty_side_is_said(tmp_path: Path) -> None:
    (tmp_path / "toy.ply").touch()
    assert meshes_in(tmp_path, split=Split.TRAIN)
    with pytest.raises(NotFound, match="validation"):
        meshes_in(tmp_path, split=Split.VALIDATION)
