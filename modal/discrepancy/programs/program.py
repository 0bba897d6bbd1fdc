"""A simulation program: a callable that takes a Record and returns one with simulated outputs; and its linear part.

What comes back is checked each time, because nothing else is known of the program: a wrong channel order, a missing
sample or a random number in it would pose as an effect.

The linear part is identified from the program's own noise-free outputs by OKID and ERA. Observer orders and model
orders are tried from small to large, and the smallest model is taken whose free run reproduces the program. Records
that drive too narrow a band do not determine the model outside it, so the program is then also run along a broadband
record of the same level.

With what it lacked it is the user's callable plus corrections, again a callable:

    y = S[ f(U[u]) + L*(u) - L(U[u]) + R(u) ]

f is the user's own program. U are the effects at the inputs and S those at the sensors: the program itself runs with
the changed input, so these are proved by it. A force effect acts inside the program, where nothing can be put in from
outside; what it does is the difference of two simulations: L* is the program's linear part (identified from its own
outputs) with the effects, at calibrated linear parameters where those count, and L the same part as it was identified.
R is a linear model of what is left, where no effect of the catalogue explains it.
"""

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace

import numpy as np

from era.balanced import decompose, order_choice, realise_from
from era.realisation import Realisation
from era.simulation import estimate_initial_state, simulate
from modal.discrepancy.fitting.estimation import Problem, simulate_at
from modal.discrepancy.noise.floor import SAME_NUMBER
from modal.effects.catalogue import CATALOGUE
from modal.effects.effect import Effect, InputEffect, SensorEffect, is_sharp
from modal.localisation.gap import SAME_LEVEL
from modal.simulation.assembly import drive_inputs
from modal.simulation.drive import drive_of, steps_per_sample
from modal.simulation.trajectory import SHARP
from modal.structure.given import PlantModel, placed_assembly
from modal.structure.placed import PlacedEffect, equations_of_plant
from okid.arrays import ROUNDED, FloatArray
from okid.errors import IdentificationError, IdentificationWarning, InvalidDataError, NumericalError
from okid.markov import recover_markov
from okid.observer import ObserverFit, fit_observer
from okid.record import Record

Simulator = Callable[[Record], Record]
"""Simulates along the inputs of a record; what the record measured is for its start at most."""


def run_callable(simulator: Simulator, record: Record) -> Record:
    """The record with the simulated outputs in place of the measured ones.

    Raises:
        InvalidDataError: It fails, returns no Record or one of another size, time step or order of outputs, or numbers
            that are not finite.

    Example:
        >>> def gain(record: Record) -> Record:
        ...     return replace(record, outputs=2.0 * record.inputs)
        >>> run_callable(gain, Record([1.0, 2.0], [0.0, 0.0], 0.1)).outputs.ravel()
        array([2., 4.])
    """
    name = _named(record)
    try:
        found = simulator(record)
    except Exception as error:
        raise InvalidDataError(
            f"the callable must simulate every record, but failed on {name} ({type(error).__name__}: {error}); call it "
            "with that record by itself and mend it."
        ) from error
    if not isinstance(found, Record):
        raise InvalidDataError(
            f"the callable must return a Record, but returned {type(found).__name__} for {name}; return "
            "dataclasses.replace(record, outputs=simulated)."
        )
    if found.outputs.shape != record.outputs.shape:
        raise InvalidDataError(
            f"the callable must return outputs of shape {record.outputs.shape} for {name}, but returned "
            f"{found.outputs.shape}; return one row a sample and one column an output of the record."
        )
    if abs(found.dt - record.dt) > SAME_NUMBER * record.dt:
        raise InvalidDataError(
            f"the callable must return {name} at its time step of {record.dt:.6g} s, but returned {found.dt:.6g} s; "
            "interpolate its outputs to the times of the record."
        )
    _check_order(found, record)
    bad = ~np.isfinite(found.outputs)
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise InvalidDataError(
            f"the callable must return finite outputs, but {record.output_names[column]!r} of {name} is "
            f"{found.outputs[row, column]} at sample {row} ({bad.sum()} such values); look for a motion that grows "
            "without bound or a division by zero."
        )
    return replace(record, outputs=found.outputs)


def check_deterministic(simulator: Simulator, record: Record, known: FloatArray) -> None:
    """Run it again along a record and compare.

    Args:
        simulator: Takes a Record and returns one.
        record: That it was run along.
        known: (n_samples, n_outputs) what it returned.

    Raises:
        InvalidDataError: It returns something else than before.
    """
    again = run_callable(simulator, record).outputs
    difference, size = float(np.abs(again - known).max()), float(np.abs(known).max())
    if difference > ROUNDED * size:
        raise InvalidDataError(
            f"the callable must return the same outputs each time, but two runs along {_named(record)} differ by "
            f"{difference:.3g} (largest output {size:.3g}); leave out simulated noise, or seed it in the callable."
        )


def _check_order(found: Record, record: Record) -> None:
    ours, theirs = record.output_names, found.output_names
    if ours != theirs and set(ours) == set(theirs):
        raise InvalidDataError(
            f"the callable must return the outputs in the order of the record ({', '.join(ours)}), but returned "
            f"{', '.join(theirs)}; return record.select(outputs=...) in that order."
        )


def _named(record: Record) -> str:
    return f"record {record.name!r}" if record.name else f"a record of {record.n_samples} samples"


OBSERVER_ORDERS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32)
"""Try these observer orders, the smallest first."""
THRESHOLDS = (1e-2, 1e-3, 1e-4, 1e-6, 1e-8, 1e-10)
"""Leave out Hankel singular values below these shares of the largest, one model each."""
MOST_STATES = 30
"""Try no model of more states than this."""
EXACT = 1e-6
"""Try no larger model once the free run misses this share: tolerances of integrators are of this size."""
AS_GOOD = 1.5
"""Prefer a smaller model to one whose free run misses by less than this factor less."""
STABLE = 1.0 + 1e-7
"""Reject a model with a pole beyond this radius."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class IdentifiedPart:
    """The linear part of a callable.

    Attributes:
        realisation: Discrete model at the time step of the records.
        miss: What its free run misses of the callable's outputs on the quietest records, relative, worst output.
    """

    realisation: Realisation
    miss: float


def identify_callable(
    simulator: Simulator, runs: Sequence[Record], *, usable: Callable[[Realisation], bool] = lambda _: True
) -> IdentifiedPart | None:
    """Identify the linear part about the quietest level.

    The smallest model that reproduces the callable as well as any; None where there is none.

    References:
        Juang, Phan, Horta, Longman, Identification of observer/Kalman filter Markov parameters: theory and experiments,
        J. Guid. Control Dyn. 16(2), 1993, https://doi.org/10.2514/3.21006; Juang, Pappa, An eigensystem realization
        algorithm for modal parameter identification and model reduction, J. Guid. Control Dyn. 8(5), 1985,
        https://doi.org/10.2514/3.20031

    Example:
        >>> def first_order(record: Record) -> Record:
        ...     level, outputs = 0.0, np.zeros_like(record.outputs)
        ...     for k, u in enumerate(record.inputs[:, 0]):
        ...         outputs[k], level = level, 0.9 * level + u
        ...     return replace(record, outputs=outputs)
        >>> push = np.random.default_rng(1).standard_normal(300)
        >>> part = identify_callable(first_order, [first_order(Record(push, np.zeros(300), 0.1))])
        >>> part.realisation.order, part.realisation.A.round(6)
        (1, array([[0.9]]))
    """
    quiet = quietest(runs)
    known, narrow = _best(quiet, quiet, usable)
    if known is not None and not narrow and known.miss <= EXACT:
        return known
    try:
        probed, _ = _best([run_callable(simulator, _probe(quiet[0]))], quiet, usable)
    except IdentificationError:
        # it may know nothing but the records (a table of stored runs)
        probed = None
    if probed is None or known is None:
        return known or probed
    # a narrow record is met by many models; the broadband one alone tells which
    return probed if probed.miss <= (max(3.0 * known.miss, 1e-3) if narrow else known.miss) else known


def quietest(records: Sequence[Record]) -> list[Record]:
    """The records whose inputs are within 10 % of the quietest."""
    levels = [_level(record) for record in records]
    least = min(levels)
    return [record for record, level in zip(records, levels, strict=True) if level <= SAME_LEVEL * least]


def relative_miss(realisation: Realisation, run: Record) -> FloatArray:
    """What the free run misses of the outputs, constant and initial state fitted.

    Returns:
        (n_outputs,) rms of the miss over the rms of the output about its mean; 0 where both rest.
    """
    # two rounds: the constant that the free response leaves is not that of the outputs
    constant = np.zeros(run.n_outputs)
    missed = run.outputs
    for _ in range(2):
        moved = replace(run, outputs=run.outputs - constant)
        state = estimate_initial_state(realisation, moved)
        missed = run.outputs - simulate(realisation, run, initial_state=state).outputs
        constant = missed.mean(axis=0)
    size, miss = run.outputs.std(axis=0), missed.std(axis=0)
    return np.where(size > 0.0, miss / np.where(size > 0.0, size, 1.0), np.where(miss > 0.0, np.inf, 0.0))


def _best(
    runs: Sequence[Record], judges: Sequence[Record], usable: Callable[[Realisation], bool]
) -> tuple[IdentifiedPart | None, bool]:
    """The smallest of the models that miss least, and whether the records drove too little to tell."""
    found: list[IdentifiedPart] = []
    narrow = False
    for observer, poor in _observers(runs):
        for realisation in _realisations(observer):
            try:
                miss = max(float(np.max(relative_miss(realisation, judge))) for judge in judges)
            except IdentificationError:
                continue
            if np.isfinite(miss) and usable(realisation):
                found.append(IdentifiedPart(realisation=realisation, miss=miss))
        least = min((part.miss for part in found), default=np.inf)
        narrow = poor
        if least <= EXACT:
            break
    if not found:
        return None, narrow
    enough = max(AS_GOOD * min(part.miss for part in found), EXACT)
    return min(
        (part for part in found if part.miss <= enough), key=lambda part: (part.realisation.order, part.miss)
    ), narrow


def _observers(runs: Sequence[Record]) -> Iterator[tuple[ObserverFit, bool]]:
    """An observer of each order, and whether the fit says that the inputs excite too little."""
    channels = runs[0].n_inputs + runs[0].n_outputs
    n_rows = sum(run.n_samples for run in runs)
    for order in OBSERVER_ORDERS:
        if 2 * order * channels > n_rows or min(run.n_samples for run in runs) <= 2 * order:
            return
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            try:
                observer = fit_observer(runs, order=order)
            except IdentificationError:
                continue
        poor = any(issubclass(one.category, IdentificationWarning) for one in said)
        yield observer, poor


def _realisations(observer: ObserverFit) -> Iterator[Realisation]:
    """Models of several orders by the Hankel singular values, from small to large."""
    try:
        found = decompose(recover_markov(observer, n_lags=max(120, 4 * observer.order)))
    except IdentificationError:
        return
    values, highest = found.singular_values, min(found.rank, found.max_order, MOST_STATES)
    orders = {order_choice(found).order, highest}
    if values.size and values[0] > 0.0:
        orders |= {int(np.count_nonzero(values > share * values[0])) for share in THRESHOLDS}
    for order in sorted(orders):
        if order <= highest:
            model = realise_from(found, order)
            if order == 0 or np.abs(np.linalg.eigvals(model.A)).max() <= STABLE:
                yield model


def _probe(quiet: Record) -> Record:
    """White noise of the size of a record's inputs about their means."""
    rng = np.random.default_rng(0)
    n_samples = max(min(quiet.n_samples, 4000), 400)
    mean, spread = np.nanmean(quiet.inputs, axis=0), np.nanstd(quiet.inputs, axis=0)
    largest = float(spread.max(initial=0.0))
    spread = np.where(spread > 0.0, spread, largest or 1.0)
    return replace(
        quiet,
        inputs=mean + spread * rng.standard_normal((n_samples, quiet.n_inputs)),
        outputs=np.zeros((n_samples, quiet.n_outputs)),
        name="broadband probe",
    )


def _level(record: Record) -> float:
    return float(np.sqrt(np.nansum(np.nanvar(record.inputs, axis=0))))


FINER, SHARPER = 4, SHARP / 5.0
"""Steps, and smoothing, for laws that jump."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CorrectedCallable:
    """The user's callable with the effects that it lacked.

    Attributes:
        simulator: The user's callable, as it was given.
        effects: What was found, in the order in which it was found.
        linear: Its linear part as it was identified; None where none was.
        correction: The linear part with the effects, but for those at the sensors; None where the callable itself, with
            changed inputs and outputs, is all.
        residual: Linear model of what is left, input to output; None where there is none.
        catalogue: Where the effects are found.

    Example:
        >>> from okid.record import Record
        >>> def gain(record: Record) -> Record:
        ...     return replace(record, outputs=2.0 * record.inputs)
        >>> bias = PlacedEffect(effect="sensor_bias", where="output_0", names=("offset", "slope"), values=(0.5, 0.0))
        >>> CorrectedCallable(gain, effects=(bias,))(Record([1.0, 2.0], [0.0, 0.0], 0.1)).outputs.ravel()
        array([2.5, 4.5])
    """

    simulator: Simulator
    _: KW_ONLY
    effects: tuple[PlacedEffect, ...] = ()
    linear: PlantModel | None = None
    correction: PlantModel | None = None
    residual: Realisation | None = None
    catalogue: Mapping[str, Effect] = field(default_factory=lambda: CATALOGUE)

    def __repr__(self) -> str:
        name = getattr(self.simulator, "__name__", type(self.simulator).__name__)
        parts = [f"{one.effect} at {one.where}" for one in self.effects]
        if self.residual is not None:
            parts.append(f"a linear model of order {self.residual.order} of what is left")
        return f"CorrectedCallable({name}{', with ' if parts else ''}{' and '.join(parts)})"

    def __call__(self, record: Record) -> Record:
        """The record with simulated outputs.

        Raises:
            InvalidDataError: What `run_callable` refuses.
            NumericalError: The correction grows without bound.
        """
        changed = self.changed_inputs(record)
        outputs = run_callable(self.simulator, changed).outputs
        return replace(record, outputs=self.completed(record, changed, outputs))

    def changed_inputs(self, record: Record) -> Record:
        """The record with the inputs as they reach the plant.

        A delay of a share of a sample cannot be held in the samples of a zero-order hold: each sample then has the mean
        of the input over its step.
        """
        chosen = [one for one in self.effects if isinstance(self.catalogue[one.effect], InputEffect)]
        if not chosen or self.linear is None:
            return record
        drive = drive_of([_blank(self.linear, record)])
        assembly, unknowns = placed_assembly(self.linear.plant, self.linear.linear, chosen, drive, self.catalogue)
        driven = drive_inputs(assembly, unknowns, drive)
        held = record.input_hold == "zero_order"
        return replace(record, inputs=(driven.start + driven.end) / 2.0 if held else driven.sample)

    def completed(self, record: Record, changed: Record, outputs: FloatArray) -> FloatArray:
        """What the callable gave for the changed record, with all that it lacks.

        Args:
            record: Record as measured.
            changed: From `changed_inputs`.
            outputs: (n_samples, n_outputs) of the callable along it.

        Returns:
            (n_samples, n_outputs).
        """
        found = np.array(outputs)
        if self.correction is not None and self.linear is not None:
            found += along_plant(self.correction, record, self.catalogue) - along_plant(
                self.linear, changed, self.catalogue
            )
        if self.residual is not None:
            found += simulate(self.residual, record).outputs
        time = record.dt * np.arange(record.n_samples, dtype=np.float64)
        for one in self.effects:
            effect = self.catalogue[one.effect]
            if isinstance(effect, SensorEffect):
                channel = record.output_names.index(one.where)
                found[:, channel] = effect.changed(one.values, found[:, channel], time)
        return found

    def equations(self) -> str:
        """The equations of the correction with numbers and units, in plain text."""
        model = self.correction or (None if self.linear is None else replace(self.linear, effects=self.effects))
        return "" if model is None else f"Linear part of {self!r}\n{equations_of_plant(model)}"


def along_plant(model: PlantModel, record: Record, catalogue: Mapping[str, Effect] = CATALOGUE) -> FloatArray:
    """Outputs of a plant with its effects along a record, from rest; laws that jump with finer steps.

    Returns:
        (n_samples, n_outputs).

    Raises:
        NumericalError: Its motion grows without bound.
    """
    sharp = any(is_sharp(catalogue[one.effect]) for one in model.effects)
    steps = steps_per_sample(model.plant, model.linear, [record]) * (FINER if sharp else 1)
    drive = drive_of([_blank(model, record)], steps)
    assembly, unknowns = placed_assembly(model.plant, model.linear, model.effects, drive, catalogue)
    problem = Problem(drive=drive, floor=np.ones((1, model.plant.n_outputs)))
    found = simulate_at(assembly, unknowns, problem, smoothing=SHARPER if sharp else SHARP)
    if found is None or not np.isfinite(found.trajectory.outputs).all():
        raise NumericalError(
            "the linear part of the callable with its effects could not be simulated: its motion grows without bound "
            "under these inputs; lower the level, or check the signs of its effects."
        )
    return found.trajectory.outputs


def _blank(model: PlantModel, record: Record) -> Record:
    return replace(record, outputs=np.zeros((record.n_samples, model.plant.n_outputs)))
