"""Numbered scripts that bring a database to the present schema, one folder for each kind."""

from __future__ import annotations

from importlib import resources

from pretouch.errors import Unavailable


def load_migrations(kind: str) -> list[str]:
    """The scripts that migrate an empty database of this kind to the present schema, in their order."""
    folder = resources.files(__package__) / kind
    names = sorted(entry.name for entry in folder.iterdir() if entry.name.endswith(".sql"))
    return [(folder / name).read_text("utf-8") for name in names]


def check_version(applied: int, known: int, place: str) -> None:
    """Raises `Unavailable` if the store in `place` has more migrations applied than this pretouch knows."""
    if applied > known:
        raise Unavailable(
            f"The store in {place} has version {applied}; this pretouch supports versions up to {known}.",
            "Use a pretouch at least as new as the one that wrote it, or choose another place.",
        )
