"""What a camera's memory costs a new session: `python -m benchmarks.cameras [--sessions N]`.

Sessions of one camera end one after another, as the orchestrator stores their ends (here 100 in a transaction, to
spare the disk), with errors that differ by 2 mm and 0.4 deg from session to session. At some counts on the way:
ms of a processor that a new session takes to recall the camera (to read it; to estimate its calibration and predict,
which is not repeated in the process that has just done so), and kB of the SQLite file and its log.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "tests"))

from helpers.camera_ends import an_observation, camera_record, counted
from pretouch_orchestrator.calibration import estimate_calibration
from pretouch_orchestrator.cameras.findings import list_observations, predict_prior
from pretouch_orchestrator.store import camera_rows, camera_sql
from pretouch_orchestrator.store.database import Transaction
from pretouch_orchestrator.store.protocol import CameraUpdate
from pretouch_orchestrator.store.sql_store import SqlStore
from pretouch_orchestrator.store.sqlite import FILE_NAME, open_store

from pretouch.geometry import Pose

_BATCH, _TIMES = 100, 10
_COUNTS = (0, 1, 10, 100, 200, 1000, 10_000)


def end_of(number: int, rng: np.random.Generator) -> CameraUpdate:
    """The end of a session that finds the camera's error, 10 mm and 1 deg, and what differs from session to session."""
    turn, shift = rng.normal(0, np.radians(0.4), 3), rng.normal(0, 0.002, 3)
    found = Pose.from_rotation_vector(turn + np.radians(0.6), shift + 0.006)
    observation = replace(an_observation(f"s{number}", 1.7e9 + 60.0 * number), base_T_correction=found)
    update = counted(f"s{number}", 0, observation.at)
    return update._replace(entry=replace(update.entry, observation=observation))


async def store_ends(store: SqlStore, updates: list[CameraUpdate]) -> None:
    """Stores the ends of sessions in one transaction; the session "one" stands for all of them."""
    columns = [camera_rows.entry_columns(update) for update in updates]

    def work(tx: Transaction) -> None:
        (session,) = tx.execute("SELECT number FROM session WHERE id = 'one'")
        for entry in columns:
            (row,) = tx.execute("SELECT last FROM camera WHERE id = 'head'")
            camera_sql.store_entry(tx, session["number"], entry._replace(last=row["last"]))

    await store._database.write(work)


async def recall(store: SqlStore) -> tuple[float, float]:
    """ms of a processor to read the camera, and to estimate its calibration and predict."""
    began = time.process_time()
    memory = await store.load_camera("", "head")
    read = time.process_time()
    assert memory is not None
    calibration = estimate_calibration(list_observations(memory.counted))
    predict_prior(calibration, memory.base_T_camera, np.array([0.4, 0.3, 0.02]))
    return 1000 * (read - began), 1000 * (time.process_time() - read)


async def measure(sessions: int) -> None:
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as folder:
        async with open_store(folder) as store:
            await store.create("", camera_record("one"), [], None)
            done = 0
            print("sessions  read ms  estimate ms   file kB   (medians of", _TIMES, "times)")
            for count in (each for each in _COUNTS if each <= sessions):
                while done < count:
                    batch = min(_BATCH, count - done)
                    await store_ends(store, [end_of(done + k, rng) for k in range(batch)])
                    done += batch
                read, estimate = np.median([await recall(store) for _ in range(_TIMES)], axis=0)
                size = sum(os.stat(f"{folder}/{name}").st_size for name in (FILE_NAME, f"{FILE_NAME}-wal")) / 1000
                print(f"{count:8d} {read:8.1f} {estimate:12.1f} {size:9.0f}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sessions", type=int, default=_COUNTS[-1], help="as many as end at most")
    asyncio.run(measure(parser.parse_args().sessions))


if __name__ == "__main__":
    main()
