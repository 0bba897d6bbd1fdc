"""Records of a tank with a brim, and a model of it to fit."""

from dataclasses import replace

import numpy as np
from brim_tank import levels, staircase

from modal.discrepancy.assembly import assemble, initial_unknowns, place_effect
from modal.discrepancy.catalogue import CATALOGUE
from modal.discrepancy.drive import drive_of
from modal.discrepancy.estimation import Problem
from modal.discrepancy.state_space_plant import state_space_plant
from okid.record import Record

P, DT, LIMIT = 0.5, 0.05, 2.2


class Tank:
    """h' = u - 0.5 h in states of 1 / 3 of the level."""

    A, B, C, D, dt = np.array([[-P]]), np.array([[1.0 / 3.0]]), np.array([[3.0]]), np.zeros((1, 1)), None


def tank_with(*effects, rate=1.0, noise=0.0, true_rate=np.inf):
    """Two records of a tank with a brim of `true_rate`, and a model with effects whose brim starts at `rate`."""
    plant = state_space_plant(Tank, sensor_kind="displacement")
    rng = np.random.default_rng(5)
    records = []
    for seed in (0, 1):
        inflow = staircase(600, seed)
        level = levels(inflow, DT, p=P, limit=LIMIT, rate=true_rate)
        records.append(Record(inflow[:, None], (level + noise * rng.standard_normal(600))[:, None], DT))
    drive = drive_of(records)
    items = [place_effect(plant, CATALOGUE[key], "output_0", displacement_scale=0.7) for key in effects]
    assembly = assemble(plant, items)
    unknowns = initial_unknowns(assembly, 2)
    common = unknowns.common.copy()
    for i, key in enumerate(effects):
        values = {"overflow": (rate, LIMIT - 0.1), "constant_force": (0.1,), "sensor_gain": (1.0,)}[key]
        common[assembly.common_of(i)] = values
    problem = Problem(drive=drive, floor=np.full((2, 1), max(noise, 1e-4) ** 2))
    return assembly, replace(unknowns, common=common), problem
