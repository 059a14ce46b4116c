"""A program that records, to be killed, ended or starved of disk: `gateway_recording_child.py MODE FOLDER`.

- `loop`: records one frame after another and says on each line how many it handed over and how many are recorded.
- `serve`: records, says "recording" once frames are recorded, and ends properly on SIGTERM.
- `starve`: may write no file beyond 40 kB for a while; then there is no limit.

`serve` and `starve` say at their end, as JSON, how many frames were given and what the status says.
"""

from __future__ import annotations

import asyncio
import json
import resource
import signal
import sys
import time
from dataclasses import asdict
from pathlib import Path

import structlog
from pretouch_sensor_gateway.recording.limits import Limits
from pretouch_sensor_gateway.recording.recorder import Recorder
from pretouch_sensor_gateway.recording.writer import RecordingWriter

from helpers.gateway_recordings import T0, made_batch, made_configuration


def loop(folder: Path) -> None:
    with RecordingWriter(folder, structlog.get_logger(), Limits(file_bytes=128 * 1024), commit_every=0.0) as writer:
        recorder = started(writer)
        given = 0
        while True:
            recorder.record_batch(made_batch(given))
            given += 1
            while (status := recorder.status()).pending > 200:
                time.sleep(0.001)
            print(given, status.measurements, status.unrecorded, flush=True)


async def serve(folder: Path) -> None:
    end = asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, end.set)
    given, said = 0, False
    with RecordingWriter(folder, structlog.get_logger()) as writer:
        recorder = started(writer)
        while not end.is_set():
            recorder.record_batch(made_batch(given))
            given += 1
            if recorder.status().measurements and not said:
                said = True
                print("recording", flush=True)
            await asyncio.sleep(0.001)
    print(json.dumps({"given": given} | asdict(recorder.status())))


def starve(folder: Path) -> None:
    now, given = 0.0, 0
    problems = []
    with RecordingWriter(folder, structlog.get_logger(), clock=lambda: now, commit_every=0.0) as writer:
        recorder = started(writer)
        resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, resource.RLIM_INFINITY))
        for now in range(100):
            if now == 60:
                resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
            for _ in range(20):
                recorder.record_batch(made_batch(given))
                given += 1
            while recorder.status().pending:
                time.sleep(0.001)
            problems.append(recorder.status().problem)
    print(json.dumps({"given": given, "problems": problems} | asdict(recorder.status())))


def started(writer: RecordingWriter) -> Recorder:
    recorder = writer.create_recorder("left")
    recorder.record_configuration(made_configuration(), T0)
    recorder.start()
    return recorder


if __name__ == "__main__":
    structlog.configure(logger_factory=structlog.PrintLoggerFactory(sys.stderr))
    mode, folder = sys.argv[1], Path(sys.argv[2])
    if mode == "serve":
        asyncio.run(serve(folder))
    else:
        {"loop": loop, "starve": starve}[mode](folder)
