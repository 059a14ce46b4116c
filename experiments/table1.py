"""The paper's Table 1, in its own setting and in the real one, with the oracle beside it.

    python -m experiments.table1 [--meshes DIR] [--proposers random narf stability deep] [--views 2] [--offsets 4]
        [--settings real paper] [--sensors ideal vl6180x] [--candidates 60] [--oracle ideal paper] [--oracle-views 1]
        [--out docs/results]

Each of a proposer's first ten rectangles on each view of each mesh is scanned alone with `--offsets` hidden calibration
errors. On the first `--oracle-views` views so are `--candidates` random rectangles, for the oracle, and in the
paper's setting the ten that its own Algorithm 1 finds best on the view itself. Writes table1.md,
table1.json (every error) and table1.png. DIR is data/meshes/table1 of PRETOUCH_SHARED unless given. A run that was
stopped goes on when it is started again. Rows of an earlier table1.json stay in it where they fit beside this run's:
another proposer, setting or sensor can be added later.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

from pretouch_simulation.finger import FingerModel
from pretouch_simulation.mesh_folder import meshes_in
from pretouch_simulation.partial_rows import PartialRows
from pretouch_simulation.split import Split

from experiments.collecting import PROPOSERS, jobs_of, run_jobs, split_by_readiness
from experiments.command_line import command_of, run_resumable
from experiments.folders import SHARED
from experiments.one_scan import ALGORITHM_1, CANDIDATES, PAPER, Job, Row, Target
from experiments.one_scan_picture import save
from experiments.one_scan_text import section
from pretouch.errors import InvalidInput, Malformed
from pretouch.session import Proposer

FIRST = 10
SETTINGS = ("real", PAPER)
SENSORS = (FingerModel.IDEAL, FingerModel.VL6180X)
_ORDER = (CANDIDATES, *PROPOSERS, ALGORITHM_1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--meshes", type=Path, default=SHARED / "data" / "meshes" / "table1")
    parser.add_argument("--split", type=Split, choices=list(Split))
    parser.add_argument("--limit", type=int)
    parser.add_argument("--proposers", type=Proposer, nargs="+", choices=list(Proposer), default=list(PROPOSERS))
    parser.add_argument("--views", type=int, default=2)
    parser.add_argument("--offsets", type=int, default=4)
    parser.add_argument("--settings", nargs="+", choices=SETTINGS, default=list(SETTINGS))
    parser.add_argument("--sensors", type=FingerModel, nargs="+", choices=list(FingerModel), default=SENSORS)
    parser.add_argument("--candidates", type=int, default=60, help="0: no oracle")
    parser.add_argument("--oracle", nargs="*", choices=[*FingerModel, PAPER], default=[FingerModel.IDEAL, PAPER])
    parser.add_argument("--oracle-views", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    run_resumable(parser, run)


def run(arguments: argparse.Namespace) -> None:
    """Runs the jobs and writes everything into `arguments.out`."""
    if min(arguments.views, arguments.offsets) < 1 or arguments.candidates < 0:
        raise InvalidInput("There is nothing to scan.", "Give at least one view and one offset.")
    proposers, missing = split_by_readiness(arguments.proposers)
    jobs = jobs_for(arguments, proposers)
    settings = {"offsets": arguments.offsets, "seed": arguments.seed, "candidates": arguments.candidates}
    out: Path = arguments.out
    kept = PartialRows(out / "table1.partial", settings)
    rows = run_jobs(jobs, arguments.workers, kept, "table 1")
    if not any(row.errors for row in rows):
        raise InvalidInput("Nothing could be scanned.", "Give meshes that can be seen; the reasons are above.")
    command = command_of("table1")
    earlier, commands = read_fitting_rows(out / "table1.json", rows, jobs)
    rows = sorted([*earlier, *rows], key=lambda row: (row.target, _ORDER.index(row.subject)))
    commands = list(dict.fromkeys([*commands, command]))
    setups = [setup for setup in _setups(SETTINGS, list(FingerModel)) if any(row.setup == setup for row in rows)]
    content = {"commands": commands, "not_ready": missing, "rows": [row.as_dict() for row in rows]}
    (out / "table1.json").write_text(json.dumps(content) + "\n")
    text = [
        f"# One scan of each of the first {FIRST} proposals\n\nMade by `{'`, then `'.join(commands)}`. Errors in cm.\n"
    ]
    text += [section(rows, setup, _find_missing(rows, setup, missing)) for setup in setups]
    save([row for setup in setups for row in rows if row.setup == setup], out / "table1.png")
    text.append("![Errors by object](table1.png)\n")
    (out / "table1.md").write_text("\n".join(text))
    kept.remove()
    print("\n".join(text))


def jobs_for(arguments: argparse.Namespace, proposers: Sequence[Proposer]) -> list[Job]:
    """The jobs, those of a view together, since a worker caches the last few views."""
    jobs = []
    for view in range(arguments.views):
        for path in meshes_in(arguments.meshes, limit=arguments.limit, split=arguments.split):
            for setup in _setups(arguments.settings, arguments.sensors):
                wanted = setup in arguments.oracle and view < arguments.oracle_views
                candidates = arguments.candidates if wanted else 0
                target = Target(path, view)
                jobs += jobs_of(target, setup, proposers, arguments.offsets, arguments.seed, FIRST, candidates)
                if candidates and setup == PAPER:
                    jobs.append(Job(target, setup, ALGORITHM_1, FIRST, arguments.offsets, arguments.seed))
    return jobs


def _setups(settings: Sequence[str], sensors: Sequence[FingerModel]) -> list[str]:
    real = [sensor.value for sensor in sensors] if "real" in settings else []
    return [*real, PAPER] if PAPER in settings else real


def read_fitting_rows(path: Path, rows: Sequence[Row], jobs: Sequence[Job]) -> tuple[list[Row], list[str]]:
    """Reads the rows of an earlier run that fit beside the new ones, and its commands; neither if none fit.

    Rows on other objects do not fit, nor do rows that were repeated, or have other offsets or other views.

    Raises:
        Malformed: the earlier run's file cannot be read.
    """
    if not path.exists():
        return [], []
    try:
        content = json.loads(path.read_text())
        every = [Row.from_dict(values) for values in content["rows"]]
        commands = list(content["commands"])
    except (ValueError, KeyError, TypeError) as error:
        raise Malformed(f"{path} is not a table of this version.", "Delete it, or choose another --out.") from error
    made = {row.setup: row.made for row in rows}
    keys, objects = {row.key for row in rows}, {job.target.object for job in jobs}
    views = {(job.setup, job.target.name) for job in jobs}
    found = [
        row
        for row in every
        if row.key not in keys
        and row.object in objects
        and (row.setup not in made or (row.made == made[row.setup] and (row.setup, row.target) in views))
    ]
    return found, commands if found else []


def _find_missing(rows: Sequence[Row], setup: str, missing: dict[str, str]) -> dict[str, str]:
    there = {row.subject for row in rows if row.setup == setup}
    return {name: reason for name, reason in missing.items() if name not in there}


if __name__ == "__main__":
    main()
