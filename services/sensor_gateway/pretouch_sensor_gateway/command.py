"""A finger at work: watch its ranges live, calibrate its modules."""

from __future__ import annotations

import typer

from pretouch_sensor_gateway.calibration.command import calibrate
from pretouch_sensor_gateway.watch.command import watch

gateway = typer.Typer(help="A finger at work: watch its ranges live, calibrate its modules.", no_args_is_help=True)
gateway.command("watch")(watch)
gateway.command("calibrate")(calibrate)
