"""After the build: every link, image, script and style of every page leads somewhere within the site.

MkDocs checks the links between Markdown files; this checks what readers get, generated pages and anchors included, and
that no page loads anything from elsewhere. Links to other sites are not followed.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

from mkdocs.config.defaults import MkDocsConfig

_log = logging.getLogger("mkdocs.hooks.built_links")
_LOADED = {"script": "src", "img": "src", "link": "href", "iframe": "src"}


@dataclass
class _Links(HTMLParser):
    """What one page refers to, and the anchors that it has."""

    links: list[str] = field(default_factory=list)
    loaded: list[str] = field(default_factory=list)
    anchors: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        super().__init__()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        attributes = {name: value or "" for name, value in attrs}
        self.anchors |= {attributes[name] for name in ("id", "name") if name in attributes}
        if tag == "a" and "href" in attributes:
            self.links.append(attributes["href"])
        if tag in _LOADED and _LOADED[tag] in attributes and attributes.get("rel") not in ("canonical", "prev", "next"):
            self.loaded.append(attributes[_LOADED[tag]])


def on_post_build(config: MkDocsConfig) -> None:
    """Warns of each broken link; `mkdocs build --strict` then fails."""
    site = Path(config.site_dir)
    pages = {path: _read(path) for path in sorted(site.rglob("*.html"))}
    broken = [problem for path, page in pages.items() for problem in _problems(path, page, pages)]
    for problem in broken:
        _log.warning(problem)
    count = sum(len(page.links) + len(page.loaded) for page in pages.values())
    _log.info("%d pages, %d links, %d broken", len(pages), count, len(broken))


def _read(path: Path) -> _Links:
    page = _Links()
    page.feed(path.read_text())
    return page


def _problems(path: Path, page: _Links, pages: dict[Path, _Links]) -> list[str]:
    if path.name == "404.html":  # served in every folder, with links from the site's root
        return []
    problems = [f"{path} loads {target}" for target in page.loaded if urlsplit(target).netloc]
    for target in {*page.links, *page.loaded}:
        parts = urlsplit(target)
        if parts.scheme or parts.netloc:
            continue
        there = (path.parent / unquote(parts.path)).resolve() if parts.path else path
        if there.is_dir():
            there /= "index.html"
        if not there.exists():
            problems.append(f"{path} links {target}, which does not exist")
        elif parts.fragment and there in pages and unquote(parts.fragment) not in pages[there].anchors:
            problems.append(f"{path} links {target}, which has no such anchor")
    return problems
