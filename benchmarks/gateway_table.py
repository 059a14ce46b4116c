"""The gateway's figures for a reader."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.table import Table


def show(document: dict[str, Any], console: Console) -> None:
    """Prints all that was measured."""
    machine = document["machine"]
    console.print(
        f"{machine['cpu']}, {machine['cores']} cores, load {machine['load_before']:.1f} before and "
        f"{machine['load_after']:.1f} after; seed {document['seed']}, {document['seconds']:.0f} s"
    )
    latency = _table(
        "Last byte written to batch in hand, us", "Hz", "n", "", "gateway", "pyserial", "gRPC stream", "ratio"
    )
    for row in document["latency"]:
        for name in ("p50", "p99"):
            values = [f"{row[name][part]:.0f}" for part in ("gateway", "pyserial", "gRPC stream")]
            latency.add_row(f"{row['rate_hz']:g}", str(row["n"]), name, *values, f"{row[name]['ratio']:.2f}")
    console.print(latency, "ratio: gateway / (pyserial + gRPC stream), median of the rounds")
    rate = _table("Highest rate without loss, one device", "reader", "frames/s", "held", "beyond it")
    for row in document["rate"]:
        rate.add_row(row["reader"], f"{row['highest_hz']:,.0f}", f"{row['held_s']:g} s", row["beyond"])
    console.print(rate)
    cost = _table("Cost at 30 Hz", "devices", "", "% of a core", "us a frame", "RSS MB", "USS MB")
    for row in document["cost"]:
        share, frame = f"{100 * row['core_share']:.1f}", f"{row['us_per_frame']:.0f}"
        memory = ["-" if row[name] is None else f"{row[name]:.1f}" for name in ("rss_mb", "uss_mb")]
        cost.add_row(str(row["devices"]), row["what"], share, frame, *memory)
    console.print(cost)
    soak = document["soak"]
    if soak is not None:
        console.print(_soak(soak))


def _soak(soak: dict[str, Any]) -> Table:
    title = (
        f"{soak['devices']} devices at {soak['rate_hz']:g} Hz, listened to and recorded, for {soak['seconds']:.0f} s"
    )
    table = _table(title, "", "")
    for name, value in (
        ("frames sent, delivered", f"{soak['sent']:,}, {soak['delivered']:,}"),
        ("frames lost, not recorded", f"{soak['lost']}, {soak['unrecorded']}"),
        ("recorded", f"{soak['recorded_mb']:.1f} MB"),
        ("share of a core", f"{100 * soak['core_share']:.1f} %"),
        ("RSS, first minute, last minute", f"{soak['first_minute_mb']:.1f} MB, {soak['last_minute_mb']:.1f} MB"),
        (f"slope after {soak['warm_up_s']:.0f} s", f"{soak['slope_kb_per_minute']:.0f} kB/min"),
        ("of which the history's", f"{soak['history_kb_per_minute']:.0f} kB/min, none after ten minutes"),
        ("all the rest", f"{soak['slope_without_history_kb_per_minute']:.0f} kB/min"),
    ):
        table.add_row(name, value)
    return table


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left")
    for column in columns:
        table.add_column(column, justify="left" if column in ("", "reader", "beyond it") else "right")
    return table
