"""`pretouch session`: what an orchestrator's sessions came to, in the terminal; watch, cancel or remove them."""

from __future__ import annotations

import typer

from pretouch.session_command import ending, overview, report, watch

session = typer.Typer(help="The sessions of a running orchestrator.", no_args_is_help=True)
session.command("list")(overview.list_sessions)
session.command("show")(overview.show)
session.command("watch")(watch.watch)
session.command("report")(report.report)
session.command("cancel")(ending.cancel)
session.command("purge")(ending.purge)
