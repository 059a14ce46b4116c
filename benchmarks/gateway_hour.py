"""Prints what becomes of every measurement in an hour of faults: `python -m benchmarks.gateway_hour`."""

from __future__ import annotations

import argparse

from rich.console import Console
from rich.table import Table

from benchmarks.faulty_hour import Hour


def report(hour: Hour, console: Console) -> None:
    """The final count as a table."""
    table = Table(title=f"{hour.now / 3600:.2f} simulated hours, {hour.faults.total()} faults")
    table.add_column("what")
    table.add_column("count", justify="right")
    rows = {
        "sent": hour.sent,
        "delivered": hour.delivered,
        "reported lost": hour.reported,
        "quick subscriber: got": hour.quick.got,
        "quick subscriber: told lost": hour.quick.lost,
        "stopping subscriber: got": hour.slow.got,
        "stopping subscriber: told lost": hour.slow.lost,
        "stopping subscriber: told overrun": hour.slow.overrun,
        "epochs": hour.pipeline.epoch,
        "host clock jumps seen": hour.pipeline.clock.host_jumps,
        **{
            f"refused: {reason.name.lower()}": count for reason, count in sorted(hour.pipeline.refused.items(), key=str)
        },
        **{f"fault: {name}": count for name, count in sorted(hour.faults.items())},
    }
    for name, count in rows.items():
        table.add_row(name, str(count))
    console.print(table)
    console.print(f"worst error of a delivered time: {hour.worst_time_error * 1e3:.2f} ms")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    hour = Hour(arguments.seed)
    hour.run(arguments.hours * 3600.0)
    report(hour, Console())


if __name__ == "__main__":
    main()
