"""Estimates and models of which only the numbers that a rule looks at are there."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from modal.discrepancy.catalogue import CATALOGUE
from modal.discrepancy.nodes import Node


@dataclass(frozen=True, eq=False, kw_only=True)
class Unknowns:
    common: np.ndarray
    local: np.ndarray


def estimate_of(level, *keys, cost=100.0):
    placements = tuple(SimpleNamespace(effect=CATALOGUE[key], where="ground") for key in keys)
    return SimpleNamespace(
        assembly=SimpleNamespace(placements=placements),
        unknowns=Unknowns(common=np.zeros(1), local=np.zeros((1, 1))),
        trajectory=SimpleNamespace(states=None),
        level=level,
        cost=cost,
        smoothing=0.005,
    )


def node_with(level, *keys):
    fitted = estimate_of(level, *keys)
    return Node(fitted=fitted, held_out=estimate_of(level, *keys), coarse=fitted)
