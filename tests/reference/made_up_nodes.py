"""Models with given errors, made up without any fit, for the rules of search and decision."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from engine_plants import some_records, two_masses

from modal.discrepancy.catalogue import CATALOGUE
from modal.discrepancy.drive import drive_of
from modal.discrepancy.estimation import Problem
from modal.discrepancy.nodes import Node, Task

N = 1000
"""Measured values of the records to fit and of the held-out ones: 2 ln L gains N ln(before / after) on each."""


def made_up_task(said=None):
    """Records to fit and held-out ones with N values each."""
    drive = drive_of(some_records(two_masses(), lengths=(N,), levels=(1.0,)))
    present = np.zeros_like(drive.present)
    present[:, 0] = True
    one = Problem(drive=replace(drive, present=present), floor=np.ones((1, 3)))
    report = lambda what, share: None if said is None else said.append((what, share))  # noqa: E731 - one line
    return Task(
        fit=one, held_out=one, fine_fit=one, fine_held_out=one, upsampling=1, catalogue=CATALOGUE, report=report
    )


def made_up(held_out, *effects, fit=None):
    """A model with effects (key or (key, place)) and errors in units of the floor; None: it escapes."""
    pairs = [(e, "ground") if isinstance(e, str) else e for e in effects]
    items = tuple(
        SimpleNamespace(
            effect=CATALOGUE[key], where=where, port=None, n_directions=0, held=(),
            common=tuple(j for j, kind in enumerate(CATALOGUE[key].parameters) if not kind.local),
        )
        for key, where in pairs
    )  # fmt: skip

    def estimate(level):
        found = np.array([[level, np.nan, np.nan]])
        return SimpleNamespace(assembly=SimpleNamespace(placements=items), mean_square=found, level=level)

    fitted = estimate((1.0 if held_out is None else held_out) if fit is None else fit)
    return Node(fitted=fitted, held_out=None if held_out is None else estimate(held_out), coarse=fitted)
