"""`pretouch session`: what an orchestrator's sessions came to, in the terminal; watch, cancel or remove them."""

from __future__ import annotations

import typer

from pretouch.commands import SESSION_COMMANDS, add_commands, read_called_words
from pretouch.session_command import ending, overview, recording, report, watch

session = typer.Typer(help="The sessions of a running orchestrator.", no_args_is_help=True)
session.command("list")(overview.list_sessions)
session.command("show")(overview.show)
session.command("watch")(watch.watch)
session.command("report")(report.report)
session.command("recording")(recording.recording)
session.command("cancel")(ending.cancel)
session.command("purge")(ending.purge)
add_commands(session, SESSION_COMMANDS, read_called_words()[1])
