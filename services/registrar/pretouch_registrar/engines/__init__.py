"""How scans are matched: one interface, a file each."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum

from pretouch_registrar.engines import paper, posterior
from pretouch_registrar.engines.agreement import Problem
from pretouch_registrar.engines.solution import Solution


class Engine(StrEnum):
    """The engines; each is described in the module of its name."""

    POSTERIOR = "posterior"
    PAPER = "paper"


SOLVERS: dict[Engine, Callable[[Problem], Solution]] = {
    Engine.POSTERIOR: posterior.solve,
    Engine.PAPER: paper.solve,
}
