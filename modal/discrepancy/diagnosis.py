"""Find what a simulation lacks against measured records: floor, calibration, location, search, decision in one call."""

from collections.abc import Mapping, Sequence
from typing import Any

from modal.discrepancy.fitting.observer_form import LostMotion
from modal.discrepancy.programs.black_box import diagnose_callable
from modal.discrepancy.results import Diagnosis
from modal.discrepancy.selection.beam import search_effects
from modal.discrepancy.selection.decision import decide_nodes
from modal.discrepancy.selection.form_free import curves_beside
from modal.discrepancy.selection.lack_of_fit import only_noise
from modal.discrepancy.setup import (
    Progress,
    Setup,
    check_records,
    expected_search,
    fewest_samples,
    locate_gap,
    prepare_setup,
    roots,
    searched_parts,
    with_coloured_floor,
    with_uncovered_floor,
)
from modal.discrepancy.validation.cautions import with_cautions
from modal.discrepancy.validation.other_hold import by_the_better_hold, cut_into_spans, span_words
from modal.discrepancy.validation.summary import diagnosis_of
from modal.effects.catalogue import CATALOGUE
from modal.effects.effect import Effect
from modal.estimation.modal_states import one_blas_thread
from modal.localisation.levels import LevelModes
from modal.simulation.scheme import cpu_seconds
from modal.structure.checks import SensorKind
from modal.structure.given import given_model
from okid.errors import InvalidDataError
from okid.record import Record

__all__ = ["Progress", "diagnose", "expected_diagnosis_work"]

UNKNOWN_STATES = 6
"""Take a callable, of which nobody knows how many states it has, for three degrees of freedom."""


def _silent(what: str, share: float) -> None:
    del what, share


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
    report = _silent if progress is None else progress
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
    nodes = search_effects(root, setup.task, curves=curves_beside, settled=only_noise)
    location = locate_gap(setup, root, modes)
    setup, nodes, as_given = with_coloured_floor(*with_uncovered_floor(setup, nodes, as_given))
    setup.task.report("deciding", 0.9)
    decision = decide_nodes(nodes, setup.task, setup.fit)
    return diagnosis_of(setup, as_given, nodes, decision, location=location, notes=notes)
