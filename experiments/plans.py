"""How soon plans see and converge: evaluations of the same sessions by several planners, side by side.

    python -m experiments.plans BEFORE AFTER [..] [--tolerance 0.003] [--out docs/results]

Each folder holds the rows of `pretouch evaluate --tolerance`, a .json for each world; its name is the label of what
planned. Files of the same name are compared, over the sessions that all of them hold. Writes plans.md and plans.png.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from pretouch_simulation.evaluation_convergence import is_within
from pretouch_simulation.markdown import markdown_table

from experiments.command_line import command_of, run_or_exit
from experiments.folders import RESULTS
from experiments.plans_picture import save_picture
from experiments.plans_sessions import Key, PlannedSession, sessions_of
from pretouch.errors import InvalidInput, Malformed, NotFound
from pretouch.session import Tolerance
from pretouch.trajectory import APPROACH_SECONDS

Comparison = Mapping[str, Sequence[PlannedSession]]
"""The sessions of one world by what planned them; the same ones, in the same order."""
_CM = 100.0
_HEADINGS = (
    *("plans", "n", "converged", "of those within", "s median", "s p90", "returns of scan 1"),
    *("error cm after 1: mean", "median", "after 3: mean", "median", "after the last: mean", "median", "in 95 %"),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--tolerance", type=float, default=Tolerance().error)
    parser.add_argument("--out", type=Path, default=RESULTS)
    run_or_exit(parser.parse_args(), run)


def run(arguments: argparse.Namespace) -> None:
    """Writes both files.

    Raises:
        PretouchError: fewer than two folders, one that holds no rows, or no world that two of them have in common.
    """
    folders: list[Path] = arguments.folders
    if len({folder.name for folder in folders}) < max(2, len(folders)):
        raise InvalidInput("There is nothing to compare.", "Give two folders or more, of different names.")
    worlds = compare({folder.name: read_folder(folder) for folder in folders})
    out: Path = arguments.out
    out.mkdir(parents=True, exist_ok=True)
    save_picture(worlds, out / "plans.png")
    (out / "plans.md").write_text(format_page(command_of("plans"), worlds, arguments.tolerance))
    print((out / "plans.md").read_text())


def read_folder(folder: Path) -> dict[str, dict[Key, PlannedSession]]:
    """By world, the stem of the file: its sessions.

    Raises:
        NotFound: the folder holds no .json file.
        Malformed: a file does not hold rows of an evaluation.
    """
    paths = sorted(folder.glob("*.json"))
    if not paths:
        raise NotFound(f"{folder} holds no .json file.", "Give a folder of what pretouch evaluate --json wrote.")
    found = {}
    for path in paths:
        try:
            found[path.stem] = sessions_of(json.loads(path.read_text())["rows"])
        except (ValueError, KeyError, TypeError) as error:
            raise Malformed(f"{path} holds no rows: {error!r}.", "Make it by pretouch evaluate --json.") from error
    return found


def compare(labelled: Mapping[str, Mapping[str, Mapping[Key, PlannedSession]]]) -> dict[str, Comparison]:
    """By world, in which two labels or more have sessions in common: those sessions of each label.

    Raises:
        InvalidInput: there is none.
    """
    worlds: dict[str, Comparison] = {}
    for world in sorted({world for by_world in labelled.values() for world in by_world}):
        having = {label: by_world[world] for label, by_world in labelled.items() if world in by_world}
        shared = sorted(set.intersection(*(set(sessions) for sessions in having.values())))
        if len(having) > 1 and shared:
            worlds[world] = {label: [sessions[key] for key in shared] for label, sessions in having.items()}
    if not worlds:
        raise InvalidInput(
            "No two of the folders have sessions in common.", "Evaluate the same worlds into files of the same names."
        )
    return worlds


def format_page(command: str, worlds: Mapping[str, Comparison], tolerance: float) -> str:
    """The page: what was compared, a table for each world, and the picture."""
    parts = [
        "# Plans side by side\n",
        f"Made by `{command}`. Sessions by `pretouch evaluate --tolerance {tolerance:g}`, default budgets; of each "
        "world those that all of the compared evaluations hold.\n",
        f"`s`: robot seconds of the sessions that converged, with {APPROACH_SECONDS:g} s for the way to each scan. "
        f"`within`: truly within {1000 * tolerance:g} mm, on real frames after fitting and 2 mm more. Errors are over "
        "all sessions; one that ended keeps its last. `returns`: median share of the first scan's samples. `in 95 %`: "
        "truths in the stated region after the last scan.\n",
    ]
    for world, comparison in worlds.items():
        lines = [[label, *describe(sessions, tolerance)] for label, sessions in comparison.items()]
        parts.append(f"## {world}\n\n{markdown_table(_HEADINGS, lines)}")
    parts.append("![Convergence, first returns and error over robot seconds](plans.png)\n")
    return "\n".join(parts)


def describe(sessions: Sequence[PlannedSession], tolerance: float) -> list[str]:
    """The cells of one line, without its label."""
    ends = [session.last for session in sessions if session.converged]
    within = [is_within(row["error"], row.get("error_fitted"), tolerance) for row in ends]
    seconds = [session.seconds[-1] for session in sessions if session.converged]
    returns = [session.rows[0]["returns"] for session in sessions]
    cells = [str(len(sessions)), f"{len(ends) / len(sessions):.0%}", f"{np.mean(within):.0%}" if within else ""]
    cells += [f"{np.quantile(seconds, level):.1f}" if seconds else "" for level in (0.5, 0.9)]
    cells.append(f"{np.median(returns):.0%}")
    for scan in (1, 3, None):
        errors = [_CM * session.error_after(scan) for session in sessions]
        cells += [f"{np.mean(errors):.2f}", f"{np.median(errors):.2f}"]
    return [*cells, f"{np.mean([session.last['covered'] for session in sessions]):.0%}"]


if __name__ == "__main__":
    main()
