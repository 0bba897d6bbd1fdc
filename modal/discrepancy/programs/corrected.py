"""A simulation program with what it lacked: the user's callable plus corrections, again a callable.

    y = S[ f(U[u]) + L*(u) - L(U[u]) + R(u) ]

f is the user's own program. U are the effects at the inputs and S those at the sensors: the program itself runs with
the changed input, so these are proved by it. A force effect acts inside the program, where nothing can be put in from
outside; what it does is the difference of two simulations: L* is the program's linear part (identified from its own
outputs) with the effects, at calibrated linear parameters where those count, and L the same part as it was identified.
R is a linear model of what is left, where no effect of the catalogue explains it.
"""

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field, replace

import numpy as np

from era.realisation import Realisation
from era.simulation import simulate
from modal.discrepancy.fitting.estimation import Problem, simulate_at
from modal.discrepancy.programs.program import Simulator, run_callable
from modal.effects.catalogue import CATALOGUE
from modal.effects.effect import Effect, InputEffect, SensorEffect, is_sharp
from modal.simulation.assembly import drive_inputs
from modal.simulation.drive import drive_of, steps_per_sample
from modal.simulation.trajectory import SHARP
from modal.structure.equations import equations_of_plant
from modal.structure.given import placed_assembly
from modal.structure.placed import PlacedEffect
from modal.structure.plant_model import PlantModel
from okid.arrays import FloatArray
from okid.errors import NumericalError
from okid.record import Record

__all__ = ["CorrectedCallable", "along_plant"]

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
