"""The simulation's ray caster beside Open3D and embreex, on the same rays: image, scan by a wide beam, closest points.

`python -m benchmarks.ray_casting [--meshes DIR [--limit N]]`, without DIR on the objects made in code. Each figure is
the mean over the objects of the median of five repeats; ratio is the peer's time over ours. Ours and embreex run on one
thread, Open3D on all. A peer that is not installed is named and left out.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from pretouch_simulation.bvh import Triangles
from pretouch_simulation.fingers.spot import Spot
from pretouch_simulation.mesh import Mesh, load_mesh
from pretouch_simulation.mesh_folder import meshes_in
from pretouch_simulation.objects import MAKERS
from pretouch_simulation.protocol import CAMERA, look_at

from benchmarks.open3d_loader import open3d
from pretouch.errors import Unavailable
from pretouch.geometry import Array

REPEATS = 5
_SCAN_POSES = 100
_SCAN_HEIGHT = 0.05
"""m above the object."""
_POINTS = 4000
_OFF_SURFACE = 0.003
"""m, standard deviation of a depth point from the mesh."""


class Caster(Protocol):
    """A mesh ready to be asked."""

    def cast(self, origins: Array, directions: Array) -> Array:
        """Distances (n,) of the first hits, inf = nothing."""

    def closest(self, points: Array) -> Array:
        """The closest places (n, 3); raises NotImplementedError where the library has no such query."""


class Ours:
    def __init__(self, mesh: Mesh) -> None:
        self._triangles = Triangles(mesh.vertices, mesh.faces)

    def cast(self, origins: Array, directions: Array) -> Array:
        return self._triangles.cast(origins, directions)[0]

    def closest(self, points: Array) -> Array:
        return self._triangles.closest(points)[0]


class Open3D:
    def __init__(self, mesh: Mesh) -> None:
        o3d = open3d()
        self._tensor = o3d.core.Tensor
        self._scene = o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(
            self._tensor(mesh.vertices.astype(np.float32)), self._tensor(mesh.faces.astype(np.uint32))
        )

    def cast(self, origins: Array, directions: Array) -> Array:
        rays = np.concatenate([origins, directions], axis=1).astype(np.float32)
        return np.asarray(self._scene.cast_rays(self._tensor(rays))["t_hit"].numpy())

    def closest(self, points: Array) -> Array:
        answer = self._scene.compute_closest_points(self._tensor(points.astype(np.float32)))
        return np.asarray(answer["points"].numpy())


class Embreex:
    def __init__(self, mesh: Mesh) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self._scene = EmbreeScene()
        TriangleMesh(self._scene, mesh.vertices.astype(np.float32), mesh.faces.astype(np.int32))

    def cast(self, origins: Array, directions: Array) -> Array:
        found = self._scene.run(origins.astype(np.float32), directions.astype(np.float32), output=True)
        return np.where(found["geomID"] < 0, np.inf, found["tfar"])

    def closest(self, points: Array) -> Array:
        raise NotImplementedError


class Questions(NamedTuple):
    """What each caster is asked about one mesh: rays (n, 3), (n, 3) of an image and of a scan, and points (n, 3)."""

    image: tuple[Array, Array]
    scan: tuple[Array, Array]
    points: Array


def measure(meshes: Iterable[Mesh] | None = None) -> dict[str, float]:
    """Milliseconds, ratios, and the largest differences of distances that both found."""
    asked = [(mesh, _questions(mesh)) for mesh in meshes or (make() for make in MAKERS.values())]
    ours = {name: _time_caster(Ours, asked, name) for name in ("image", "scan", "closest")}
    figures = {f"ours {name} ms": milliseconds for name, (milliseconds, _) in ours.items()}
    for peer in (Open3D, Embreex):
        try:
            peer(asked[0][0])
        except (ImportError, Unavailable) as error:
            print(f"skipped  {peer.__name__}: {error}", flush=True)
            continue
        for name, (milliseconds, answers) in ours.items():
            try:
                theirs, told = _time_caster(peer, asked, name)
            except NotImplementedError:
                continue
            figures[f"{peer.__name__} {name} ratio"] = theirs / milliseconds
            if name != "closest":
                both = np.isfinite(answers) & np.isfinite(told)
                figures[f"{peer.__name__} {name} hits differ"] = float(
                    (np.isfinite(answers) != np.isfinite(told)).sum()
                )
                figures[f"{peer.__name__} {name} max difference um"] = 1e6 * float(
                    np.abs(answers[both] - told[both]).max()
                )
    return figures


def _questions(mesh: Mesh) -> Questions:
    rng = np.random.default_rng(0)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    base_T_camera = look_at((low + high) / 2, 0.9, np.radians(45.0))
    v, u = np.indices((480, 640))
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], axis=-1).reshape(
        -1, 3
    )
    image = np.broadcast_to(base_T_camera.translation, rays.shape), base_T_camera.rotate(rays)
    beam, _ = Spot(float(np.radians(12.5))).rays()
    places = np.linspace([low[0], 0, high[2] + _SCAN_HEIGHT], [high[0], 0, high[2] + _SCAN_HEIGHT], _SCAN_POSES)
    scan = np.repeat(places, len(beam), axis=0), np.tile(beam * [1, 1, -1], (_SCAN_POSES, 1))
    chosen = mesh.vertices[mesh.faces[rng.integers(0, len(mesh.faces), _POINTS)]]
    points = np.einsum("nk,nki->ni", rng.dirichlet(np.ones(3), _POINTS), chosen)
    return Questions(image, scan, points + rng.normal(0, _OFF_SURFACE, points.shape))


def _time_caster(
    caster: Callable[[Mesh], Caster], asked: list[tuple[Mesh, Questions]], name: str
) -> tuple[float, Array]:
    """Milliseconds a mesh, which include building the caster for an image alone, and all answers."""
    seconds, answers = [], []
    for mesh, questions in asked:
        ready, times = caster(mesh), []
        for _ in range(REPEATS + 1):
            start = time.perf_counter()
            if name == "closest":
                answer = ready.closest(questions.points)
            elif name == "scan":
                answer = ready.cast(*questions.scan)
            else:
                answer = caster(mesh).cast(*questions.image)
            times.append(time.perf_counter() - start)
        seconds.append(np.median(times[1:]))
        answers.append(answer)
    return 1000 * float(np.mean(seconds)), np.concatenate(answers)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--meshes", type=Path, help="a folder of meshes instead of the objects made in code")
    parser.add_argument("--limit", type=int, help="the first N of them")
    given = parser.parse_args()
    meshes = [load_mesh(path) for path in meshes_in(given.meshes, limit=given.limit)] if given.meshes else None
    for figure, value in measure(meshes).items():
        print(f"{figure:36} {value:10.3f}")


if __name__ == "__main__":
    main()
