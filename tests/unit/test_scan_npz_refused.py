"""An .npz file of a target or a scan that cannot be used is refused for its true cause."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pretouch_registrar.scan_files import Given, read_scan, read_target

from pretouch.errors import InvalidInput, TooLarge
from pretouch.geometry import Plane

LEVEL = Plane(np.array([0.0, 0.0, 1.0]), 0.0)
MASK = np.zeros((120, 160), dtype=bool)
MASK[35:85, 55:105] = True
CAMERA_DOWN = np.diag([1.0, -1.0, -1.0, 1.0])
CAMERA_DOWN[2, 3] = 0.5
VIEW: dict[str, Any] = {
    "depth": np.where(MASK, 0.45, 0.5), "fx": 150.0, "fy": 150.0, "cx": 80.0, "cy": 60.0, "base_T_camera": CAMERA_DOWN,
    "mask": MASK, "table": np.array([0.0, 0.0, 1.0, 0.0]),
}  # fmt: skip
BEAMS: dict[str, Any] = {
    "origins": np.full((9, 3), 0.2), "directions": np.tile([0.0, 0.0, -1.0], (9, 1)), "ranges": np.full(9, 0.15),
}  # fmt: skip


def nothing(_: str) -> None:
    """What is said besides is not of interest here."""


VIEWS: dict[str, tuple[dict[str, Any], str]] = {
    "two focal lengths": ({"fx": np.array([1.0, 2.0])}, "fx is an array of shape [2], not one number"),
    "a word": ({"fx": "600"}, "fx holds <U3, not numbers"),
    "objects": ({"depth": VIEW["depth"].astype(object)}, "depth holds Python objects"),
    "complex depth": ({"depth": VIEW["depth"] + 0j}, "depth holds complex128, not numbers"),
    "depth of bool": ({"depth": MASK}, "depth holds bool, not numbers"),
    "a mask of times": ({"mask": MASK.astype("M8[s]")}, "mask holds datetime64[s], not numbers"),
    "a table that faces down": ({"table": np.array([0.0, 0.0, -1.0, 0.0])}, "does not point to the camera's side"),
    "a table above the object": ({"table": np.array([0.0, 0.0, 1.0, 0.1])}, "nothing of the object stands above"),
}


@pytest.mark.parametrize("case", VIEWS)
def test_a_depth_image_is_refused_for_what_is_wrong_in_it(tmp_path: Path, case: str) -> None:
    changes, said = VIEWS[case]
    np.savez(tmp_path / "view.npz", **(VIEW | changes))
    with pytest.raises(InvalidInput) as raised:
        read_target(tmp_path / "view.npz", Given(), nothing)
    assert said in str(raised.value)
    assert "view.npz" in str(raised.value)
    assert raised.value.remedy


def test_the_same_depth_image_without_a_defect_is_read(tmp_path: Path) -> None:
    np.savez(tmp_path / "view.npz", **VIEW)
    assert read_target(tmp_path / "view.npz", Given(), nothing).mask.sum() == MASK.sum()


def test_a_cloud_below_its_table_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "cloud.npz", points=np.random.default_rng(0).uniform(0.01, 0.1, (500, 3)))
    with pytest.raises(InvalidInput, match="nothing of the object stands above the table"):
        read_target(tmp_path / "cloud.npz", Given(Plane(np.array([0.0, 0.0, -1.0]), 0.0)), nothing)


SCANS: dict[str, tuple[dict[str, Any], str]] = {
    "no beams": ({key: values[:0] for key, values in BEAMS.items()}, "no points or beams"),
    "no points": ({"points": np.zeros((0, 3))}, "no points or beams"),
    "ranges as objects": (BEAMS | {"ranges": BEAMS["ranges"].astype(object)}, "ranges holds Python objects"),
    "ranges as text": (BEAMS | {"ranges": BEAMS["ranges"].astype(str)}, "ranges holds <U32, not numbers"),
    "points of bool": ({"points": np.ones((9, 3), dtype=bool)}, "points holds bool, not numbers"),
}


@pytest.mark.parametrize("case", SCANS)
def test_a_scan_is_refused_for_what_is_wrong_in_it(tmp_path: Path, case: str) -> None:
    arrays, said = SCANS[case]
    np.savez(tmp_path / "scan.npz", **arrays)
    with pytest.raises(InvalidInput) as raised:
        read_scan(tmp_path / "scan.npz", LEVEL, nothing)
    assert f"scan.npz holds {said}" in str(raised.value) or f"scan.npz: {said}" in str(raised.value)


def test_a_target_without_points_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "cloud.npz", points=np.zeros((0, 3)))
    with pytest.raises(InvalidInput, match="holds no points"):
        read_target(tmp_path / "cloud.npz", Given(), nothing)


@pytest.mark.parametrize("shape", ["(50000001, 3)", "(3, 50000001)", f"({10**30}, 3)"])
def test_too_many_points_are_refused_by_the_header_before_they_are_unpacked(tmp_path: Path, shape: str) -> None:
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    with zipfile.ZipFile(tmp_path / "many.npz", "w") as archive:
        archive.writestr("points.npy", b"\x93NUMPY\1\0" + len(header).to_bytes(2, "little") + header.encode())
    with pytest.raises(TooLarge, match="the limit is 50000000 points"):
        read_target(tmp_path / "many.npz", Given(), nothing)
