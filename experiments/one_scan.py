"""The pose error after one scan of each of many rectangles of a view, averaged over hidden offsets.

All rectangles of a view are scanned under the same hidden offsets, so that they are comparable; noise differs.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from pretouch_detector.proposals import propose
from pretouch_detector.suppression import suppress_overlapping
from pretouch_detector.training import trials
from pretouch_registrar.engines import Engine
from pretouch_registrar.registration import Registrar, Settings
from pretouch_simulation.finger import FingerModel, realise
from pretouch_simulation.frames import frame_case, load_frame
from pretouch_simulation.labels import scans
from pretouch_simulation.labels.view import LabelView, view_of
from pretouch_simulation.mesh import load_mesh
from pretouch_simulation.objects import box
from pretouch_simulation.paper_setting import cut
from pretouch_simulation.protocol import case_of, draw_offset_about, generator, make_case

from pretouch.errors import PretouchError
from pretouch.geometry import Array, Pose
from pretouch.rectangle import ProposedRegion, RotatedRectangle
from pretouch.scene import Scene
from pretouch.session import Proposer
from pretouch.tof import Scan, Sensor

CANDIDATES = "candidates"
"""The subject of no proposer: random rectangles from which the oracle chooses."""
ALGORITHM_1 = "algorithm 1"
"""The subject whose regions are the best of a thousand by the paper's Algorithm 1, run on the view itself: the regions
that such labels would teach."""
PAPER = "paper"
_NAMES_IN_FILES = {"predicted": "foreseen"}
"""Members of a `Row` that have another name in files."""
_FIELDS = {name: field for field, name in _NAMES_IN_FILES.items()}
_SESSION_REGIONS = 20
"""The number of regions that a session asks its detector for; the first of them are scanned."""


@dataclass(frozen=True)
class Target:
    """A view of a mesh file, or an object of a real frame's file with a calibration error."""

    path: Path
    view: int
    thing: str = ""

    @property
    def object(self) -> str:
        return self.thing or self.path.stem

    @property
    def name(self) -> str:
        """The target's unique name."""
        return f"{self.path.stem} {self.thing} {self.view}" if self.thing else f"{self.path.stem} {self.view}"


@dataclass(frozen=True)
class Job:
    """One target scanned in one way along the rectangles of one subject.

    Attributes:
        setup: a `FingerModel`, the finger on the displaced mesh and engine `posterior`; "paper", the paper's own
            setting, the source cut out of the moved cloud and engine `paper`.
        subject: a proposer's name, CANDIDATES or ALGORITHM_1.
        count: rectangles; a proposer may give fewer.
        offsets: hidden calibration errors.
    """

    target: Target
    setup: str
    subject: str
    count: int
    offsets: int
    seed: int

    @property
    def key(self) -> tuple[str, str, str]:
        return self.target.name, self.setup, self.subject


@dataclass(frozen=True)
class Row:
    """The result of a job.

    Attributes:
        rectangles: in the scene's pixels, the best first.
        confidence: the proposer's, one a rectangle.
        errors: m, (r, offsets).
        initial: m, (offsets,): without a scan.
        predicted: m, (r,): what the registrar predicted; of CANDIDATES under a finger only, else empty.
        pathless: rectangles that cannot be scanned: their errors are the initial ones.
        problem: why there are no results, else empty.
    """

    target: str
    object: str
    view: int
    setup: str
    subject: str
    count: int
    offsets: int
    seed: int
    rectangles: list[list[float]]
    confidence: list[float]
    errors: list[list[float]]
    initial: list[float]
    predicted: list[float]
    pathless: int
    problem: str = ""

    @property
    def key(self) -> tuple[str, str, str]:
        return self.target, self.setup, self.subject

    @property
    def made(self) -> tuple[int, int]:
        """What the rows of one table have in common."""
        return self.offsets, self.seed

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Row:
        return cls(**{_FIELDS.get(name, name): value for name, value in values.items()})

    def as_dict(self) -> dict[str, Any]:
        return {_NAMES_IN_FILES.get(name, name): value for name, value in asdict(self).items()}


def run_job(job: Job) -> Row:
    """Runs the job; an error of pretouch's own becomes the row's `problem`."""
    about: dict[str, Any] = {
        **{"target": job.target.name, "object": job.target.object, "view": job.target.view},
        **{"setup": job.setup, "subject": job.subject, "count": job.count, "offsets": job.offsets, "seed": job.seed},
    }
    try:
        return Row(**about, **_run(job))
    except PretouchError as error:
        nothing: dict[str, Any] = {name: [] for name in ("rectangles", "confidence", "errors", "initial", "predicted")}
        return Row(**about, **nothing, pathless=0, problem=f"{error.detail} {error.remedy}".strip())


def prepare(setups: Sequence[str]) -> None:
    """Compiles and loads in advance what the first job needs."""
    view = view_of(case_of("warm-up", box(), 0, generator("warm-up")))
    v, u = np.argwhere(view.scene.mask).mean(axis=0)
    rectangles = [RotatedRectangle(u, v, 30, 30, 0)]
    for setup in setups:
        _scan_rectangles(view, rectangles, Job(Target(Path("warm-up"), 0), setup, CANDIDATES, 1, 1, 0))


@lru_cache(maxsize=6)
def load_view(target: Target, seed: int) -> LabelView:
    """The target as a session sees it, with its world.

    Raises:
        PretouchError: it cannot be read, or is not seen.
    """
    if target.thing:
        return view_of(frame_case(load_frame(target.path), target.thing, target.view))
    return view_of(make_case(target.path.stem, load_mesh(target.path), target.view, seed))


def propose_first(scene: Scene, proposer: Proposer, sensor: Sensor, count: int) -> list[ProposedRegion]:
    """The first `count` regions that a session on this scene would be given.

    Raises:
        Unavailable: the proposer is not ready.
    """
    seed = zlib.crc32(scene.depth.metres.tobytes())
    return propose(scene, proposer, sensor, max(count, _SESSION_REGIONS), seed).regions[:count]


def _run(job: Job) -> dict[str, Any]:
    view = load_view(job.target, job.seed)
    sensor = _make_scoring(job).finger.sensor
    ask = job.subject == CANDIDATES and job.setup != PAPER
    if job.subject == ALGORITHM_1:
        regions = _best_by_labels(view.scene, job)
    else:
        proposer = Proposer.RANDOM if job.subject == CANDIDATES else Proposer(job.subject)
        regions = propose_first(view.scene, proposer, sensor, job.count)
    rectangles = [region.rectangle for region in regions]
    errors, predicted, pathless = _scan_rectangles(view, rectangles, job, ask)
    cloud, truths = view.case.cloud, _truths(view, job)
    return {
        "rectangles": [np.round(rectangle.as_list(), 4).tolist() for rectangle in rectangles],
        "confidence": [round(region.confidence, 5) for region in regions],
        "errors": np.round(errors, 7).tolist(),
        "initial": [round(scans.mean_error(cloud, truth, Pose.identity()), 7) for truth in truths],
        "predicted": np.round(predicted, 7).tolist(),
        "pathless": pathless,
    }


def _best_by_labels(scene: Scene, job: Job) -> list[ProposedRegion]:
    rng = generator("algorithm 1", job.seed, job.target.name)
    rectangles, scores = trials.label_scene(scene, trials.Settings(), rng, threads=1)
    ranked = rectangles[np.argsort(scores.max(axis=1), kind="stable")]
    return [ProposedRegion(RotatedRectangle(*ranked[k]), 0.5) for k in suppress_overlapping(ranked, job.count)]


def _make_scoring(job: Job) -> scans.Scoring:
    model = FingerModel.IDEAL if job.setup == PAPER else FingerModel(job.setup)
    return scans.Scoring(finger=realise(model, generator("finger-model", job.seed, job.target.name)))


def _truths(view: LabelView, job: Job) -> list[Pose]:
    names = ("hidden offset", job.seed, job.target.name)
    return [draw_offset_about(view.scene.centroid, generator(*names, k)) for k in range(job.offsets)]


def _scan_rectangles(
    view: LabelView, rectangles: Sequence[RotatedRectangle], job: Job, ask: bool = False
) -> tuple[Array, Array, int]:
    """Errors (r, o), m, the predicted errors (r,), m, and how many rectangles have no path."""
    errors = np.full((len(rectangles), job.offsets), np.nan)
    scoring = _make_scoring(job)
    paths = [None] * len(rectangles) if job.setup == PAPER else scans.paths_of(view, rectangles, scoring)
    for o, truth in enumerate(_truths(view, job)):
        for k, rectangle in enumerate(rectangles):
            rng = generator("one scan", *job.key, job.seed, k, o)
            if job.setup == PAPER:
                errors[k, o] = _scan_by_cutting(view, rectangle, truth, rng)
            else:
                errors[k, o], _ = scans.scan_and_register(view, paths[k], truth, scoring, rng)
    predicted = scans.predict_errors(view, paths, scoring) if ask else np.zeros(0)
    return errors, predicted, 0 if job.setup == PAPER else paths.count(None)


def _scan_by_cutting(view: LabelView, rectangle: RotatedRectangle, truth: Pose, rng: np.random.Generator) -> float:
    """m: the paper's own setting; the whole object counts, not only what was cut out."""
    scene = view.scene
    points = cut(view.case, truth.apply(scene.cloud), rectangle.shifted(*view.origin), rng)
    scan = Scan.of_points(points, -scene.table.normal)
    estimate = Registrar().register(scene, [scan], Settings(Engine.PAPER))
    return scans.mean_error(view.case.cloud, truth, estimate.base_T_correction)
