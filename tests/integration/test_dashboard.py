"""The Grafana dashboard asks for metrics that the services export, and for nothing else."""

from __future__ import annotations

import json
import re
from pathlib import Path

import httpx
from prometheus_client import generate_latest

from pretouch.serving import ServiceContext, Settings

DASHBOARD = Path(__file__).parents[2] / "deploy" / "grafana" / "pretouch.json"
FUNCTIONS = {"histogram_quantile", "sum", "rate", "increase", "by", "label_values"}


def names(exposition: str) -> set[str]:
    """What a query may call the metrics of this page."""
    found = set()
    for name, kind in re.findall(r"^# TYPE (\S+) (\S+)$", exposition, re.MULTILINE):
        found |= {f"{name}_{part}" for part in ("bucket", "sum", "count")} if kind == "histogram" else {name}
    return found


def test_every_metric_of_the_dashboard_is_exported(rest: httpx.Client) -> None:
    exported = names(rest.get("/metrics").text)
    for service in ("registrar", "detector", "gateway"):
        exported |= names(generate_latest(ServiceContext(service, Settings()).metrics.registry).decode())
    dashboard = json.loads(DASHBOARD.read_text())
    queries = [target["expr"] for panel in dashboard["panels"] for target in panel.get("targets", [])]
    assert len(queries) > 20
    for query in queries:
        asked = set(re.findall(r"(?<![$\w])(?:pretouch|process)_\w+", query))
        assert asked, query
        assert asked <= exported, query
        words = set(re.findall(r"[a-z_]{3,}(?=\s*\()", query))
        assert words <= FUNCTIONS, query
