"""How scans are matched: one interface, a file each."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum

from pretouch_registrar.engines import map as most_probable
from pretouch_registrar.engines import paper, pcl, posterior
from pretouch_registrar.engines.problem import Problem
from pretouch_registrar.engines.solution import Solution


class Engine(StrEnum):
    """The engines; each is described in the module of its name."""

    POSTERIOR = "posterior"
    MAP = "map"
    PAPER = "paper"
    PCL = "pcl"


SOLVERS: dict[Engine, Callable[[Problem], Solution]] = {
    Engine.POSTERIOR: posterior.solve,
    Engine.MAP: most_probable.solve,
    Engine.PAPER: paper.solve,
    Engine.PCL: pcl.solve,
}
