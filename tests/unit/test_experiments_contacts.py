"""The counts of contacts: what they are made from, and what is written."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import pytest
from helpers.made_frame import write_mesh
from pretouch_simulation.depth_cameras import CameraModel
from pretouch_simulation.objects import MAKERS

from experiments import contacts
from experiments.contacts import Flight, fly_scene, list_scenes, name_scene, write_results

ROWS = [
    {"scene": "clutter mug 0", "problem": "", "flights": [Flight(False, "ideal", 0, 0.04)._asdict()] * 3},
    {
        "scene": "clutter cup 0",
        "problem": "",
        "flights": [Flight(True, "vl6180x", 2, -0.001)._asdict(), Flight(True, "cone", 0, 0.02)._asdict()],
    },
    {"scene": "clutter pin 0", "problem": "The camera does not see pin.", "flights": []},
]


def test_contacts_are_named_and_counted_by_finger(tmp_path: Path) -> None:
    write_results(ROWS, tmp_path)
    answer = json.loads((tmp_path / "contacts.json").read_text())
    assert answer["scenes"] == 3
    assert answer["problems"] == ["clutter pin 0: The camera does not see pin."]
    (contact,) = answer["contacts"]
    assert (contact["scene"], contact["sensor"], contact["scan"]) == ("clutter cup 0", "vl6180x", 2)
    assert answer["clearance_mm"]["not guarded"]["all"] == {
        "scans": 3,
        "contacts": 0,
        "least": 40.0,
        "1st percentile": 40.0,
        "median": 40.0,
    }
    assert {name: kind["scans"] for name, kind in answer["clearance_mm"]["guarded"].items()} == {
        "all": 2,
        "vl6180x": 1,
        "cone": 1,
        "later scans": 1,
    }
    assert (tmp_path / "contacts.png").stat().st_size > 1000


def test_a_scene_is_flown_guarded_and_not_or_says_why_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contacts, "SESSION_SCANS", 1)
    for name in ("can", "box", "mug"):
        write_mesh(tmp_path / f"{name}.obj", MAKERS[name]())
    scenes = list_scenes(argparse.Namespace(meshes=tmp_path, split=None, frames=None, seed=0))
    assert len({name_scene(scene) for scene in scenes}) == 9
    row = fly_scene(0, scenes[0], CameraModel.KINECT, 0)
    assert row["problem"] == ""
    flights = [Flight(**flight) for flight in row["flights"]]
    assert {flight.guarded for flight in flights} == {False, True}
    assert {flight.sensor for flight in flights} == set(contacts.MODELS)
    assert sum(flight.scan == 1 for flight in flights) == 2
    assert min(flight.clearance for flight in flights) > 0
    (tmp_path / "can.obj").write_text("no mesh")
    (broken,) = (k for k, scene in enumerate(scenes[:3]) if scene.mesh == "can")
    assert fly_scene(0, scenes[broken], CameraModel.KINECT, 0)["problem"]
