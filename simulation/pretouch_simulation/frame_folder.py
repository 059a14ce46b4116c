"""The frames of a folder that an option selects."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from pretouch.errors import Malformed, NotFound


def frames_in(folder: Path, only: Sequence[str] = ()) -> list[Path]:
    """The frames' .json files in `folder`, in the order of their names; other .json files name no images.

    Args:
        only: stems of the files to take; empty: all.

    Raises:
        NotFound: no such folder, no frame in it, or none of a name in `only`.
        Malformed: a file is not JSON.
    """
    if not folder.is_dir():
        raise NotFound(f"There is no folder {folder}.", "Give a folder of frames, each a .json file and its images.")
    frames = {path.stem: path for path in sorted(folder.glob("*.json")) if _names_images(path)}
    if not frames:
        raise NotFound(f"{folder} holds no frame.", "Give a folder of frames, each a .json file and its images.")
    unknown = [name for name in only if name not in frames]
    if unknown:
        raise NotFound(f"{folder} holds no frame called {', '.join(unknown)}.", f"Choose from: {', '.join(frames)}.")
    return [path for name, path in frames.items() if not only or name in only]


def _names_images(path: Path) -> bool:
    try:
        description = json.loads(path.read_text())
    except ValueError as error:
        raise Malformed(f"{path.name} is not JSON.", "Mend it, or move it out of the folder.") from error
    return isinstance(description, dict) and "files" in description
