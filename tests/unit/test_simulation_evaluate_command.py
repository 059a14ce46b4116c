"""`pretouch evaluate` refuses incompatible options before it starts."""

from pathlib import Path

import pytest
import typer
from pretouch_simulation import evaluate_command
from pretouch_simulation.evaluate_command import evaluate
from pretouch_simulation.evaluation_protocol import NEVER_CONVERGED, Protocol
from pretouch_simulation.evaluation_rows import Run

from pretouch.errors import InvalidInput


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ([], "Neither --meshes nor --frames"),
        (["--meshes", ".", "--frames", "."], "Both --meshes and --frames"),
        (["--meshes", ".", "--seeds", "2"], "--seeds cannot go with --meshes"),
        (["--frames", ".", "--views", "2", "--camera", "kinect"], "--views, --camera cannot go with --frames"),
        (["--frames", ".", "--paper-setting"], "--paper-setting cannot go with --frames"),
        (["--frames", ".", "--clutter"], "--clutter cannot go with --frames"),
    ],
)
def test_options_that_do_not_fit_each_other_are_refused(options: list[str], said: str, tmp_path: Path) -> None:
    app = typer.Typer()
    app.command()(evaluate)
    with pytest.raises(InvalidInput) as refused:
        app([*options, "--json", str(tmp_path / "out.json")], standalone_mode=False)
    assert said in refused.value.detail
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("option", ["--json", "--details"])
def test_a_place_that_cannot_be_written_is_refused_before_the_first_run(option: str, tmp_path: Path) -> None:
    (tmp_path / "mug.obj").write_text("v 0 0 0\nv 0.1 0 0\nv 0 0.1 0.1\nf 1 2 3\n")
    app = typer.Typer()
    app.command()(evaluate)
    places = {"--json": str(tmp_path / "out.json"), option: "/proc/out.json"}
    with pytest.raises(InvalidInput, match=r"/proc/out\.json cannot be written"):
        app(["--meshes", str(tmp_path), *(word for pair in places.items() for word in pair)], standalone_mode=False)
    assert not list(tmp_path.glob("*.partial"))


@pytest.mark.parametrize(
    ("options", "budget"),
    [
        ([], (5, 1e6, 1.0, NEVER_CONVERGED)),
        (["--tolerance", "0.003"], (10, 120.0, 0.3, 0.003)),
        (["--tolerance", "0.003", "--scans", "4"], (4, 120.0, 0.3, 0.003)),
    ],
)
def test_sessions_with_a_tolerance_have_default_budgets(
    options: list[str], budget: tuple[float, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mug.obj").touch()
    found = []

    def note(tasks: object, protocols: list[Protocol], *_: object) -> list[Run]:
        found.extend(protocols)
        return []

    monkeypatch.setattr(evaluate_command, "run_with_progress", note)
    app = typer.Typer()
    app.command()(evaluate)
    app(["--meshes", str(tmp_path), "--json", str(tmp_path / "out.json"), *options], standalone_mode=False)
    (one,) = found
    assert (one.scans, one.seconds, one.fraction, one.tolerance) == budget


def test_a_mesh_without_others_has_no_clutter(tmp_path: Path) -> None:
    (tmp_path / "mug.obj").touch()
    app = typer.Typer()
    app.command()(evaluate)
    with pytest.raises(InvalidInput, match="There is no other mesh"):
        app(["--meshes", str(tmp_path), "--json", str(tmp_path / "o.json"), "--clutter"], standalone_mode=False)
