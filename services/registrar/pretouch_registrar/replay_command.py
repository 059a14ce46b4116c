"""`pretouch session replay`: what a recorded session's scans say again, or would have said with other settings."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table

from pretouch import __version__
from pretouch.prior import Prior
from pretouch.recording.session_file import SessionRecording, read_session_recording
from pretouch.results import STANDARD_OUTPUT, check_file, write_json
from pretouch.session_command.options import Json, open_console
from pretouch.session_command.wording import clean
from pretouch.wire.json import estimate_to_json
from pretouch_registrar.engines import Engine
from pretouch_registrar.registration import Registrar, Settings
from pretouch_registrar.replay import Replayed, read_recorded, replay


def replay_session(
    file: Annotated[Path, typer.Argument(help="A recording that `pretouch session recording` wrote.")],
    engine: Annotated[Engine | None, typer.Option(help="Another engine.", show_default="the recorded one")] = None,
    prior: Annotated[
        tuple[float, float] | None,
        typer.Option(
            metavar="M RAD",
            help="Another prior: standard deviations of translation and rotation per axis.",
            show_default="the recorded one",
        ),
    ] = None,
    range_std: Annotated[
        float | None, typer.Option(help="Another standard deviation of one range, m.", show_default="the recorded one")
    ] = None,
    range_bias_std: Annotated[
        float | None,
        typer.Option(help="The same of the error that a scan's ranges share, m.", show_default="the recorded one"),
    ] = None,
    beam_half_angle: Annotated[
        float | None,
        typer.Option(help="Another half angle of the beam's cone, rad.", show_default="the recorded one"),
    ] = None,
    json: Json = None,
) -> None:
    """Register a recorded session's scans again, one by one, also with another engine, prior or sensor."""
    if json is not None:
        check_file(json)
    recording = read_session_recording(file)
    recorded = read_recorded(recording)
    given = {"range_std": range_std, "range_bias_std": range_bias_std, "beam_half_angle": beam_half_angle}
    sensor: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    settings = replace(
        recorded.settings,
        engine=engine or recorded.settings.engine,
        prior=recorded.settings.prior if prior is None else Prior(*prior),
        sensor=replace(recorded.settings.sensor, **sensor),
    )
    console = open_console(json)
    replayed = list(replay(recorded, settings, Registrar()))
    same = engine is None and prior is None and not sensor
    here = describe_versions()
    if json is not None:
        write_json(json, _document(recording, settings, replayed, here))
    if json == STANDARD_OUTPUT:
        return
    if replayed:
        console.print(_tabulate(replayed))
    console.print(describe_result(replayed, same, dict(recording.session.versions), here), soft_wrap=True)
    if not recording.complete:
        console.print(f"{file} is cut off: scans after these may be missing.", soft_wrap=True)


def describe_versions() -> dict[str, str]:
    """Of what a replay's numbers depend on."""
    return {
        "pretouch": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "machine": platform.machine(),
    }


def describe_result(
    replayed: Sequence[Replayed], same: bool, recorded: Mapping[str, str], here: Mapping[str, str]
) -> str:
    """What came of it in a sentence or two.

    Args:
        same: whether the settings are the recorded ones.
        recorded, here: versions then and now.
    """
    if not replayed:
        return "The recording holds no scan: there is nothing to register."
    last = replayed[-1]
    moved = f"{1000 * last.distance:.2f} mm and {np.degrees(last.turn):.2f} deg from the recorded answer"
    if not same:
        return (
            f"With these settings the answer is {moved}: {1000 * last.estimate.expected_error:.2f} mm are expected, "
            f"{1000 * last.recorded.expected_error:.2f} mm were."
        )
    if all(each.identical for each in replayed):
        return f"All {len(replayed)} estimates are the recorded ones, to the bit."
    others = [
        f"{name} {clean(recorded.get(name, '?'))} then, {value} now"
        for name, value in here.items()
        if recorded.get(name) != value
    ]
    different = sum(not each.identical for each in replayed)
    why = f": {'; '.join(others)}" if others else ", though the versions are the same"
    return f"{different} of {len(replayed)} estimates are not the recorded ones to the bit{why}. The last is {moved}."


def _document(
    recording: SessionRecording, settings: Settings, replayed: Sequence[Replayed], here: Mapping[str, str]
) -> dict[str, Any]:
    return {
        "session": recording.session.session.id,
        "complete": recording.complete,
        "versions": {"recorded": dict(recording.session.versions), "here": dict(here)},
        "settings": {
            "engine": settings.engine.value,
            "prior": asdict(settings.prior),
            "sensor": {name: getattr(settings.sensor, name) for name in _SENSOR},
        },
        "identical": all(each.identical for each in replayed),
        "scans": [
            {
                "scan_id": each.scan_id,
                "samples": each.samples,
                "recorded": estimate_to_json(each.recorded, None),
                "replayed": estimate_to_json(each.estimate, None),
                "identical": each.identical,
                "distance": each.distance,
                "turn": each.turn,
                "seconds": each.seconds,
            }
            for each in replayed
        ],
    }


_SENSOR = ("range_min", "range_max", "range_std", "range_bias_std", "beam_half_angle")


def _tabulate(replayed: Sequence[Replayed]) -> Table:
    table = Table(box=SIMPLE_HEAD)
    table.add_column("scan")
    for title in ("samples", "recorded mm", "replayed mm", "moved mm", "turned deg", "same bits", "seconds"):
        table.add_column(title, justify="right")
    for each in replayed:
        table.add_row(
            clean(each.scan_id),
            str(each.samples),
            f"{1000 * each.recorded.expected_error:.2f}",
            f"{1000 * each.estimate.expected_error:.2f}",
            f"{1000 * each.distance:.2f}",
            f"{np.degrees(each.turn):.2f}",
            "yes" if each.identical else "no",
            f"{each.seconds:.2f}",
        )
    return table
