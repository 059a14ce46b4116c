"""The demo's report: one self-contained HTML file whose scenes can be turned and zoomed."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

from pretouch.geometry import Array
from pretouch_simulation.demo import Recording
from pretouch_simulation.picture import AFTER, BEFORE, FINGER, TRUE, depth_range, limits, thin_points, window

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 76rem; padding: 0 1rem; color: #222; }
h1 { margin-bottom: 0; } section { margin-top: 3rem; border-top: 1px solid #ccc; }
.row { display: grid; grid-template-columns: 1fr 1fr; gap: 1rem; } .row > div { min-width: 0; }
@media (max-width: 60rem) { .row { grid-template-columns: 1fr; } } h3 { font-weight: normal; margin: 1.5rem 0 0; }
table { border-collapse: collapse; } th, td { padding: .25rem .8rem; text-align: right; border-bottom: 1px solid #ddd; }
"""
_HEADINGS = ("scan", "region", "share scanned", "robot s", "expected error, mm", "true error, mm")
_MOST_POINTS = 6000
_VIEW = {"eye": {"x": -1.5, "y": -1.0, "z": 1.0}}
"""From the camera's side."""
_BELOW = {"orientation": "h", "y": -0.18}


def save_report(recordings: Sequence[Recording], about: str, path: Path) -> None:
    """Writes the report; `about` is a sentence on its settings."""
    parts = "\n".join(_section(recording) for recording in recordings)
    path.write_text(
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>pretouch demo</title>'
        f"<style>{_STYLE}</style><script>{get_plotlyjs()}</script></head>\n"
        f"<body><h1>pretouch demo</h1><p>{escape(about)}</p>\n{parts}\n</body></html>\n",
        encoding="utf-8",
    )


def _section(recording: Recording) -> str:
    true = recording.true_errors()
    used = recording.last.budget_used
    summary = (
        f"The camera was {1000 * true[0]:.1f} mm off. After {used.scans} scans of {used.fraction:.0%} of what it sees, "
        f"{used.seconds:.0f} s of the robot's time, {1000 * true[-1]:.1f} mm are left; the estimate itself expects "
        f"{1000 * recording.expected_errors()[-1]:.1f} mm. The session ended: {recording.end()}"
    )
    return (
        f"<section><h2>{escape(recording.title)}</h2><p>{escape(summary)}</p>"
        f'<div class="row"><div><h3>Depth image and the regions, in the order scanned</h3>{_html(_depth(recording))}'
        f"</div><div><h3>Expected and true error over the scans</h3>{_html(_errors(recording))}</div></div>"
        f"<h3>Clouds in the robot's base frame; a click in the legend shows and hides</h3>"
        f"<div>{_html(_clouds(recording), 720)}</div>{_table(recording)}</section>"
    )


def _html(figure: go.Figure, height: int = 520) -> str:
    """A div that takes the width it is given."""
    figure.update_layout(margin={"t": 30, "l": 60, "r": 20, "b": 90}, legend={"itemsizing": "constant"})
    config = {"displaylogo": False, "responsive": True}
    options = {"full_html": False, "include_plotlyjs": False, "default_width": "100%", "default_height": f"{height}px"}
    return str(figure.to_html(config=config, **options))


def _table(recording: Recording) -> str:
    lines = []
    columns = (recording.states, recording.robot_seconds(), recording.expected_errors(), recording.true_errors())
    for k, (state, seconds, expected, true) in enumerate(zip(*columns, strict=True)):
        cells = (
            str(k) if k else "none",
            state.scans[-1].path_id if state.scans else "",
            f"{state.budget_used.fraction:.1%}",
            f"{seconds:.1f}",
            f"{1000 * expected:.2f}",
            f"{1000 * true:.2f}",
        )
        lines.append("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in cells) + "</tr>")
    head = "".join(f"<th>{heading}</th>" for heading in _HEADINGS)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(lines)}</tbody></table>"


def _depth(recording: Recording) -> go.Figure:
    u0, v0, u1, v1 = window(recording)
    depth = recording.case.depth.metres[v0:v1, u0:u1].astype(np.float64)
    depth[depth == 0] = np.nan
    near, far = depth_range(recording)
    image = go.Heatmap(
        z=depth.round(4),
        zmin=near,
        zmax=far,
        x=np.arange(u0, u1),
        y=np.arange(v0, v1),
        colorscale="Viridis",
        reversescale=True,
        colorbar={"title": "depth, m"},
        hovertemplate="u %{x}, v %{y}<br>%{z:.3f} m<extra></extra>",
    )
    figure = go.Figure(image)
    for k, (scan, pixels) in enumerate(zip(recording.last.scans, recording.scanned_pixels(), strict=True)):
        u, v = pixels.T
        figure.add_scatter(x=u, y=v, mode="markers", marker={"size": 4}, name=f"scan {k + 1}: {scan.path_id}")
        for first in pixels[:1]:
            figure.add_annotation(x=first[0], y=first[1], text=str(k + 1), showarrow=False, bgcolor="white")
    figure.update_xaxes(title="u, pixels", constrain="domain")
    figure.update_yaxes(title="v, pixels", autorange="reversed", scaleanchor="x", constrain="domain")
    figure.update_layout(plot_bgcolor="white", legend=_BELOW)
    return figure


def _errors(recording: Recording) -> go.Figure:
    scans = np.arange(len(recording.states))
    figure = go.Figure()
    for name, values, dash, colour in (
        ("expected by the estimate", recording.expected_errors(), "dash", "#7570b3"),
        ("true", recording.true_errors(), "solid", AFTER),
    ):
        figure.add_scatter(
            x=scans, y=1000 * np.array(values), name=name, mode="lines+markers", line={"dash": dash, "color": colour}
        )
    figure.update_xaxes(title="scans made", dtick=1)
    figure.update_yaxes(title="mean error of the object's points, mm", rangemode="tozero")
    figure.update_layout(legend=_BELOW)
    return figure


def _clouds(recording: Recording) -> go.Figure:
    case = recording.case
    body = case.world.bodies[0]
    x, y, z = body.base_T_mesh.apply(body.mesh.vertices).T
    i, j, k = body.mesh.faces.T
    figure = go.Figure(
        go.Mesh3d(x=x, y=y, z=z, i=i, j=j, k=k, color=TRUE, opacity=0.5, name="true object", showlegend=True)
    )
    cloud = thin_points(case.cloud, _MOST_POINTS)
    corrected = recording.last.estimate.base_T_correction
    _add_points(figure, cloud, "camera's points before", BEFORE, 1.5)
    _add_points(figure, corrected.apply(cloud), "camera's points after", AFTER, 1.5)
    for number, points in enumerate(recording.points):
        _add_points(figure, points, f"fingertip, scan {number + 1}", FINGER, 2.5)
    axes = {f"{axis}axis": {"title": f"{axis}, m", "range": span} for axis, span in _spans(recording).items()}
    figure.update_layout(scene={"aspectmode": "data", "camera": _VIEW, **axes})
    return figure


def _spans(recording: Recording) -> dict[str, list[float]]:
    """m: the part of base around the object, without the cloud's stray points."""
    body, corrected = recording.case.world.bodies[0], recording.last.estimate.base_T_correction
    clouds = [recording.case.cloud, corrected.apply(recording.case.cloud)]
    low, high = limits(body.base_T_mesh.apply(body.mesh.vertices), clouds)
    return {axis: [float(low[k]) - 0.01, float(high[k]) + 0.01] for k, axis in enumerate("xyz")}


def _add_points(figure: go.Figure, points: Array, name: str, colour: str, size: float) -> None:
    x, y, z = points.round(5).T
    marker: dict[str, Any] = {"size": size, "color": colour}
    figure.add_scatter3d(x=x, y=y, z=z, mode="markers", marker=marker, name=name)
