"""`pretouch gateway`: watch a finger's ranges live, calibrate its modules and their mounts."""

from __future__ import annotations

import typer

from pretouch_sensor_gateway.command import calibrate, sweep, watch

gateway = typer.Typer(help="A finger at work: watch its ranges live, calibrate its modules.", no_args_is_help=True)
gateway.command("watch")(watch.watch)
gateway.command("calibrate")(calibrate.calibrate)
gateway.command("sweep")(sweep.sweep)
