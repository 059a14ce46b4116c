"""The meshes of a folder that an option selects."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pretouch_registrar.files import MESH_SUFFIXES

from pretouch.errors import InvalidInput, NotFound
from pretouch_simulation.split import Split, compute_mixing_key, split_of

_NAMED = 20


def meshes_in(
    folder: Path, only: Sequence[str] = (), limit: int | None = None, split: Split | None = None
) -> list[Path]:
    """The mesh files of `folder`, in the order of their names; with `split`, in one that mixes the sources.

    Args:
        only: stems of the files to take; empty: all.
        limit: how many at most, the first ones.
        split: only this side of the folder: parameters are chosen on `train` and reported on `validation`.

    Raises:
        NotFound: no such folder, no mesh in it, none of a name in `only`, or none on this side.
        InvalidInput: two files of the same stem, which is a mesh's name.
    """
    if not folder.is_dir():
        raise NotFound(
            f"There is no folder {folder}.", f"Give a folder with {', '.join(MESH_SUFFIXES)} files, in metres."
        )
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() in MESH_SUFFIXES and path.is_file())
    if not files:
        raise NotFound(f"{folder} holds no mesh.", f"Give a folder with {', '.join(MESH_SUFFIXES)} files, in metres.")
    by_name = {path.stem: path for path in files}
    if len(by_name) < len(files):
        twice = next(path.stem for path in files if by_name[path.stem] != path)
        raise InvalidInput(f"{folder} holds two meshes called {twice}.", "Rename one of them.")
    unknown = [name for name in only if name not in by_name]
    if unknown:
        there = ", ".join(list(by_name)[:_NAMED]) + (", ..." if len(by_name) > _NAMED else "")
        raise NotFound(f"{folder} holds no mesh called {', '.join(unknown)}.", f"Choose from: {there}.")
    chosen = [path for path in files if not only or path.stem in only]
    if split is not None:
        chosen = sorted(
            (path for path in chosen if split_of(path.stem) is split), key=lambda path: compute_mixing_key(path.stem)
        )
        if not chosen:
            raise NotFound(
                f"None of the meshes in {folder} that are meant is on the side {split}.", "Leave out --split."
            )
    return chosen[:limit]
