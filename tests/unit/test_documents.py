"""Links between the repository's documents lead somewhere, and every environment variable is documented."""

import re
import subprocess
from dataclasses import fields
from pathlib import Path

import pytest
from pretouch_orchestrator.settings import OrchestratorSettings

ROOT = Path(__file__).resolve().parents[2]
FENCE = re.compile(r"^```.*?^```", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\]\((?P<target>[^)\s#]*)(?:#(?P<anchor>[^)\s]*))?\)")
HEADING = re.compile(r"^#+ (.*)$", re.MULTILINE)
MADE = {ROOT / "docs" / "reference" / name for name in ("rest.md", "grpc.md", "cli.md")}
"""Pages that the site alone has, made from the code."""
VARIABLE = re.compile(r"\bPRETOUCH_[A-Z]+(?:_[A-Z]+)*(?![A-Z_])")


def tracked(*patterns: str) -> list[Path]:
    listed = subprocess.run(["git", "ls-files", *patterns], cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode:
        pytest.skip("not in a git checkout")
    return [ROOT / line for line in listed.stdout.splitlines() if (ROOT / line).exists()]


def anchors(document: Path) -> set[str]:
    """What code hosts and the site make of the headings."""
    headings = HEADING.findall(FENCE.sub("", document.read_text()))
    return {re.sub(r"[^\w\- ]", "", heading).strip().lower().replace(" ", "-") for heading in headings}


def broken_links(document: Path) -> list[str]:
    broken = []
    for link in LINK.finditer(FENCE.sub("", document.read_text())):
        target, anchor = link["target"], link["anchor"]
        if re.match(r"[a-z]+:", target):
            continue
        there = (document.parent / target).resolve() if target else document
        if there in MADE:
            continue
        if not there.exists():
            broken.append(f"{document.relative_to(ROOT)}: {target} does not exist")
        elif anchor and there.suffix == ".md" and anchor not in anchors(there):
            broken.append(f"{document.relative_to(ROOT)}: {target} has no heading #{anchor}")
    return broken


def test_every_link_leads_somewhere() -> None:
    documents = tracked("*.md")
    assert len(documents) > 30
    assert [problem for document in documents for problem in broken_links(document)] == []


def test_every_file_that_is_named_is_there() -> None:
    folders = {path.relative_to(ROOT).parts[0] for path in tracked("*.py", "*.md")} - {"pretouch"}
    name = re.compile(rf"`((?:{'|'.join(sorted(folders))})/[\w./-]+\.\w+)`")
    missing = [
        f"{document.relative_to(ROOT)}: {named}"
        for document in tracked("*.md")
        for named in name.findall(FENCE.sub("", document.read_text()))
        if not (ROOT / named).exists()
    ]
    assert missing == []


def test_a_broken_link_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(f"{__name__}.ROOT", tmp_path)
    page = tmp_path / "page.md"
    page.write_text(
        "# A page, of `code`\n[a](page.md#a-page-of-code) [b](gone.md) [c](#gone) [d](https://example.org/x)\n"
    )
    assert broken_links(page) == ["page.md: gone.md does not exist", "page.md:  has no heading #gone"]


def test_every_environment_variable_is_documented() -> None:
    sources = tracked("pretouch/*.py", "services/*.py", "docker-compose.yml")
    named = {name for source in sources for name in VARIABLE.findall(source.read_text())}
    named |= {f"PRETOUCH_ORCHESTRATOR_{field.name.upper()}" for field in fields(OrchestratorSettings)}
    assert len(named) > 15
    documents = (ROOT / "docs/reference/configuration.md").read_text() + (ROOT / "docs/how-to/deploy.md").read_text()
    assert sorted(name for name in named if f"`{name}`" not in documents) == []
