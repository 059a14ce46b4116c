"""The least error of registering a finger's scans to a camera's image, whose own errors no finger can correct.

    python -m experiments.camera_floor MESHES [--limit 20] [--seed 0]

A depth camera's surface is off by millimetres, rigid in part. The camera's points of each validation mesh, at their
true place, are fitted onto the true mesh (`fit_truth`), as if a finger had measured all of it without error. The
motion that this takes is a lower bound for any registration of the image. The views are those of `pretouch evaluate
--split validation --views 1`. Fitted with a prior of 3 mm and 1 deg, the bound is a low estimate.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from pretouch_simulation.depth_cameras import CameraModel
from pretouch_simulation.fitted_truth import fit_truth
from pretouch_simulation.markdown import markdown_table
from pretouch_simulation.mesh import load_mesh
from pretouch_simulation.mesh_folder import meshes_in
from pretouch_simulation.protocol import make_case
from pretouch_simulation.split import Split
from rich.progress import track

from experiments.command_line import run_or_exit


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", type=Path)
    parser.add_argument("--limit", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    run_or_exit(parser.parse_args(), run)


def run(arguments: argparse.Namespace) -> None:
    """Prints the table."""
    paths = meshes_in(arguments.meshes, (), arguments.limit, Split.VALIDATION)
    lines = []
    for camera in CameraModel:
        cm = 100 * np.array(_measure_floors(paths, arguments.seed, camera))
        figures = (cm.mean(), np.median(cm), np.percentile(cm, 95))
        lines.append([camera.value, str(len(cm)), *(f"{figure:.2f}" for figure in figures)])
    print(markdown_table(["camera", "n", "mean, cm", "median", "p95"], lines), end="")


def _measure_floors(paths: list[Path], seed: int, camera: CameraModel) -> list[float]:
    cases = (make_case(path.stem, load_mesh(path), 0, seed, camera) for path in paths)
    return [case.error(fit_truth(case)) for case in track(cases, f"{camera}", total=len(paths))]


if __name__ == "__main__":
    main()
