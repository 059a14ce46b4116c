"""`pretouch camera`: cameras that calibrate themselves; list them, see what is known, export it, or forget it."""

from __future__ import annotations

import typer

from pretouch.camera_command import outcome, overview

camera = typer.Typer(help="The cameras that sessions of a running orchestrator have named.", no_args_is_help=True)
camera.command("list")(overview.list_cameras)
camera.command("show")(overview.show)
camera.command("forget")(outcome.forget)
camera.command("export")(outcome.export)
