"""A folder of labelled views: depth images with scored rectangles.

    dataset.json            what it is: FORMAT, how the labels were made, seed, command
    train/<name>.npz        a view and its labels, one file each
    validation/<name>.npz

A file is written whole or not at all, so that a killed run can be resumed. LABELS.md beside the detector's README
documents the arrays.
"""

from __future__ import annotations

import json
import os
import struct
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pretouch.camera import Camera, DepthImage
from pretouch.errors import Conflict, InvalidInput, Malformed, NotFound, PretouchError
from pretouch.geometry import Array, Plane, Pose, frozen_array
from pretouch.scene import Scene
from pretouch.tof import Sensor

FORMAT = 2
DEPTH_UNIT = 1e-4
"""m: of a stored depth value."""
SIDES = ("train", "validation")
_DAMAGED = (
    AttributeError, EOFError, KeyError, IndexError, MemoryError, NotImplementedError, OSError, RuntimeError, TypeError,
    ValueError, struct.error, zipfile.BadZipFile, zlib.error, PretouchError,
)  # fmt: skip
"""What numpy, zipfile and json raise on truncated or altered files."""


@dataclass(frozen=True, eq=False)
class Example:
    """One view and the labels of its rectangles.

    Attributes:
        name: of the view, unique in its dataset.
        object: what is seen; all views of it are on one side.
        scene: the view, cropped around the object.
        sensor: what is stated of the finger that was simulated; only its ranges, noise and beam are kept.
        rectangles: (r, 5) as [x, y, w, h, theta], in the scene's pixels.
        scores: (r, t), m: each rectangle's error in each trial; NaN where the trial was not made.
        expected: (r, t), m: the engine's expected error after the trial; NaN if it states none.
        predicted: (r,), m: the registrar's prediction before any trial; NaN without one. Files call it
            `foreseen`.
        provenance: where the view comes from and how it was made.
    """

    name: str
    object: str
    scene: Scene
    sensor: Sensor
    rectangles: Array
    scores: Array
    expected: Array
    predicted: Array
    provenance: dict[str, Any]

    def __post_init__(self) -> None:
        rectangles = frozen_array(self.rectangles, (None, 5), "rectangles")
        scores, expected = np.asarray(self.scores, dtype=np.float64), np.asarray(self.expected, dtype=np.float64)
        predicted = np.asarray(self.predicted, dtype=np.float64)
        shapes = {"scores": scores.shape, "expected": expected.shape, "predicted": predicted.shape}
        r = len(rectangles)
        if scores.ndim != 2 or shapes != {"scores": scores.shape, "expected": (r, scores.shape[1]), "predicted": (r,)}:
            raise InvalidInput(f"{r} rectangles come with {shapes}.", "Give (r, t), (r, t) and (r,) numbers.")
        object.__setattr__(self, "rectangles", rectangles)
        object.__setattr__(self, "scores", scores)
        object.__setattr__(self, "expected", expected)
        object.__setattr__(self, "predicted", predicted)

    def compute_errors(self, worst: bool) -> Array:
        """(r,), m: each rectangle's error over its trials, NaN where none was made.

        Args:
            worst: take the worst trial, as in the paper, instead of the mean of the trials.
        """
        found = np.full(len(self.rectangles), np.nan)
        made = ~np.isnan(self.scores).all(axis=1)
        found[made] = (np.nanmax if worst else np.nanmean)(self.scores[made], axis=1)
        return found


class Dataset:
    """The folder.

    Args:
        folder: with a `dataset.json`.

    Raises:
        NotFound: no such folder, or it holds no dataset.
        Malformed: its description cannot be read.
        InvalidInput: it is of another version.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            self.description: dict[str, Any] = json.loads((folder / "dataset.json").read_text())
            version = self.description["format"]
        except FileNotFoundError as error:
            raise NotFound(
                f"{folder} holds no dataset: there is no dataset.json.", "Make one by `pretouch labels generate`."
            ) from error
        except (ValueError, KeyError, TypeError) as error:
            raise Malformed(
                f"{folder}/dataset.json cannot be read.", "Restore it, or make the dataset anew."
            ) from error
        if version != FORMAT:
            raise InvalidInput(
                f"{folder} is of format {version}; this version reads {FORMAT}.",
                "Make it anew by `pretouch labels generate`, or use the version that wrote it.",
            )

    @classmethod
    def create(cls, folder: Path, description: dict[str, Any]) -> Dataset:
        """Creates a dataset, or opens the one in the folder if its description is the same, apart from `command`.

        Raises:
            Conflict: the folder holds a dataset that was made otherwise.
        """
        wanted = {"format": FORMAT, **description}
        if (folder / "dataset.json").exists():
            dataset = cls(folder)
            begun = dataset.description
            differ = [
                key for key in wanted.keys() | begun.keys() if key != "command" and wanted.get(key) != begun.get(key)
            ]
            if differ:
                raise Conflict(
                    f"{folder} holds a dataset that was made with another {', '.join(sorted(differ))}.",
                    "Choose another folder, or the same settings to go on.",
                )
            return dataset
        folder.mkdir(parents=True, exist_ok=True)
        _write_whole(folder / "dataset.json", json.dumps(wanted, indent=1).encode() + b"\n")
        return cls(folder)

    @property
    def by_worst(self) -> bool:
        """Whether a rectangle is scored by its worst trial instead of the mean, which holds for the paper's labels."""
        return bool(self.description.get("recipe", {}).get("kind") == "trials")

    def path(self, side: str, name: str) -> Path:
        """Where the view `name` of that side is, or would be."""
        return self.folder / side / f"{name}.npz"

    def list_paths(self, side: str) -> list[Path]:
        """The files of one side, in the order of their names."""
        return sorted((self.folder / side).glob("*.npz"))

    def read_examples(self, side: str) -> Iterator[Example]:
        """All views of one side."""
        return (read(path) for path in self.list_paths(side))


def write(path: Path, example: Example) -> None:
    """Writes the view's file, whole or not at all."""
    scene = example.scene
    about = {"name": example.name, "object": example.object, "provenance": example.provenance}
    stored = np.rint(scene.depth.metres / DEPTH_UNIT)
    if stored.max() > np.iinfo(np.uint16).max:
        stored = np.where(stored > np.iinfo(np.uint16).max, 0, stored)
    camera, sensor = scene.camera, example.sensor
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    with draft.open("wb") as file:
        np.savez_compressed(
            file,
            depth=stored.astype(np.uint16),
            mask=scene.mask,
            camera=np.array([camera.fx, camera.fy, camera.cx, camera.cy]),
            base_T_camera=scene.base_T_camera.matrix,
            table=np.append(scene.table.normal, scene.table.offset),
            sensor=np.array([sensor.range_min, sensor.range_max, sensor.range_std, sensor.beam_half_angle]),
            rectangles=example.rectangles.astype(np.float32),
            scores=example.scores.astype(np.float32),
            expected=example.expected.astype(np.float32),
            foreseen=example.predicted.astype(np.float32),
            about=np.frombuffer(json.dumps(about).encode(), dtype=np.uint8),
        )
    draft.replace(path)


def read(path: Path) -> Example:
    """Reads a view's file.

    Raises:
        NotFound: there is none.
        Malformed: it is damaged, or not such a file.
    """
    if not path.is_file():
        raise NotFound(f"There is no {path}.", "Check the path.")
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            arrays: dict[str, NDArray[Any]] = {name: file[name] for name in file.files}
        about = json.loads(arrays["about"].tobytes())
        table = arrays["table"]
        scene = Scene(
            DepthImage(arrays["depth"].astype(np.float32) * np.float32(DEPTH_UNIT)),
            Camera(*arrays["camera"].tolist()),
            Pose(arrays["base_T_camera"]),
            arrays["mask"],
            Plane(table[:3], float(table[3])),
        )
        return Example(
            about["name"], about["object"], scene, Sensor(*arrays["sensor"].tolist()), arrays["rectangles"],
            arrays["scores"], arrays["expected"], arrays["foreseen"], about["provenance"],
        )  # fmt: skip
    except _DAMAGED as error:
        raise Malformed(
            f"{path} is damaged or no labelled view: {error}", "Delete it; `pretouch labels generate` makes it again."
        ) from error


def _write_whole(path: Path, data: bytes) -> None:
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    draft.write_bytes(data)
    draft.replace(path)
