"""A report as one HTML file that needs nothing else, from a server or from a disk.

The views are our own few hundred lines (views.js): plotly's script alone is larger than the 3 MB that a report may
have, and it needs `unsafe-eval`, which a strict content security policy forbids. The one script and the one style are
allowed by their SHA-256; the documents are data blocks, which no browser executes.
"""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Sequence
from functools import cache
from hashlib import sha256
from html import escape
from importlib.resources import files
from typing import Any

_SCAN_HEADINGS = (
    "scan",
    "path",
    "returns",
    "samples",
    "robot s",
    "expected error, mm",
    "at most (95 %), mm",
    "fit (p)",
)
_REGION_HEADINGS = ("region", "confidence", "error expected after, mm", "scanned as")


def render_page(title: str, about: str, documents: Sequence[tuple[str, dict[str, Any]]]) -> str:
    """The page of some documents, each with its heading.

    Args:
        about: a sentence about all of them; may be empty.
        documents: of `build_document`, possibly with a member `truth`: `errors`, m, one before the first scan and one
            after each, and `points`, packed as the document's.
    """
    sections = "".join(_render_section(heading, document) for heading, document in documents)
    style, script = _read_style(), _read_script()
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{escape(_list_sources())}">'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><title>{escape(title)}</title>'
        f"<style>{style}</style></head>\n<body><main><h1>{escape(title)}</h1>"
        f"{f'<p>{escape(about)}</p>' if about else ''}{sections}</main>"
        f'<script type="module">{script}</script></body></html>\n'
    )


def content_security_policy() -> str:
    """The policy under which the page works: nothing from elsewhere, no inline script or style but its own."""
    return f"{_list_sources()}; frame-ancestors 'none'"


def _list_sources() -> str:
    return (
        f"default-src 'none'; script-src '{_hash(_read_script())}'; style-src '{_hash(_read_style())}'; img-src data:; "
        "base-uri 'none'; form-action 'none'"
    )


def _hash(text: str) -> str:
    return f"sha256-{b64encode(sha256(text.encode()).digest()).decode('ascii')}"


@cache
def _read_script() -> str:
    folder = files(__package__)
    return "".join((folder / name).read_text(encoding="utf-8") for name in ("views.js", "boot.js"))


@cache
def _read_style() -> str:
    return (files(__package__) / "style.css").read_text(encoding="utf-8")


def _render_section(heading: str, document: dict[str, Any]) -> str:
    facts = _render_table((), document["facts"])
    warnings = "".join(
        f'<div class="warning"><strong>{escape(each["code"])}</strong>: {escape(each["detail"])} '
        f"{escape(each['remedy'])}</div>"
        for each in document["warnings"]
    )
    picture = document["picture"]
    seen = (
        f"Depth image around the object: {len(document['regions'])} regions, and {len(document['scans'])} scans in "
        "their order; the tables name them."
    )
    request = escape(json.dumps(document["request"], indent=1))
    return (
        f'<section data-report><h2>{escape(heading)}</h2><p class="outcome">{escape(document["outcome"])}</p>{warnings}'
        f'<div class="row"><div class="panel"><h3>What the camera saw, and where the finger went</h3>'
        f'<div class="picture" data-view="picture"><img src="{escape(picture["data"])}" alt="{escape(seen)}" '
        f'width="{picture["window"][2]}" height="{picture["window"][3]}"></div>'
        f'<p class="note">The object in colour from {picture["near"]:.3f} m (yellow) to {picture["far"]:.3f} m (dark '
        "blue); pale grey: the table; dark grey: other things; black: no depth. White outlines: regions; dots: where "
        "the finger&#x27;s beams ended, numbered by scan.</p></div>"
        f'<div class="panel"><h3>In numbers</h3>{facts}'
        '<h3>Error over the session</h3><div data-view="errors"></div></div></div>'
        '<div class="panel"><h3>Before and after, in the robot&#x27;s base frame</h3><div data-view="scene">'
        '<p class="note">Needs JavaScript.</p></div><p class="note">Drag or use the arrow keys to turn; pinch, Ctrl '
        "and wheel, or + and - to zoom; z is up.</p></div>"
        f'<div class="panel"><h3>Scans</h3>{_render_scans(document)}</div>'
        '<div class="row"><div class="panel"><h3>Residuals by scan</h3><div data-view="residuals"></div></div>'
        f'<div class="panel"><h3>Regions, the proposer&#x27;s best first</h3>{_render_regions(document)}</div></div>'
        f"{_render_camera(document['camera'])}"
        f'<details class="panel"><summary>To reproduce it: session {escape(document["id"])}, created '
        f"{escape(document['created'])}; report by pretouch {escape(document['version'])}</summary>"
        f"<pre>{request}</pre></details>"
        f'<script type="application/json">{_embed(document)}</script></section>'
    )


def _render_camera(camera: dict[str, Any] | None) -> str:
    if camera is None:
        return ""
    return (
        f'<div class="panel"><h3>Camera {escape(camera["id"])}, session by session</h3>'
        f"<p>{escape(_describe_drift(camera))}</p>"
        '<div data-view="camera"></div></div>'
    )


def _describe_drift(camera: dict[str, Any]) -> str:
    known = f"Known from {camera['sessions']} session{'' if camera['sessions'] == 1 else 's'}"
    state, since = camera["drift"]["state"], camera["drift"]["since"]
    match state:
        case "moved":
            return f"{known}; it was moved before session {since}, and what it taught before that is not used."
        case "suspected":
            return f"{known}; session {since} contradicts those before it."
        case _:
            return f"{known}; no sign that it was moved."


def _render_scans(document: dict[str, Any]) -> str:
    truth = document.get("truth", {}).get("errors")
    rows = []
    for k, estimate in enumerate(document["estimates"]):
        scan = document["scans"][k - 1] if k else None
        cells = (
            [str(k), scan["path"], str(scan["returns"]), str(scan["samples"]), f"{scan['seconds']:.1f}"]
            if scan
            else ["none yet", "", "", "", ""]
        )
        cells += [f"{1000 * estimate['expected_error']:.2f}", f"{1000 * estimate['error_quantile']:.2f}"]
        cells.append(f"{estimate['fit']:.3g}")
        rows.append(cells + ([f"{1000 * truth[k]:.2f}"] if truth else []))
    return _render_table((*_SCAN_HEADINGS, *(("true error, mm",) if truth else ())), rows)


def _render_regions(document: dict[str, Any]) -> str:
    return _render_table(
        _REGION_HEADINGS,
        [
            (
                region["id"],
                f"{region['confidence']:.2f}",
                f"{1000 * region['expected_error']:.2f}",
                ", ".join(map(str, region["scans"])) or "not scanned",
            )
            for region in document["regions"]
        ],
    )


def _render_table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    head = "".join(f'<th scope="col">{escape(heading)}</th>' for heading in headings)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    head = f"<thead><tr>{head}</tr></thead>" if head else ""
    return f'<div class="scroll" tabindex="0"><table>{head}<tbody>{body}</tbody></table></div>'


def _embed(document: dict[str, Any]) -> str:
    """JSON that holds no markup, in whatever names."""
    text = json.dumps(document, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
