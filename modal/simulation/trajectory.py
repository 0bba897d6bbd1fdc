"""Simulation by Newton's method on the whole trajectory.

Every step's defect is driven to zero at once: one banded solve an iteration (`modal.simulation.scheme`), no loop over
time. From a near trajectory one to three iterations are enough. Where the whole does not converge, sharp laws are
first smoothed and then sharpened, and at last the records are marched through in windows.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

import numpy as np

from modal.effects.effect import jumps
from modal.simulation.assembly import Assembly, Unknowns, drive_inputs
from modal.simulation.drive import Drive
from modal.simulation.linearisation import Linearisation, linearise
from modal.simulation.scheme import Scheme, band_of, solve_band
from okid.arrays import FloatArray

__all__ = ["SHARP", "Trajectory", "resting_states", "simulate_states"]

SHARP = 0.005
"""Smooth sharp laws over this share of the motion's scale in a finished simulation: at 0.02 a sticking motor's
simulation stays 14 times above the noise."""

TOLERANCE = 1e-8
"""Call a trajectory converged when no step misses by more than this share of the states' size."""

LADDER = (0.3, 0.1, 0.03, 0.012, 0.005, 0.002)
"""Soften sharp laws to these widths, one after the other, where they do not converge as they are."""
MEMORY_RISE = 30.0
"""Let the defect rise by this factor in a Newton step of laws with memory; see `allowed_rise`."""
SMALLEST_SHARE = 0.1
"""Try no smaller share of a Newton step."""

FIRST_WINDOW, SMALLEST_WINDOW, LARGEST_WINDOW = 64, 1, 256
"""Steps of a window in the march."""

STUBBORN_WINDOW, STUBBORN_ITERATIONS = 4, 60
"""A window this short is iterated longer: a single step onto a law that sticks needs many short Newton steps."""

GROW_AFTER = 3
"""Let windows grow again after so many in a row that converged: each failure is wasted."""

OVERHEAD = 200
"""Count an evaluation of a window as so many times besides its own."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Patience:
    """What a simulation may cost before it is given up.

    Attributes:
        iterations: Newton iterations of the whole.
        brim_iterations: Those with a brim: where a level was thought to stand at it and still rises, a step of Newton's
            method mends one step of time, and a tank takes hundreds of these to fill.
        march: Evaluations of the whole trajectory that a march may cost.
    """

    iterations: int
    brim_iterations: int
    march: float


FAR = Patience(iterations=25, brim_iterations=400, march=300.0)
"""Give up so late from any start."""
NEAR = Patience(iterations=10, brim_iterations=40, march=10.0)
"""Give up so soon from a trajectory that is near already: a trial step that needs more is taken for too long."""

About = Callable[[FloatArray, float], Linearisation]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Trajectory:
    """A simulated trajectory and the model about it.

    Attributes:
        linearisation: The model about the trajectory.
        band: The recursion's band, for the sensitivities.
        drive: The drive after the effects at the inputs.
    """

    linearisation: Linearisation
    band: FloatArray
    drive: Drive

    @property
    def states(self) -> FloatArray:
        """The trajectory (n_times, n_states + n_memory)."""
        return self.linearisation.states

    @property
    def outputs(self) -> FloatArray:
        """Outputs at the measured rows (n_rows, n_outputs)."""
        return self.linearisation.outputs


def resting_states(assembly: Assembly, drive: Drive) -> FloatArray:
    """A trajectory to start from: all zero."""
    return np.zeros((drive.n_times, assembly.plant.n_states + assembly.n_memory))


def simulate_states(
    assembly: Assembly,
    unknowns: Unknowns,
    drive: Drive,
    scheme: Scheme,
    states: FloatArray,
    *,
    smoothing: float = SHARP,
    gain: FloatArray | None = None,
    start: Literal["far", "near"] = "far",
) -> Trajectory | None:
    """Simulate.

    Args:
        assembly: The plant and its effects.
        unknowns: Values of all unknowns.
        drive: Inputs as recorded.
        scheme: Matrices of one step.
        states: A trajectory to start from (n_times, n_states + n_memory).
        smoothing: Width of sharp laws as a share of the motion's scale.
        gain: Observer gain, or None for a free run.
        start: "far": sharp laws are softened first where the whole does not converge; "near": a few iterations only.

    Returns:
        The trajectory; None where none was found (the motion escapes, or Newton's method does not converge).
    """
    driven = drive_inputs(assembly, unknowns, drive)

    def about(trial: FloatArray, width: float) -> Linearisation:
        return linearise(assembly, unknowns, driven, scheme, trial, smoothing=width, gain=gain)

    rise, patience = allowed_rise(assembly), NEAR if start == "near" else FAR
    brim = rise == np.inf
    found = _newton(about, states, smoothing, patience.brim_iterations if brim else patience.iterations, rise)
    if found is None and not brim:
        marched = _march(
            assembly, unknowns, driven, scheme, states, smoothing=smoothing, budget=patience.march, gain=gain
        )
        found = None if marched is None else _newton(about, marched, smoothing, NEAR.iterations, rise)
    if found is None and start == "far":
        found = _softened(about, states, smoothing, rise)
    if found is None:
        return None
    return Trajectory(linearisation=found, band=band_of(found.steps.transitions), drive=driven)


def allowed_rise(assembly: Assembly) -> float:
    """Factor by which a Newton step may raise the defect.

    A law with memory is piecewise linear: full steps settle one piece after the other although the defect rises on the
    way. Beside a law that jumps they do not settle. Nor does the defect tell anything of a brim, where it is as large
    as the brim is hard: the level of a tank rises with the one before and its overflow is convex, and then full steps
    settle from any start (Ortega, Rheinboldt 1970, section 13.3, https://doi.org/10.1137/1.9780898719468).
    """
    effects = [assembly.placements[i].force_and_port[0] for i in assembly.forces]
    if any(effect.is_brim for effect in effects):
        return np.inf
    return MEMORY_RISE if assembly.n_memory and not any(jumps(effect) for effect in effects) else 1.0


def _softened(about: About, states: FloatArray, smoothing: float, rise: float) -> Linearisation | None:
    """Soften sharp laws until Newton's method converges, then sharpen them step by step."""
    found: Linearisation | None = None
    for width in (*(step for step in LADDER if step > smoothing), smoothing):
        softer = _newton(about, states, width, FAR.iterations, rise)
        if softer is None and found is not None:
            return None
        if softer is not None:
            found, states = softer, softer.states
    return found


def _march(
    assembly: Assembly,
    unknowns: Unknowns,
    driven: Drive,
    scheme: Scheme,
    states: FloatArray,
    *,
    smoothing: float,
    budget: float,
    gain: FloatArray | None,
) -> FloatArray | None:
    """Solve window by window, all records side by side; a window that does not converge is halved.

    `budget` is in evaluations of the whole trajectory.
    """
    spent, rise = 0.0, allowed_rise(assembly)
    found = states.copy()
    for record, first in enumerate(driven.firsts[:-1]):
        found[first] = unknowns.local[record, list(assembly.initial)]
    longest = int(np.diff(driven.firsts).max())
    position, width, solved_in_a_row = 0, FIRST_WINDOW, GROW_AFTER
    while position < longest - 1:
        window, index, which = driven.window(position, position + width + 1)
        initial = found[index[list(window.firsts[:-1])]]
        some = Unknowns(common=unknowns.common, local=unknowns.local[which])

        def about(trial: FloatArray, wide: float) -> Linearisation:
            nonlocal spent
            spent += (len(trial) + OVERHEAD) / len(states)
            return linearise(assembly, some, window, scheme, trial, smoothing=wide, gain=gain, initial=initial)  # noqa: B023 - used within this turn of the loop

        held = np.repeat(initial, np.diff(window.firsts), axis=0)
        iterations = NEAR.iterations if width > STUBBORN_WINDOW else STUBBORN_ITERATIONS
        solved = _newton(about, found[index], smoothing, iterations, rise) or _newton(
            about, held, smoothing, iterations, rise
        )
        if solved is None:
            width, solved_in_a_row = width // 2, 0
            if width < SMALLEST_WINDOW or spent > budget:
                return None
            continue
        found[index] = solved.states
        position, solved_in_a_row = position + width, solved_in_a_row + 1
        if solved_in_a_row >= GROW_AFTER:
            width = min(2 * width, LARGEST_WINDOW)
    return found


def _newton(about: About, states: FloatArray, width: float, iterations: int, rise: float) -> Linearisation | None:
    """Newton's method; None where it does not converge or a step has no unique end."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"), suppress(np.linalg.LinAlgError):
        current = about(states, width)
        miss = _miss(current)
        for _ in range(iterations):
            if miss == 0.0:  # at rest without inputs, or no states at all
                return current
            if not np.isfinite(miss):
                return None
            step = _step(current)
            if not np.isfinite(step).all():
                return None
            largest = float(np.abs(step).max(initial=0.0))
            size = float(np.abs(current.states).max(initial=0.0)) + largest
            share = 1.0
            trial = about(current.states + step, width)
            trial_miss = _miss(trial)
            while not trial_miss < max(rise * miss, TOLERANCE * size) and share > SMALLEST_SHARE:
                share /= 2.0
                trial = about(current.states + share * step, width)
                trial_miss = _miss(trial)
            if not np.isfinite(trial_miss):
                return None
            done = share == 1.0 and largest <= TOLERANCE * size
            current, miss = trial, trial_miss
            if done:
                return current
    return None


def _miss(current: Linearisation) -> float:
    return float(np.sqrt(np.mean(current.defect**2))) if current.defect.size else 0.0


def _step(current: Linearisation) -> FloatArray:
    # The step k -> k + 1 is row k of what is led on; a record's initial state arrives unchanged.
    led = np.zeros((1, *current.defect.shape))
    led[0, :-1] = current.defect[1:]
    forcing = np.empty_like(led)
    forcing[0, 0] = current.defect[0]
    forcing[0, 1:] = current.steps.advance(led)[0, :-1]
    return solve_band(band_of(current.steps.transitions), forcing)[0]
