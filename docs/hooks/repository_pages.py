"""Pages of the site that lie elsewhere in the repository, and links that work both there and on the site.

Documents link each other by their paths in the repository, as code hosts follow them. Here such links are turned into
the site's; what is not on the site, such as source code, is left as plain text.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

PAGES = {
    "README.md": "index.md",
    "CHANGELOG.md": "project/changelog.md",
    "CONTRIBUTING.md": "project/contributing.md",
    "SECURITY.md": "project/security.md",
    "firmware/README.md": "services/firmware.md",
    "simulation/README.md": "services/simulation.md",
    "services/detector/README.md": "services/detector.md",
    "services/detector/LABELS.md": "services/detector-labels.md",
    "services/detector/pretouch_detector/weights/MODEL_CARD.md": "services/detector-model-card.md",
    "services/orchestrator/README.md": "services/orchestrator.md",
    "services/registrar/README.md": "services/registrar.md",
    "services/sensor_gateway/README.md": "services/sensor-gateway.md",
}
"""Path in the repository to path in the site."""

_SOURCES = {place: source for source, place in PAGES.items()}
_ROOT = Path(__file__).parents[2]
_LINK = re.compile(r"(?P<image>!?)\[(?P<text>[^\]]*)\]\((?P<target>[^)\s:#]+)(?P<anchor>#[^)\s]*)?\)")
_CODE = re.compile(r"(^```.*?^```)", re.DOTALL | re.MULTILINE)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the pages."""
    for source, place in PAGES.items():
        files.append(File.generated(config, place, content=(_ROOT / source).read_text()))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turns the repository's links into the site's; code blocks stay as they are."""
    place = page.file.src_uri
    source = _SOURCES.get(place, f"docs/{place}")

    def turn(link: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(posixpath.dirname(source), link["target"]))
        if (_ROOT / target).is_dir():
            target = f"{target}/README.md"
        there = PAGES.get(target, target.removeprefix("docs/") if target.startswith("docs/") else None)
        if there is None and (_ROOT / target).exists():
            return link["text"]
        address = posixpath.relpath(there or target, posixpath.dirname(place) or ".")
        return f"{link['image']}[{link['text']}]({address}{link['anchor'] or ''})"

    parts = _CODE.split(markdown)
    parts[::2] = [_LINK.sub(turn, part) for part in parts[::2]]
    return "".join(parts)
