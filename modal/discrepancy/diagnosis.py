"""Find what a simulation lacks against measured records: floor, calibration, location, search, decision in one call.

And each stage of it by itself, for those who want to look before they go on.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from modal.discrepancy.fitting.estimation import Estimate, Problem, covariance, estimate, simulate_at
from modal.discrepancy.fitting.nodes import Node, fitted_either_way, node_of, polished
from modal.discrepancy.fitting.observer_form import LostMotion, observer_gain
from modal.discrepancy.noise.floor import noise_floor
from modal.discrepancy.programs.black_box import diagnose_callable
from modal.discrepancy.results import Calibrated, Diagnosis
from modal.discrepancy.selection.decision import Decision, decide_nodes, search_and_decide
from modal.discrepancy.selection.form_free import split_at_rest
from modal.discrepancy.selection.screening import Candidate, screen_candidates
from modal.discrepancy.setup import (
    Progress,
    Setup,
    check_plant,
    check_records,
    expected_search,
    fewest_samples,
    locate_gap,
    prepare_setup,
    roots,
    searched_parts,
    simulated_outputs,
)
from modal.discrepancy.validation.other_hold import by_the_better_hold, cut_into_spans, span_words
from modal.discrepancy.validation.summary import calibrated_parameters, diagnosis_of, with_cautions, with_findings
from modal.effects.catalogue import CATALOGUE, by_form
from modal.effects.effect import Effect
from modal.localisation.levels import LevelModes
from modal.simulation.drive import drive_of, steps_per_sample
from modal.simulation.scheme import cpu_seconds
from modal.structure.given import Given, given_model, placed_assembly, returned_model
from modal.structure.structural_model import SensorKind
from okid.arrays import FloatArray, listener, one_blas_thread
from okid.display import Displayed
from okid.errors import InvalidDataError, NumericalError
from okid.record import Record

UNKNOWN_STATES = 6
"""Take a callable, of which nobody knows how many states it has, for three degrees of freedom."""


def expected_diagnosis_work(
    model: Any, fit: Sequence[Record], held_out: Sequence[Record]
) -> tuple[tuple[float, float], float]:
    """CPU seconds, least and most, and bytes that `diagnose` will take without a budget, about."""
    black_box = callable(model) and not hasattr(model, "A")
    n_states = UNKNOWN_STATES if black_box else given_model(model, fit).plant.n_states
    return expected_search(fit, held_out, n_states)


def diagnose(
    model: Any,
    fit: Record | Sequence[Record],
    held_out: Record | Sequence[Record],
    *,
    catalogue: Mapping[str, Effect] = CATALOGUE,
    sensor_kind: SensorKind | Sequence[SensorKind] | None = None,
    progress: Progress | None = None,
    budget: float | None = None,
) -> Diagnosis:
    """Find where a simulation and measured records disagree, name the missing effect, and add it to the model.

    Deterministic: the same model and records give the same diagnosis.

    Args:
        model: `modal.StructuralModel`, `control.StateSpace`, `era.Realisation`, a model that an earlier diagnosis
            returned, or a callable that takes a Record and returns one with simulated outputs.
        fit: Records to fit, of several levels if there are any.
        held_out: Records to prove it on: another realisation, best at another level too.
        catalogue: The effects to try; `register` adds one of your own.
        sensor_kind: What the outputs of a state space are ("displacement", "velocity", "acceleration", one word or one
            an output); by default from the units of the records' outputs, "displacement" where they say nothing.
        progress: Called with a sentence and the share that is done.
        budget: CPU seconds after which nothing new is begun; what was found by then is told, unresolved where
            something was left untried. A fit that runs is ended at its next iteration. With one, the same records may
            give another diagnosis on another machine. Without, the work of a search is bounded: it ends after one to
            two minutes of CPU time.

    Returns:
        What is missing, where, how sure that is, and the updated model.

    Raises:
        InvalidDataError: Model and records that do not match, no held-out record, an unstable model.
        InsufficientDataError: Records too short for the model.
        NumericalError: The model cannot be simulated along the records.

    References:
        Kerschen, Worden, Vakakis, Golinval, Past, present and future of nonlinear system identification in structural
        dynamics, Mech. Syst. Signal Process. 20, 2006, https://doi.org/10.1016/j.ymssp.2005.04.008; Noel, Kerschen,
        Nonlinear system identification in structural dynamics: 10 more years of progress, Mech. Syst. Signal Process.
        83, 2017, https://doi.org/10.1016/j.ymssp.2016.07.020
    """
    report = listener(progress)
    if budget is not None and not budget > 0.0:
        raise InvalidDataError(f"the budget is a positive number of CPU seconds, but {budget!r} was given")
    with one_blas_thread(), cpu_seconds(budget):
        found = _diagnosed(model, fit, held_out, catalogue=catalogue, sensor_kind=sensor_kind, report=report)

        def otherwise(
            fits: Sequence[Record], helds: Sequence[Record], tried: Mapping[str, Effect]
        ) -> Diagnosis:  # modes are those of the samples, whatever the inputs do between them
            return _diagnosed(
                model, fits, helds, catalogue=tried, sensor_kind=sensor_kind, report=report, modes=found.location.modes
            )

        return with_cautions(by_the_better_hold(found, otherwise, catalogue))


def _diagnosed(
    model: Any,
    fit: Record | Sequence[Record],
    held_out: Record | Sequence[Record],
    *,
    catalogue: Mapping[str, Effect],
    sensor_kind: SensorKind | Sequence[SensorKind] | None,
    report: Progress,
    modes: LevelModes | None = None,
) -> Diagnosis:
    if not isinstance(catalogue, Mapping):
        raise InvalidDataError(
            f"the catalogue is a mapping from keys to effects and a {type(catalogue).__name__} was given; pass e.g. "
            "{key: CATALOGUE[key] for key in keys}"
        )
    fits, helds, notes = check_records(fit, held_out)
    black_box = callable(model) and not hasattr(model, "A")
    given = None if black_box else given_model(model, fits, sensor_kind=sensor_kind)
    fits, helds, more = searched_parts(fits, helds, UNKNOWN_STATES if given is None else given.plant.n_states)
    notes += more
    if given is None:
        return diagnose_callable(
            model, fits, helds, catalogue=catalogue, sensor_kind=sensor_kind, progress=report, notes=notes
        )
    whole = prepare_setup(given, fits, helds, catalogue, report, whole=True)
    try:
        return _searched(whole, notes, modes)
    except LostMotion:
        cut = _in_spans(whole)
        return _searched(cut, (*notes, span_words(cut.fit)), None)


def _in_spans(whole: Setup) -> Setup:
    """The same on spans of the records."""
    fewest = fewest_samples(whole.given.plant)
    spans, origin = cut_into_spans((*whole.fit, *whole.held_out), whole.floor.variance, fewest=2 * fewest)
    n_fit = sum(position < len(whole.fit) for position in origin)
    task, floor = whole.task, whole.floor.of_records(origin)
    task.report("once more on spans of the records", 0.05)
    return prepare_setup(whole.given, spans[:n_fit], spans[n_fit:], task.every_effect, task.report, floor=floor)


def _searched(setup: Setup, notes: tuple[str, ...], modes: LevelModes | None) -> Diagnosis:
    """Everything from calibration to the words.

    Raises:
        LostMotion: The records are whole, and the motion cannot be followed along them.
    """
    as_given, root = roots(setup)
    location = locate_gap(setup, root, modes)
    setup, nodes, as_given, decision = search_and_decide(setup, as_given, root)
    return diagnosis_of(setup, as_given, nodes, decision, location=location, notes=notes)


Records = Record | Sequence[Record]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Fitted(Displayed):
    """A model fitted to records.

    Attributes:
        model: The model with fitted parameters.
        level: Mean square of the residual in units of the noise floor, over all records and outputs alike.
        mean_square: (n_records, n_outputs) the same, one by one.
        calibrated: The linear parameters.
        simulated: (n_samples, n_outputs) of each record.
    """

    model: Any
    level: float
    mean_square: FloatArray
    calibrated: tuple[Calibrated, ...]
    simulated: tuple[FloatArray, ...]


def fit(
    model: Any,
    records: Records,
    *,
    floor: FloatArray | None = None,
    sensor_kind: SensorKind | Sequence[SensorKind] | None = None,
    catalogue: Mapping[str, Effect] = CATALOGUE,
) -> Fitted:
    """Fit the linear parameters, the initial states and the parameters of the effects that a model has.

    Args:
        model: As for `diagnose`, but no callable.
        records: Records to fit.
        floor: (n_records, n_outputs) noise variance; estimated by default.
        sensor_kind: What the outputs of a state space are.
        catalogue: Where the model's effects are found.

    Returns:
        The fitted model.

    Raises:
        InvalidDataError: Model and records that do not match.
        NumericalError: A model that cannot be simulated along the records.

    Example:
        >>> from modal.structure.given import simulate
        >>> from modal.structure.structural_model import StructuralModel
        >>> truth = StructuralModel.chain([1.0], [100.0], [0.4], force_dofs=[0], sensor_dofs=[0])
        >>> push = np.random.default_rng(1).standard_normal((800, 1))
        >>> record = simulate(truth, push, dt=0.02)
        >>> guess = StructuralModel.chain([1.0], [104.0], [0.5], force_dofs=[0], sensor_dofs=[0])
        >>> fit(guess, record, floor=np.array([[1e-10]])).model.stiffness.round(3)
        array([[100.]])
    """
    chosen = (records,) if isinstance(records, Record) else tuple(records)
    given, found, problem = _estimated(model, chosen, floor, sensor_kind, catalogue, forces=False)
    spread = covariance(found, problem)
    chance = np.sqrt(np.maximum(np.diag(spread)[: found.assembly.n_common], 0.0))
    deviations = np.hypot(chance, split_at_rest(found, spread)[0])
    return Fitted(
        model=returned_model(given, found.assembly, found.unknowns, deviations),
        level=found.level,
        mean_square=found.mean_square,
        calibrated=calibrated_parameters(found, deviations),
        simulated=simulated_outputs(found, chosen),
    )


def calibrate(
    model: Any,
    records: Records,
    *,
    floor: FloatArray | None = None,
    sensor_kind: SensorKind | Sequence[SensorKind] | None = None,
) -> Fitted:
    """Fit the linear parameters and the initial states of a model, taken without its effects.

    Args:
        model: As for `diagnose`, but no callable.
        records: Records to fit.
        floor: (n_records, n_outputs) noise variance; estimated by default.
        sensor_kind: What the outputs of a state space are.

    Returns:
        The calibrated linear model.

    Raises:
        InvalidDataError: Model and records that do not match.
    """
    linear = replace(model, effects=()) if getattr(model, "effects", ()) else model
    return fit(linear, records, floor=floor, sensor_kind=sensor_kind)


def screen(
    model: Any,
    records: Records,
    *,
    catalogue: Mapping[str, Effect] = CATALOGUE,
    floor: FloatArray | None = None,
    sensor_kind: SensorKind | Sequence[SensorKind] | None = None,
) -> tuple[Candidate, ...]:
    """Score every effect at every place against what a model leaves after its own fit.

    Args:
        model: As for `diagnose`, but no callable.
        records: Records to fit.
        catalogue: The effects to score.
        floor: (n_records, n_outputs) noise variance; estimated by default.
        sensor_kind: What the outputs of a state space are.

    Returns:
        Candidates, best first: `key`, `where`, `fall` (share of what is left that a first step would take away).

    Raises:
        InvalidDataError: Model and records that do not match.
    """
    chosen = (records,) if isinstance(records, Record) else tuple(records)
    _, found, problem = _estimated(model, chosen, floor, sensor_kind, CATALOGUE)
    gain = observer_gain(found, problem)
    observed = simulate_at(
        found.assembly, found.unknowns, problem, states=found.trajectory.states, gain=gain, smoothing=found.smoothing
    )
    return screen_candidates(found if observed is None else observed, problem, by_form(catalogue)[0])


def decide(
    models: Sequence[Any],
    fit: Records,
    held_out: Records,
    *,
    sensor_kind: SensorKind | Sequence[SensorKind] | None = None,
    catalogue: Mapping[str, Effect] = CATALOGUE,
) -> Decision:
    """Choose among models with different effects by held-out records.

    A model whose linear part explains the data may come back with a gain that its free calibration has taken up, as
    from `diagnose`.

    Args:
        models: The model without further effects first, then others with some (`with_effect`); all of them are fitted.
        fit: Records to fit.
        held_out: Held-out records.
        sensor_kind: What the outputs of a state space are.
        catalogue: Where the models' effects are found.

    Returns:
        The decision: status, findings, the chosen model as a node, margins, reasons, what it leaves.

    Raises:
        InvalidDataError: No model, or models and records that do not match.
    """
    if not models:
        raise InvalidDataError("there is no model to decide on; pass the plain one first, then those with effects")
    fits, helds, _ = check_records(fit, held_out)
    nodes: list[Node] = []
    floor = noise_floor([*fits, *helds])
    for model in models:
        given = given_model(model, fits, sensor_kind=sensor_kind)
        setup = prepare_setup(given, fits, helds, catalogue, lambda *_: None, floor=floor)
        assembly, unknowns = placed_assembly(given.plant, given.linear, given.effects, setup.task.fit.drive, catalogue)
        start = simulate_at(assembly, unknowns, setup.task.fit)
        if start is None:
            raise NumericalError(f"{model!r} could not be simulated along the records to fit; check its effects")
        nodes.append(polished(node_of(estimate(start, setup.task.fit, iterations=12), setup.task), setup.task))
    # among the models given: none of unknown form beside them
    return with_findings(decide_nodes(nodes, replace(setup.task, form_free={}), setup.fit), nodes[0], setup)


def _estimated(
    model: Any,
    records: tuple[Record, ...],
    floor: FloatArray | None,
    sensor_kind: SensorKind | Sequence[SensorKind] | None,
    catalogue: Mapping[str, Effect],
    *,
    forces: bool = True,
) -> tuple[Given, Estimate, Problem]:
    """A model fitted to records, `forces` where others than its own effects are to act."""
    given = given_model(model, records, sensor_kind=sensor_kind)
    check_plant(given.plant, given.linear, records)
    variance = noise_floor(records).variance if floor is None else floor
    steps = steps_per_sample(given.plant, given.linear, records, forces=forces or bool(given.effects))
    drive = drive_of(records, steps)
    problem = Problem(drive=drive, floor=variance)
    assembly, unknowns = placed_assembly(given.plant, given.linear, given.effects, drive, catalogue)
    start = simulate_at(assembly, unknowns, problem)
    if start is None:
        raise NumericalError(
            "the model could not be simulated along the records: its motion grows without bound; check the units of "
            "the inputs and the signs of its effects"
        )
    return given, fitted_either_way(start, problem, iterations=15), problem
