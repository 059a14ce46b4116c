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

_ROOT = Path(__file__).parents[2]
_WHERE = ("*.md", "[a-z]*/*.md", "services/*/*.md", "services/*/pretouch_*/weights/*.md")
_OWN = ("docs", "site")


def _find_pages() -> dict[str, str]:
    """Path in the repository to path in the site."""
    found = sorted(path.relative_to(_ROOT) for pattern in _WHERE for path in _ROOT.glob(pattern))
    pages = {path.as_posix(): f"repository/{path.as_posix()}" for path in found if path.parts[0] not in _OWN}
    return pages | {"README.md": "index.md"}


_PAGES = _find_pages()
_SOURCES = {place: source for source, place in _PAGES.items()}
_LINK = re.compile(r"(?P<image>!?)\[(?P<text>[^\]]*)\]\((?P<target>[^)\s:#]+)(?P<anchor>#[^)\s]*)?\)")
_CODE = re.compile(r"(^```.*?^```)", re.DOTALL | re.MULTILINE)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the pages."""
    for source, place in _PAGES.items():
        files.append(File.generated(config, place, content=(_ROOT / source).read_text()))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turns the repository's links into the site's; code blocks stay as they are."""
    place = page.file.src_uri
    source = _SOURCES.get(place, f"docs/{place}")

    def turn(link: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(posixpath.dirname(source), link["target"]))
        if (_ROOT / target / "README.md").exists():
            target = f"{target}/README.md"
        there = _PAGES.get(target, target.removeprefix("docs/") if target.startswith("docs/") else None)
        if there is None and (_ROOT / target).exists():
            return link["text"]
        address = posixpath.relpath(there or target, posixpath.dirname(place) or ".")
        return f"{link['image']}[{link['text']}]({address}{link['anchor'] or ''})"

    parts = _CODE.split(markdown)
    parts[::2] = [_LINK.sub(turn, part) for part in parts[::2]]
    return "".join(parts)
