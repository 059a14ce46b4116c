"""Reads a prior from a JSON file: as a request has it, or as an earlier estimate."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from pretouch.errors import InvalidInput
from pretouch.geometry import Array
from pretouch.prior import AnyPrior, PosePrior
from pretouch.wire.json import prior_from_json
from pretouch.wire.reader import read_numbers

_OF_POSE = ("base_T_correction", "covariance")


def read_prior(path: Path, centroid: Array) -> AnyPrior:
    """The prior of an object whose centroid is (3,), m, in base, before correction.

    The file holds standard deviations or a mean and a covariance, an estimate, or a session with one. An estimate's
    covariance is about its own centroid, and is carried to this one.

    Raises:
        InvalidInput: no file, no JSON, or no prior.
        Malformed: a number that is not finite.
    """
    document = _read(path)
    if "estimate" in document:
        document = document["estimate"]
    if not isinstance(document, dict) or not all(name in document for name in _OF_POSE):
        return prior_from_json(document, path.name)
    prior = prior_from_json({name: document[name] for name in _OF_POSE}, path.name)
    if "centroid" in document and isinstance(prior, PosePrior):
        return prior.carried(np.array(read_numbers(document["centroid"], f"{path.name}.centroid", 3)), centroid)
    return prior


def _read(path: Path) -> dict[str, Any]:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InvalidInput(f"{path} cannot be read: {error.strerror}.", "Give --prior FILE.json.") from None
    except ValueError:
        raise InvalidInput(f"{path.name} is no JSON.", "Give one with base_T_correction and covariance.") from None
    if not isinstance(document, dict):
        raise InvalidInput(f"{path.name} is no JSON object.", "Give one with base_T_correction and covariance.")
    return document
