"""The split of meshes into those for choosing parameters and those for reporting.

Parameters are chosen on `train`, results are reported on `validation`. The side is a hash of the object's name, so
that it is the same on any machine, needs no list, and stays when meshes are added.
"""

from __future__ import annotations

import hashlib
from enum import StrEnum

VALIDATION_SHARE = 0.2
_COLOURS = frozenset(
    {"black", "blue", "brown", "clear", "dark", "gold", "golden", "gray", "green", "grey", "light", "orange", "pink"}
    | {"purple", "red", "silver", "white", "yellow"}
)


class Split(StrEnum):
    """`TRAIN`, about 80 % of the objects, is for choosing parameters; `VALIDATION`, the others, for reporting."""

    TRAIN = "train"
    VALIDATION = "validation"


def object_of(stem: str) -> str:
    """The object that a mesh `<source>__<name>` or `<name>` shows: its name without what marks near-duplicates.

    Dropped are the source, trailing numbers and letters (`stapler_2`, `bowl_b`), and colours (`red_cup`), so that one
    object in two colours counts once, and so do all meshes named just `bowl`.
    """
    words = stem.lower().rpartition("__")[2].split("_")
    while len(words) > 1 and (words[-1].isdigit() or (len(words[-1]) == 1 and words[-1].isalpha())):
        words.pop()
    uncoloured = [word for word in words if word not in _COLOURS and word != "and"]
    return "_".join(uncoloured or words)


def split_of(stem: str) -> Split:
    """The side of the mesh with the file stem `stem`: all meshes of one object are on the same side."""
    return Split.VALIDATION if _share(object_of(stem)) < VALIDATION_SHARE else Split.TRAIN


def compute_mixing_key(stem: str) -> float:
    """A sort key in [0, 1): the order depends on the names alone and mixes the sources."""
    return _share(f"order of {stem}")


def _share(text: str) -> float:
    digest = hashlib.blake2b(text.encode(), digest_size=8).digest()
    return int.from_bytes(digest, "big") / 2**64
