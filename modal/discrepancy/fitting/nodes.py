"""Models with some effects, fitted and judged on held-out records: what the search goes from and comes to.

The free run of a lightly damped model whose frequency is off by more than the width of the resonance is out of step
with the record from the first beat on: the error hardly falls towards the right frequency, more damping lowers it, and
the fit creeps or stops on a bound. In observer form the measured outputs keep model and record in step; from there the
free run is near its minimum. So a model whose first values may be far off is fitted both ways.

Masses are a rival of every gain, absorber and missing mode, of as many numbers as masses are off. A mass is right until
the calibration without it does not explain the records; then all are released at once, and those that the records do
not ask for go back to what the model says (Schwarz 1978: ln n a number).
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from modal.discrepancy.fitting.estimation import Estimate, Problem, covariance, estimate, simulate_at
from modal.discrepancy.fitting.observer_form import LOST, LostMotion, graded_run, observer_gain
from modal.effects.effect import Effect, is_sharp
from modal.simulation import AT_FLOOR, explained
from modal.simulation.assembly import Assembly, Unknowns, assemble
from modal.simulation.plant import released_masses, with_masses, with_wider_masses
from modal.simulation.scheme import Budget
from modal.simulation.trajectory import SHARP
from okid.arrays import FloatArray

NEARLY_THERE = 2.0
"""Expect the held-out records to be explained as well where the fit's level is below this."""
DOUBTFUL = (1.1, 100.0)
"""Seek the initial state again where the held-out error is above the fit's by a factor between these."""
MATTER = 0.8
"""Start from the initial states of the plant without its effects where they lower its cost to less than this share."""
WEAKER = (1.0, 0.3, 0.1)
"""Try these shares of an observer's gain: the whole one, of the linear plant, may make a hard spring unstable."""


def judged(fitted: Estimate, held_out: Problem, begun: Estimate | None = None) -> Estimate | None:
    """The model along the held-out records; only initial states and what else each record has for itself is fitted.

    None where the model escapes.
    """
    assembly = fitted.assembly
    n_records = held_out.drive.n_records
    local = np.zeros((n_records, assembly.n_local))
    for i in range(len(assembly.placements)):
        own = assembly.local_of(i)
        local[:, own] = np.mean(fitted.unknowns.local[:, own], axis=0)
    n_states = assembly.plant.n_states
    begin = _first_states(fitted, held_out) if begun is None else begun.unknowns.local[:, :n_states]
    local[:, :n_states] = begin
    unknowns = Unknowns(common=fitted.unknowns.common, local=local)
    start = simulate_at(assembly, unknowns, held_out, smoothing=fitted.smoothing)
    found = None if start is None else estimate(start, held_out, iterations=8)
    if found is not None and _doubtful(found, fitted):
        found = loaded(found, held_out)
    if found is not None and _doubtful(found, fitted):
        rest = rested(found, held_out)
        found = found if rest is found else estimate(rest, held_out, iterations=8)
    if found is not None and _doubtful(found, fitted):
        again = _by_observer(found, held_out)
        if again is not None and again.cost < found.cost:
            return again
    return found


def rested(start: Estimate, problem: Problem) -> Estimate:
    """The same model begun at rest where that is nearer to the records.

    Initial states that made up for a missing law do not find back from under friction, which holds a mass anywhere.
    """
    local = start.unknowns.local.copy()
    local[:, : start.assembly.plant.n_states] = 0.0
    found = _begun_at(start, local, problem)
    return start if found is None or found.cost >= start.cost else found


def loaded(found: Estimate, problem: Problem) -> Estimate:
    """The same model, hysteretic links loaded by a straight way from rest in the records that are nearer to it so.

    A link that slips from the start on forgets what it was loaded by: no step leads from one side to the other.
    """
    assembly, drive = found.assembly, found.trajectory.drive
    links = assembly.links
    if not links or found.level <= AT_FLOOR:
        return found
    local = found.unknowns.local.copy()
    for i in links:
        local[:, assembly.own_of(i).start] = assembly.begun(i, local, drive)[0]
    tried = _begun_at(found, local, problem)
    other = None if tried is None else estimate(tried, replace(problem, free_common=False), iterations=8)
    if other is None:
        return found
    nearer = np.nansum(other.mean_square, axis=1) < np.nansum(found.mean_square, axis=1)
    mixed = _begun_at(found, np.where(nearer[:, None], other.unknowns.local, found.unknowns.local), problem)
    return found if mixed is None or mixed.cost >= found.cost else mixed


def _begun_at(found: Estimate, local: FloatArray, problem: Problem) -> Estimate | None:
    """The same model begun otherwise."""
    unknowns = Unknowns(common=found.unknowns.common, local=local)
    return simulate_at(found.assembly, unknowns, problem, states=found.trajectory.states, smoothing=found.smoothing)


def _first_states(fitted: Estimate, held_out: Problem) -> FloatArray:
    """Initial states to start from: those of the plant without its effects where they matter, else rest.

    A mass that is held by friction at rest would stay there whatever its initial state is changed by.
    """
    plant = fitted.assembly.plant
    rest = np.zeros((held_out.drive.n_records, plant.n_states))
    if not fitted.assembly.placements:
        return rest
    linear = Unknowns(common=fitted.unknowns.common[: fitted.assembly.n_linear], local=rest)
    resting = simulate_at(assemble(plant), linear, held_out)
    begun = None if resting is None else estimate(resting, held_out, iterations=2)
    if resting is None or begun is None or begun.cost > MATTER * resting.cost:
        return rest
    return begun.unknowns.local


def _doubtful(held_out: Estimate, fitted: Estimate) -> bool:
    """Whether the held-out records' initial states may be in another basin: surely where the fit is at the floor."""
    level = max(fitted.level, 1.0)
    most = np.inf if level <= NEARLY_THERE else DOUBTFUL[1] * level
    return DOUBTFUL[0] * level < held_out.level < most


def _by_observer(found: Estimate, held_out: Problem) -> Estimate | None:
    """The initial states once more, found in observer form first.

    Under play, stops or a hard spring a free run from rest may stay in another basin.
    """
    gain = observer_gain(found, held_out)
    if gain is None:
        return None
    smoothing = found.smoothing
    states = found.trajectory.states
    corrected = (
        simulate_at(
            found.assembly,
            found.unknowns,
            held_out,
            states=states,
            gain=share * gain,
            smoothing=smoothing,
            start="near",
        )
        for share in WEAKER
    )
    seen = next((one for one in corrected if one is not None), None)
    if seen is None:
        return None
    seen = estimate(seen, held_out, iterations=4)
    local = seen.trajectory.states[list(held_out.drive.firsts[:-1])]
    unknowns = Unknowns(common=found.unknowns.common, local=seen.unknowns.local.copy())
    unknowns.local[:, list(found.assembly.initial)] = local
    start = simulate_at(
        found.assembly, unknowns, held_out, states=seen.trajectory.states, smoothing=smoothing, start="near"
    )
    free = None if start is None else estimate(start, held_out, iterations=8)
    if free is not None and free.cost <= LOST * seen.cost:
        return free
    try:
        graded = graded_run(seen, held_out, smoothing=smoothing)
    except LostMotion:
        return free
    return free if graded is None else estimate(graded, held_out, iterations=8)


SMALLEST_FALL = 0.1
SMALLEST_GAIN = 30.0
"""Count a step where the held-out mean square falls by a tenth (`SMALLEST_FALL`) and 2 ln L gains more than 30: over 32
cases without an effect none fell by a tenth, while 69 % gained more than 30."""

SHARPER = tuple(SHARP / share for share in (1.0, 2.5, 5.0, 10.0, 20.0))
"""Sharpen in small steps, because each trajectory must be near the next: from a first one of a fifth, half of the fits
with a second effect found none, and those that did took longer."""
NEARLY, BLUR = 2.0, 0.1
"""Take what is left for smoothing below this level, or where it changes by this share of the excess with the
smoothing."""
FAR, MOSTLY = 30.0, 1.0
"""Ask above this level for a rise by this share of the excess, as where smoothing makes a third of it: a motion with
impacts changes a little with anything."""
FINE_STEPS = 4
"""Polish sharp laws on a grid of at least so many steps a sample."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Task:
    """What the search works on.

    Attributes:
        fit: The records to fit.
        held_out: The held-out records.
        upsampling: Steps of the simulation per sample.
        catalogue: The effects to try.
        report: Called with a sentence and the share done.
        fine_fit: The records to fit on a finer grid, for sharp laws.
        fine_held_out: The held-out records likewise.
        whole: Whether the records are whole, so that they may be cut into spans.
        budget: What the search may cost.
        form_free: Laws of unknown form, tried where no effect of the catalogue is enough.
        reached: Level on the records to fit that another model with as many effects reaches in free run: what leaves
            more in observer form, which only helps, is not followed.
    """

    fit: Problem
    held_out: Problem
    upsampling: int
    catalogue: Mapping[str, Effect]
    report: Callable[[str, float], None]
    fine_fit: Problem
    fine_held_out: Problem
    whole: bool = False
    budget: Budget = field(default_factory=Budget)
    form_free: Mapping[str, Effect] = field(default_factory=dict)
    reached: float = np.inf

    @property
    def every_effect(self) -> Mapping[str, Effect]:
        """Effects with a name, and laws of unknown form."""
        return {**self.catalogue, **self.form_free}


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Node:
    """A model with some effects, fitted.

    Attributes:
        fitted: The estimate on the records to fit, in free run.
        held_out: The same model on the held-out records, only their own unknowns fitted; None where it escapes.
        coarse: The estimate on the grid on which the search goes on.
    """

    fitted: Estimate
    held_out: Estimate | None
    coarse: Estimate

    @property
    def effects(self) -> tuple[tuple[str, str], ...]:
        """(effect, place) of each effect."""
        return tuple((item.effect.key, item.where) for item in self.fitted.assembly.placements)

    @property
    def by_record(self) -> bool:
        """Whether an effect has nothing but numbers of each record's own: on held-out records they prove nothing."""
        return any(all(kind.local for kind in item.effect.parameters) for item in self.coarse.assembly.placements)

    @property
    def masses(self) -> tuple[str, ...]:
        """Names of the masses that are not those of the model as given."""
        return released_masses(self.fitted.assembly.plant)

    @property
    def size(self) -> int:
        """How many things differ from the model as given, stiffness and damping aside: effects and masses."""
        return len(self.fitted.assembly.placements) + len(self.masses)

    @property
    def fit_level(self) -> float:
        """Mean square of the residual on the records to fit, in units of the floor."""
        return self.fitted.level

    @property
    def held_out_level(self) -> float:
        """Likewise on the held-out records; infinite where the model escapes."""
        return np.inf if self.held_out is None else self.held_out.level


def log_likelihood_gain(before: Node, after: Node, task: Task) -> float:
    """2 ln L that `after` gains over `before` on all records, each record and output with its own noise variance."""
    if before.held_out is None or after.held_out is None:
        return np.inf if after.held_out is not None else -np.inf
    return _gain(before.fitted, after.fitted, task.fit) + _gain(before.held_out, after.held_out, task.held_out)


def _gain(before: Estimate, after: Estimate, problem: Problem) -> float:
    """The variance that is left but never below the floor: a fit below the floor is chance, not merit."""
    drive = problem.drive
    count = np.array([drive.present[drive.rows_of(record)].sum(axis=0) for record in range(drive.n_records)])
    ratio = np.maximum(before.mean_square, 0.5) / np.maximum(after.mean_square, 0.5)
    return float(np.nansum(count * np.log(ratio)))


def node_of(fitted: Estimate, task: Task, begun: Estimate | None = None) -> Node:
    """Judge a fitted model on the held-out records."""
    return Node(fitted=fitted, held_out=judged(fitted, task.held_out, begun), coarse=fitted)


def polished(node: Node, task: Task) -> Node:
    """The node on a finer grid and sharper where a law of it is sharp and that may matter; as it is otherwise."""
    if node.fitted is not node.coarse or not any(is_sharp(item.effect) for item in node.coarse.assembly.placements):
        return node
    if not _blurred(node.coarse, task.fit):
        return node
    finer = _finer(node.coarse, node.coarse.unknowns, task.fit, task.fine_fit)
    if finer is None or finer.cost > node.coarse.cost:
        return node
    held_out = None
    if node.held_out is not None:
        unknowns = replace(finer.unknowns, local=node.held_out.unknowns.local)
        held_out = _finer(node.held_out, unknowns, task.held_out, task.fine_held_out)
    if held_out is None:
        held_out = judged(finer, task.fine_held_out)
    return Node(fitted=finer, held_out=held_out, coarse=node.coarse)


def _blurred(coarse: Estimate, problem: Problem) -> bool:
    """Whether what is left may come from smoothing: twice the smoothing leaves a good deal more."""
    if coarse.level <= NEARLY:
        return True
    twice = simulate_at(
        coarse.assembly,
        coarse.unknowns,
        problem,
        states=coarse.trajectory.states,
        smoothing=2.0 * coarse.smoothing,
        start="near",
    )
    if coarse.level > FAR:
        return twice is not None and twice.level - coarse.level > MOSTLY * (coarse.level - 1.0)
    return twice is None or abs(twice.level - coarse.level) > BLUR * (coarse.level - 1.0)


def on_other_floor(node: Node, fit_ratio: FloatArray, held_out_ratio: FloatArray) -> Node:
    """The node with its residuals in units of another floor, `ratio` times smaller (n_records, n_outputs)."""

    def scaled(one: Estimate, ratio: FloatArray) -> Estimate:
        return replace(one, mean_square=one.mean_square * ratio)

    return Node(
        fitted=scaled(node.fitted, fit_ratio),
        held_out=None if node.held_out is None else scaled(node.held_out, held_out_ratio),
        coarse=scaled(node.coarse, fit_ratio),
    )


def _finer(coarse: Estimate, unknowns: Unknowns, before: Problem, fine: Problem) -> Estimate | None:
    """The fit on the finer grid, sharper and sharper, from the coarse trajectory on; None where a step finds none."""
    drive = fine.drive
    states = np.concatenate(
        [
            _between(coarse.trajectory.states[before.drive.times_of(r)], drive.firsts[r + 1] - drive.firsts[r])
            for r in range(drive.n_records)
        ]
    )
    found = simulate_at(coarse.assembly, unknowns, fine, states=states, smoothing=SHARPER[0])
    for smoothing in SHARPER[1:]:
        if found is None:
            return None
        states = found.trajectory.states
        found = simulate_at(coarse.assembly, unknowns, fine, states=states, smoothing=smoothing)
    return None if found is None else estimate(found, fine, iterations=4)


def _between(states: FloatArray, n_times: int) -> FloatArray:
    at = np.linspace(0.0, len(states) - 1.0, n_times)
    columns = [np.interp(at, np.arange(len(states)), column) for column in states.T]
    return np.array(columns).reshape(-1, n_times).T  # a plant without dynamics has none


MOST_ON_FIT = 2.0
"""Name nothing firmly above this level on the records to fit: they hold levels that the held-out ones may lack."""


def counts(parent: Node, child: Node, task: Task) -> bool:
    """Whether a step is one: the held-out mean square falls by a tenth and the likelihood gains.

    Held-out records that lack what is missing (a zero that did not move) cannot show a step. It is one there if it
    explains the records to fit, and the held-out ones still.
    """
    if not np.isfinite(child.held_out_level):
        return False
    falls = child.held_out_level <= (1.0 - SMALLEST_FALL) * parent.held_out_level
    unseen = explained(parent.held_out_level) and parent.fit_level > MOST_ON_FIT and explains_both(child)
    return (falls or unseen) and log_likelihood_gain(parent, child, task) > SMALLEST_GAIN


def explains_both(node: Node) -> bool:
    """Whether a model explains the held-out records, and those to fit so far that it may be named."""
    return explained(node.held_out_level) and node.fit_level <= MOST_ON_FIT


WIDER = 4.0
"""Move the bounds of linear parameters, and of masses, out by this factor where they are in the way."""


def calibrated_node(start: Estimate, task: Task) -> Node:
    """The linear parameters and the initial states fitted, and judged on the held-out records.

    The model; within wider bounds where these explain the records and those given do not.
    """
    found = polished(node_of(fitted_either_way(start, task.fit, iterations=12), task), task)
    if found.held_out_level <= AT_FLOOR or not found.coarse.at_bounds[: start.assembly.n_linear].any():
        return found
    wide = simulate_at(_widened(start.assembly), start.unknowns, task.fit, smoothing=start.smoothing)
    if wide is None:
        return found
    free = polished(node_of(fitted_either_way(wide, task.fit, iterations=12), task), task)
    return free if max(free.fit_level, free.held_out_level) <= AT_FLOOR else found


def _widened(assembly: Assembly) -> Assembly:
    """The model with bounds of its linear parameters that lie further out."""
    parameters = tuple(
        replace(one, lower=min(one.lower / WIDER, one.lower * WIDER), upper=max(one.upper / WIDER, one.upper * WIDER))
        for one in assembly.plant.parameters
    )
    return replace(assembly, plant=replace(assembly.plant, parameters=parameters))


def fitted_either_way(start: Estimate, problem: Problem, *, iterations: int) -> Estimate:
    """The better of the fit in free run and the one that begins in observer form."""
    found = estimate(start, problem, iterations=iterations)
    if found.level <= AT_FLOOR:
        return found
    observed = _calibrated_by_observer(start, problem, iterations)
    return found if observed is None or observed.cost >= found.cost else observed


def _calibrated_by_observer(start: Estimate, problem: Problem, iterations: int) -> Estimate | None:
    gain = observer_gain(start, problem)
    if gain is None:
        return None
    observed = simulate_at(
        start.assembly, start.unknowns, problem, states=start.trajectory.states, gain=gain, smoothing=start.smoothing
    )
    if observed is None:
        return None
    near = estimate(observed, problem, iterations=6)
    free = simulate_at(start.assembly, near.unknowns, problem, states=near.trajectory.states, smoothing=start.smoothing)
    return None if free is None else estimate(free, problem, iterations=iterations)


ITERATIONS = 12
"""End the fit of a model with other masses after so many iterations, as a calibration."""


def with_released_masses(node: Node, task: Task) -> Node | None:
    """The model with all its masses free, and only those that it needs where it explains the records.

    Within wider bounds where these explain the records and those given do not: held at its bound, a mass that is
    further off leaves the rest of itself for a gain or a hung mass to take up. None where no mass may be wrong, or the
    model cannot be simulated so.
    """
    coarse = node.coarse
    names = [one.parameter.name for one in coarse.assembly.plant.masses]
    if not names:
        return None
    # a calibration without the masses has bent the stiffnesses: alone it starts from the model as given
    linear = None if node.effects else coarse.assembly.plant.nominal
    start = _rebuilt(coarse, (*released_masses(coarse.assembly.plant), *names), task, linear=linear)
    if start is None:
        return None
    found = node_of(fitted_either_way(start, task.fit, iterations=ITERATIONS), task)
    found = _beyond_tolerance(found, task) or found
    return needed_masses(found, task) if explained(found.held_out_level) else found


def _beyond_tolerance(found: Node, task: Task) -> Node | None:
    """The model with masses further off than they may be; None where that is not needed or explains nothing."""
    coarse, names = found.coarse, [one.name for one in found.coarse.assembly.plant.parameters]
    stuck = coarse.at_bounds[[names.index(name) for name in found.masses]].any()
    if found.held_out_level <= AT_FLOOR or not stuck:
        return None
    assembly = replace(coarse.assembly, plant=with_wider_masses(coarse.assembly.plant, WIDER))
    wide = simulate_at(assembly, coarse.unknowns, task.fit, states=coarse.trajectory.states, smoothing=coarse.smoothing)
    if wide is None:
        return None
    free = node_of(fitted_either_way(wide, task.fit, iterations=ITERATIONS), task)
    return free if max(free.fit_level, free.held_out_level) <= AT_FLOOR else None


def needed_masses(node: Node, task: Task) -> Node:
    """The model with masses held again that the records do not ask for."""
    price = float(np.log(task.fit.drive.present.sum() + task.held_out.drive.present.sum()))
    while node.masses:
        assembly = node.coarse.assembly
        names = [one.name for one in assembly.plant.parameters]
        index = [names.index(name) for name in node.masses]
        spread = np.sqrt(np.diag(covariance(node.coarse, task.fit))[index])
        moved = np.abs(node.coarse.unknowns.common[index] - assembly.plant.nominal[index])
        sure = moved / np.where(spread > 0.0, spread, np.inf)
        weak = [name for name, z in zip(node.masses, sure, strict=True) if z**2 < price]
        smaller = _smaller(node, set(node.masses) - set(weak), task) if weak else None
        if smaller is None or smaller.coarse.cost > node.coarse.cost + price * len(weak):
            weak = [node.masses[int(np.argmin(sure))]]
            smaller = _smaller(node, set(node.masses) - set(weak), task)
        if smaller is None or smaller.coarse.cost > node.coarse.cost + price * len(weak):
            break
        node = smaller
    return polished(node, task)


def _smaller(node: Node, kept: Collection[str], task: Task) -> Node | None:
    start = _rebuilt(node.coarse, kept, task)
    return None if start is None else node_of(fitted_either_way(start, task.fit, iterations=ITERATIONS), task)


def _rebuilt(
    coarse: Estimate, masses: Collection[str], task: Task, *, linear: FloatArray | None = None
) -> Estimate | None:
    """The model with just these masses among its linear parameters, others at their nominal values."""
    before = coarse.assembly
    plant = with_masses(before.plant, masses)
    values = dict(zip([one.name for one in before.plant.parameters], coarse.unknowns.common, strict=False))
    if linear is not None:
        values |= dict(zip([one.name for one in before.plant.parameters], linear, strict=True))
    common = [values.get(one.name, one.nominal) for one in plant.parameters]
    assembly = replace(before, plant=plant)
    unknowns = Unknowns(
        common=np.concatenate([common, coarse.unknowns.common[before.n_linear :]]), local=coarse.unknowns.local
    )
    return simulate_at(assembly, unknowns, task.fit, states=coarse.trajectory.states, smoothing=coarse.smoothing)


LEAST_RATIO = 2.0
"""Take the grid's own error for as unknown as if it had been halved where only the smoothing was sharpened."""


def grid_error(node: Node) -> FloatArray:
    """Deviation of each common unknown that the steps of time may have left.

    Fitted on two grids, one `r` times as fine as the other, an unknown whose error is in proportion to the step still
    has 1 / (r - 1) of its change from one to the other as its error.

    Returns:
        (n_common,) in the unknowns' units; zero where there was one grid only, and
        for what is held at a bound.

    References:
        Richardson, Gaunt, The deferred approach to the limit, Phil. Trans. R. Soc. A 226, 1927,
        https://doi.org/10.1098/rsta.1927.0008
    """
    fine, coarse = node.fitted, node.coarse
    change = np.where(fine.at_bounds, 0.0, np.abs(fine.unknowns.common - coarse.unknowns.common))
    ratio = coarse.trajectory.drive.dt / fine.trajectory.drive.dt
    return np.asarray(change / (max(ratio, LEAST_RATIO) - 1.0))
