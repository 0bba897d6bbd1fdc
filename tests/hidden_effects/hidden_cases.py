"""Cases in which an effect is hidden: `cases(kind, seeds)`, the kinds in `hidden_kinds.KINDS`.

    for case in cases("3dof_accelerometers", range(1000, 1060)):
        case.nominal  # the wrong linear model, as arrays
        case.fit, case.held_out  # records
        case.effects  # what is hidden

All follows from kind and seed. Effects take turns with the seed, so that any run of seeds is balanced; sizes, places,
plant, inputs, levels, noise and initial state are random.

A drawn case must pass guards, or it is drawn again: a softening structure escapes, a strongly hardening one may be
chaotic (no simulation of it can be checked against a record), and an effect may happen to do nothing that a slightly
wrong stiffness could not do. No guard looks at what any method would find.

Nothing here imports okid, era or modal.
"""

from dataclasses import replace

import numpy as np
from hidden_drawing import Plan, Scene, draw_effect, draw_experiment
from hidden_kinds import KINDS
from hidden_truth import (
    INPUT_EFFECTS,
    SENSOR_EFFECTS,
    TrueChain,
    TrueRotor,
    Truth,
    chain_plant,
    clean_outputs,
    place_row,
)
from hidden_types import HiddenCase, HiddenRecord, NominalChain, NominalMotor, NominalStateSpace

DISTURBANCE = 1e-5
GROWTH = 30.0


def bounded(outputs, linear):
    """Finite, and nowhere beyond six times the largest linear output of its record."""
    with np.errstate(invalid="ignore"):
        return bool(
            np.all(np.isfinite(outputs)) and np.all(np.abs(outputs).max(1) <= 6 * np.abs(linear).max(1) + 1e-300)
        )


def repeatable(truth, experiment, outputs, rows):
    """Whether a start that is off by 1e-5 leads to the same record: not chaotic."""
    chosen = experiment.only(rows)
    scale = np.abs(chosen.starts).max(axis=0) + outputs[rows].std() * 1e-3
    moved = replace(chosen, starts=chosen.starts + DISTURBANCE * scale)
    again, _ = clean_outputs(truth, moved)
    last = slice(3 * outputs.shape[1] // 4, None)
    apart = (again - outputs[rows])[:, last].std(axis=1) / outputs[rows][:, last].std(axis=1)
    return bool(np.all(apart < GROWTH * DISTURBANCE))


def contact_reached(effects, motion, lowest, highest):
    """A stop is not touched at the lowest level and truly hit at the highest."""
    for effect, d in zip(effects, np.moveaxis(motion, -1, 0), strict=True):
        if effect.effect == "gap_spring":
            gap, stops = effect.parameters["gap"], effect.parameters["k_in"] == 0
            if (stops and np.abs(d[lowest]).max() >= gap) or np.abs(d[highest]).max() < 1.25 * gap:
                return False
    return True


def gap_beyond_linear(truth, experiment, outputs, noise_variance, row):
    """What each effect adds to one record, less what stiffness, damping and initial state could explain.

    Root mean square over all outputs, each over its noise's deviation; one number an effect, the others being there.
    """
    one = experiment.only([row])
    sizes = []
    explained = _linear_directions(truth, one) / np.sqrt(noise_variance)
    basis, _ = np.linalg.qr(explained.reshape(len(explained), -1).T)
    for effect in truth.effects:
        others, _ = clean_outputs(truth.without(effect), one)
        if not np.all(np.isfinite(others)):
            return [0.0]
        gap = ((outputs[row] - others[0]) / np.sqrt(noise_variance)).ravel()
        gap = gap - basis @ (basis.T @ gap)
        sizes.append(float(np.sqrt(np.mean(gap**2))))
    return sizes


def _linear_directions(truth, one):
    """(n_directions, n_samples, n_outputs) of the linear plant: each stiffness, each damping, each initial state."""
    plain = Truth(plant=truth.plant, effects=())
    base, _ = clean_outputs(plain, one)
    rows = []
    names = ("stiffnesses", "dampings") if isinstance(truth.plant, TrueChain) else ("b",)
    for name in names:
        values = np.atleast_1d(getattr(truth.plant, name))
        for i in range(len(values)):
            changed = np.array(values, dtype=float)
            changed[i] *= 1.001
            plant = replace(truth.plant, **{name: changed if name != "b" else float(changed[0])})
            rows.append((clean_outputs(replace(plain, plant=plant), one)[0] - base)[0] / 1e-3)
    quiet = replace(one, inputs=np.zeros_like(one.inputs))
    for i in range(one.starts.shape[1]):
        starts = np.zeros_like(one.starts)
        starts[0, i] = 1.0
        rows.append(clean_outputs(plain, replace(quiet, starts=starts))[0][0])
    rows = np.array(rows)
    return rows / (rows.std(axis=(1, 2), keepdims=True) + 1e-300)


MOST_DRAWS = 60
LEAST_GAP = 1.0
"""Root mean square of what an effect adds to the held-out record beyond any linear change, over the noise's deviation;
half of it for effects at a fraction of their strength."""


FORCES = ("k3", "k2", "kb", "k_in", "k_out", "Fc", "c2", "a", "k", "offset", "amplitude", "rate")
"""Parameters in proportion to a force."""
ODD_UNDER_REVERSAL = ("k2", "kb", "offset")
"""Those of them that change sign when displacement and force are counted the other way round."""


def cases(kind, seeds):
    """One case a seed, made when it is asked for."""
    for seed in seeds:
        yield hidden_case(kind, seed)


def hidden_case(kind, seed, *, guarded=True):
    """The case of one seed.

    `guarded=False` leaves out the guards that march again, which is half of the work: only for a seed whose first draw
    is known to pass them. The case is the same but for `gap_to_noise`, which they find.

    Raises:
        RuntimeError: 60 draws did not give one that passes the guards.
    """
    recipe = KINDS[kind]
    rng = np.random.default_rng([recipe.number, seed])
    wanted = recipe.effects[seed % len(recipe.effects)]
    for _ in range(MOST_DRAWS):
        case = _draw(kind, recipe, seed, wanted, rng, guarded=guarded)
        if case is not None:
            return case
    raise RuntimeError(f"no {kind} case of seed {seed} with {wanted} passes the guards in {MOST_DRAWS} draws")


def _draw(kind, recipe, seed, wanted, rng, *, guarded):
    """A case, or None where a guard objects."""
    sort, n_dofs, sensor_kind, n_sensors = recipe.plants[rng.integers(len(recipe.plants))]
    plan = Plan(recipe=recipe, sort=sort, n_dofs=n_dofs, sensor_kind=sensor_kind, n_sensors=n_sensors, effects=wanted)
    plant, experiment, levels = draw_experiment(plan, rng)
    linear, _ = clean_outputs(Truth(plant=plant, effects=()), experiment)
    scene = Scene(plant=plant, sort=sort, experiment=experiment, linear=linear, levels=levels, recipe=recipe)
    effects = tuple(draw_effect(name, scene, rng) for name in wanted)
    if any(e is None for e in effects) or len({(e.effect, e.place) for e in effects}) < len(effects):
        return None
    truth = Truth(plant=plant, effects=effects)
    with np.errstate(all="ignore"):
        outputs, (displacement, velocity) = clean_outputs(truth, experiment)
    if not bounded(outputs - outputs.mean(axis=1, keepdims=True), linear) or outputs.std(axis=1).min() == 0:
        return None
    variance = (rng.uniform(*recipe.noise) * outputs.std(axis=1)) ** 2
    last, forces = len(levels) - 1, [e for e in effects if e.effect not in (*INPUT_EFFECTS, *SENSOR_EFFECTS)]
    forces = [e for e in forces if e.effect not in ("missing_mode", "overflow")]
    lowest, highest = int(np.argmin(levels)), int(np.argmax(levels))
    if not contact_reached(forces, displacement, lowest, highest):
        return None
    if guarded and forces and not repeatable(truth, experiment, outputs, [highest, last]):
        return None
    gaps = gap_beyond_linear(truth, experiment, outputs, variance[last], last) if guarded else []
    if any(gap < (LEAST_GAP if recipe.strength == 1 else LEAST_GAP / 2) for gap in gaps):
        return None
    noisy = outputs + np.sqrt(variance)[:, np.newaxis] * rng.standard_normal(outputs.shape)
    records = _records(experiment, levels, outputs, noisy, variance)
    reverses = not forces or bool(
        np.all((velocity[:last].min(axis=(0, 1)) < 0) & (velocity[:last].max(axis=(0, 1)) > 0))
    )
    return HiddenCase(
        kind=kind,
        seed=seed,
        nominal=_nominal(plant, sort, rng),
        fit=records[:-1],
        held_out=records[-1:],
        effects=tuple(_as_named(e, plant, sort) for e in effects),
        gap_to_noise=tuple(gaps),
        velocity_reverses=reverses,
        truth=_numbers(plant),
    )


# --- what is handed over ---------------------------------------------------------------------------------------------


def _records(experiment, levels, outputs, noisy, variance):
    return tuple(
        HiddenRecord(
            inputs=experiment.inputs[r],
            outputs=noisy[r],
            clean_outputs=outputs[r],
            noise_variance=variance[r],
            dt=experiment.dt,
            hold=experiment.hold,
            level=float(levels[r]),
            starts_at_rest=not np.any(experiment.starts[r]),
            name=f"level {levels[r]:.3g}" + (", held out" if r == len(levels) - 1 else ""),
        )
        for r in range(len(levels))
    )


def _nominal(plant, sort, rng):
    """The linear model that the user has: off by up to 5 % in stiffness and 30 % in damping."""
    if isinstance(plant, TrueRotor):
        return NominalMotor(J=plant.J, b=plant.b * rng.uniform(0.7, 1.3), kt=plant.kt, is_flow=sort == "tank")
    n = plant.n_dofs
    wrong = replace(
        plant,
        stiffnesses=plant.stiffnesses * rng.uniform(0.95, 1.05, n),
        dampings=plant.dampings * rng.uniform(0.7, 1.3, n),
    )
    if sort == "chain":
        return NominalChain(
            masses=wrong.masses, stiffnesses=wrong.stiffnesses, dampings=wrong.dampings, force_dofs=wrong.force_dofs,
            sensor_dofs=wrong.sensor_dofs, sensor_kind=wrong.sensor_kind,
        )  # fmt: skip
    linear, (C, D, _) = chain_plant(wrong, [])
    size = np.concatenate([np.ones(n), np.full(n, plant.natural_frequencies[0])])
    left, _ = np.linalg.qr(rng.standard_normal((2 * n, 2 * n)))
    right, _ = np.linalg.qr(rng.standard_normal((2 * n, 2 * n)))
    T = size[:, np.newaxis] * (left @ np.diag(rng.uniform(0.5, 2.0, 2 * n)) @ right)
    return NominalStateSpace(
        A=np.linalg.solve(T, linear.A @ T), B=np.linalg.solve(T, linear.B), C=C @ T, D=D, sensor_kind=wrong.sensor_kind
    )


def _as_named(effect, plant, sort):
    """As it shows in the model that is handed over.

    In a state space a place is an output or the difference of two, the first less the second, and forces are known per
    effective mass at the place, 1 / (b' M^-1 b) with b the direction of the place.
    """
    if sort == "tank":
        return replace(effect, place="output_0")
    if sort != "state_space" or effect.place.startswith(("input", "output")):
        return effect
    word, number = effect.place.split("_")
    output = {dof: i for i, dof in enumerate(plant.sensor_dofs)}
    place, sign = f"output_{output[int(number)]}", 1.0
    if word == "element" and int(number) > 0:
        place, sign = f"output_{output[int(number) - 1]}-{place}", -1.0
    row = place_row(effect.place, plant.n_dofs)
    mobility = float(np.sum(row**2 / plant.masses))
    values = {
        name: value * mobility * (sign if name in ODD_UNDER_REVERSAL else 1.0) if name in FORCES else value
        for name, value in effect.parameters.items()
    }
    return replace(effect, place=place, parameters=values)


def _numbers(plant):
    if isinstance(plant, TrueRotor):
        return {"J": np.array([plant.J]), "b": np.array([plant.b]), "kt": np.array([plant.kt])}
    return {"masses": plant.masses, "stiffnesses": plant.stiffnesses, "dampings": plant.dampings}
