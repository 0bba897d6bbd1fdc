"""From the model that a user gives to a plant with ports, its simulation, and back to a model of the same type.

Structural models keep their M, C, K and take the effects. A control.StateSpace, an era.Realisation or what was
identified from a simulation program becomes a `PlantModel`: the same with ports, sensors of a kind and effects;
its plant is kept as it was made, so that the directions of forces, which have no names in a state space, stay those of
the file. What was found is written back into a model that simulates, saves and loads.
"""

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from modal.effects.catalogue import CATALOGUE
from modal.effects.effect import Effect, ForceEffect
from modal.simulation.assembly import Assembly, EffectPlacement, Unknowns, assemble, place_effect
from modal.simulation.drive import Drive, drive_of, steps_per_sample
from modal.simulation.plant import Plant, PlantMatrices, plant_matrices, released_masses
from modal.simulation.scheme import scheme_and_slopes
from modal.simulation.trajectory import resting_states, simulate_states
from modal.structure.model_file import KeptModel
from modal.structure.placed import PlacedEffect, equations_of_plant, law_of, placed_effect
from modal.structure.state_space_plant import state_space_plant, static_plant_of_records
from modal.structure.structural_model import SensorKind, StructuralModel
from modal.structure.structural_plant import structural_plant, updated_structure
from okid.arrays import FloatArray, frozen
from okid.display import first_names
from okid.errors import InvalidDataError, NumericalError
from okid.record import InputHold, Record

_NOMINAL: Any = None
"""Default of `linear`: the nominal values."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PlantModel(KeptModel):
    """A plant at given values of its linear parameters, with effects.

    Attributes:
        plant: The linear model with its places.
        linear: (n_parameters,) values of the linear parameters; the nominal ones unless given.
        effects: That were added by `with_effect`.

    Raises:
        InvalidDataError: Not one value a linear parameter.

    Example:
        >>> import control
        >>> system = control.ss([[0.0, 1.0], [-100.0, -0.4]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
        >>> model = PlantModel.from_state_space(system, sensor_kind="displacement", output_names=["tip"])
        >>> model.with_effect("coulomb_friction", "tip", Fc=0.02)
        PlantModel(2 states, inputs ['input_0'], outputs ['tip'], with coulomb_friction at tip)
    """

    plant: Plant
    _: KW_ONLY
    linear: FloatArray = _NOMINAL
    effects: tuple[PlacedEffect, ...] = ()

    def __post_init__(self) -> None:
        values = self.plant.nominal if self.linear is _NOMINAL else self.linear
        shape = (len(self.plant.parameters),)
        object.__setattr__(self, "linear", frozen(values, name="linear parameters", shape=shape))
        object.__setattr__(self, "effects", tuple(self.effects))

    def __repr__(self) -> str:
        effects = f", with {', '.join(f'{one.effect} at {one.where}' for one in self.effects)}" if self.effects else ""
        plant = self.plant
        return (
            f"PlantModel({plant.n_states} states, inputs {first_names(plant.input_names)}, outputs "
            f"{first_names(plant.output_names)}{effects})"
        )

    @classmethod
    def from_state_space(
        cls,
        system: Any,
        *,
        sensor_kind: SensorKind | Sequence[SensorKind],
        input_hold: InputHold = "zero_order",
        dt: float | None = None,
        records: Sequence[Record] = (),
        input_names: Sequence[str] = (),
        output_names: Sequence[str] = (),
        input_units: Sequence[str] = (),
        output_units: Sequence[str] = (),
        frequency_tolerance: float = 0.1,
        damping_tolerance: float = 0.5,
    ) -> "PlantModel":
        """The model of a state space.

        Args:
            system: `control.StateSpace`, `era.Realisation`, or anything with A, B, C, D and dt; minimal and stable.
                Without states it is a plant of imposed motion and measured force.
            sensor_kind: "displacement", "velocity" or "acceleration", one word or one an output.
            input_hold: Of the records, to convert a discrete system by.
            dt: Time step of the records [s], to check the system's against.
            records: Only for a plant without states: what tells which input is the derivative of which.
            input_names: "input_0", ... unless given.
            output_names: "output_0", ... unless given.
            input_units: "" unless given.
            output_units: "" unless given.
            frequency_tolerance: Standard deviation of the prior on the imaginary part of a pole, as a share of |pole|.
            damping_tolerance: Relative standard deviation of the prior on the real part of a pole.

        Raises:
            InvalidDataError: What `state_space_plant` refuses.
        """
        plant = state_space_plant(
            system,
            sensor_kind=sensor_kind,
            input_hold=input_hold,
            dt=dt,
            records=records,
            input_names=input_names,
            output_names=output_names,
            input_units=input_units,
            output_units=output_units,
            frequency_tolerance=frequency_tolerance,
            damping_tolerance=damping_tolerance,
        )
        return cls(plant)

    @property
    def matrices(self) -> PlantMatrices:
        """The matrices at `linear`."""
        return plant_matrices(self.plant, self.linear)

    def with_effect(self, effect: str | Effect, where: str, **values: float | Sequence[float]) -> "PlantModel":
        """The model with one more effect of the catalogue.

        A force acts in the first direction of its place: against the motion there, by a force per effective mass, and
        as little as possible elsewhere. A diagnosis finds the other components of the direction from data.

        Args:
            effect: Key in `modal.discrepancy.CATALOGUE`, or an effect of your own.
            where: Name of a place, of an input or of an output, as the effect asks for.
            **values: All parameters of the effect by name, in the units of the place; of a parameter that each record
                has a value of its own of, a number or one a record.

        Raises:
            InvalidDataError: No such effect or place, a parameter that is missing, unknown or out of its bounds.
        """
        return replace(self, effects=(*self.effects, placed_effect(self.plant, effect, where, values)))

    def equations(self, *, catalogue: Mapping[str, Effect] = CATALOGUE) -> str:
        """The equations with numbers and units, effects of the catalogue included, in plain text."""
        return equations_of_plant(self, catalogue=catalogue)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Given:
    """A model as it was given."""

    model: StructuralModel | PlantModel
    plant: Plant
    linear: FloatArray
    effects: tuple[PlacedEffect, ...]


def given_model(
    model: Any, records: Sequence[Record], *, sensor_kind: SensorKind | Sequence[SensorKind] | None = None
) -> Given:
    """The plant of a model.

    Args:
        model: `StructuralModel`, `PlantModel`, `era.Realisation`, `control.StateSpace`, or anything with A, B, C, D,
            dt.
        records: Records that it is to be compared with.
        sensor_kind: What the outputs of a state space are; by default from the units of the records' outputs, and
            "displacement" where they say nothing.

    Returns:
        The model with its plant.

    Raises:
        InvalidDataError: If it is no such model, or it and the records do not match.
    """
    if isinstance(model, StructuralModel):
        called = with_channel_names(model, records[0])
        plant = structural_plant(called)
        return Given(model=called, plant=plant, linear=plant.nominal, effects=called.effects)
    if isinstance(model, PlantModel):
        plant = static_plant_of_records(model.plant, records)
        return Given(model=model, plant=plant, linear=model.linear, effects=model.effects)
    if not all(hasattr(model, name) for name in "ABCD"):
        raise InvalidDataError(
            f"a model is a StructuralModel, a state space (control.StateSpace, era.Realisation) or a callable that "
            f"takes a Record and returns one; a {type(model).__name__} was given"
        )
    first = records[0]
    units = (*first.output_units, *[""] * first.n_outputs)[: first.n_outputs]
    kinds = tuple(_kind(unit) for unit in units) if sensor_kind is None else sensor_kind
    made = PlantModel.from_state_space(
        model,
        sensor_kind=kinds,
        input_hold=first.input_hold,
        dt=first.dt,
        records=tuple(records),
        input_names=first.input_names,
        output_names=first.output_names,
        input_units=first.input_units,
        output_units=first.output_units,
    )
    return Given(model=made, plant=made.plant, linear=made.linear, effects=())


def with_channel_names(model: StructuralModel, record: Record) -> StructuralModel:
    """The model with the record's names of inputs and outputs, where it has none of its own.

    Places are then called as the person who measured calls them ("tip" rather than "output_1"), as those of a state
    space are. Names that an element bears already, or that belong to another number of channels, are left alone.
    """
    taken = {element.name for element in model.elements} | {f"dof_{i}" for i in range(model.n_dofs)}
    new: dict[str, str] = {}
    for kind in ("input", "output"):
        ours, theirs = getattr(model, f"{kind}_names"), getattr(record, f"{kind}_names")
        nameless = ours == tuple(f"{kind}_{i}" for i in range(len(ours)))
        if nameless and len(ours) == len(theirs) and not taken.intersection(theirs):
            new |= dict(zip(ours, theirs, strict=True))
    inputs = tuple(new.get(name, name) for name in model.input_names)
    outputs = tuple(new.get(name, name) for name in model.output_names)
    if all(one == other for one, other in new.items()) or len({*inputs, *outputs}) < len(inputs + outputs):
        return model
    effects = tuple(replace(one, where=new.get(one.where, one.where)) for one in model.effects)
    return replace(model, effects=effects, input_names=inputs, output_names=outputs)


def _kind(unit: str) -> SensorKind:
    """What an output is, from its unit: per second is a velocity, per second squared (or g) an acceleration."""
    plain = unit.replace(" ", "").replace("^", "").replace("**", "").replace("²", "2")
    if plain.endswith(("/s2", "/s/s")) or plain in {"g", "gn", "mg"} or "s-2" in plain:
        return "acceleration"
    if plain.endswith("/s") or plain in {"rpm", "kn"} or "s-1" in plain:
        return "velocity"
    return "displacement"


def placed_assembly(
    plant: Plant,
    linear: FloatArray,
    effects: Sequence[PlacedEffect],
    drive: Drive,
    catalogue: Mapping[str, Effect] = CATALOGUE,
    *,
    initial: FloatArray | None = None,
) -> tuple[Assembly, Unknowns]:
    """A plant with its effects at their places, and the values of everything.

    The scales of the motion, in proportion to which sharp laws are smoothed, are those of the linear plant under the
    same inputs.

    Args:
        plant: The plant.
        linear: Values of its linear parameters.
        effects: Effects with values.
        drive: What drives it.
        catalogue: Where the effects are found.
        initial: (n_records, n_states) initial states; at rest by default.

    Returns:
        The assembly, and the unknowns.
    """
    begun = np.zeros((drive.n_records, plant.n_states)) if initial is None else initial
    placements = [
        _scaled(place_effect(plant, law_of(one, catalogue), one.where), plant, linear, drive, begun) for one in effects
    ]
    assembly = assemble(plant, placements)
    common = np.zeros(assembly.n_common)
    common[: assembly.n_linear] = linear
    local = np.zeros((drive.n_records, assembly.n_local))
    local[:, : plant.n_states] = begun
    for i, (item, one) in enumerate(zip(placements, effects, strict=True)):
        # the direction's first component is that of the force itself
        free = [part / one.direction[0] for part in one.direction[1:]] or [0.0] * item.n_directions
        common[assembly.common_of(i)] = [*(one.values[j] for j in item.common), *free[: item.n_directions]]
        for position, j in enumerate(item.local):
            own = one.local_values[j]
            values = own if len(own) == drive.n_records else (one.values[j],) * drive.n_records
            local[:, assembly.local_of(i).start + position] = values
    return assembly, Unknowns(common=common, local=local)


def _scaled(
    item: EffectPlacement, plant: Plant, linear: FloatArray, drive: Drive, initial: FloatArray
) -> EffectPlacement:
    if item.port is None:
        return item
    bare = assemble(plant)
    common = np.array(linear, dtype=float)
    scheme, _ = scheme_and_slopes(plant, common, drive.dt)
    unknowns = Unknowns(common=common, local=initial)
    trajectory = simulate_states(bare, unknowns, drive, scheme, resting_states(bare, drive))
    if trajectory is None:
        return item
    n = plant.n_states

    def size(row: FloatArray | None) -> float:
        if row is None:
            return 1.0
        return float(np.std(trajectory.states[:, :n] @ row[:n] + drive.sample @ row[n:])) or 1.0  # nothing moves

    return replace(item, displacement_scale=size(item.port.displacement), velocity_scale=size(item.port.velocity))


def returned_model(
    given: Given, assembly: Assembly, unknowns: Unknowns, deviations: FloatArray
) -> StructuralModel | PlantModel:
    """The model with what was found.

    Args:
        given: The model as given.
        assembly: The plant with the effects found.
        unknowns: All values.
        deviations: (n_common,) standard deviations of the common unknowns.

    Returns:
        A model of the same type, with calibrated linear parameters and the effects.
    """
    effects = tuple(_placed(assembly, unknowns, deviations, i) for i in range(len(assembly.placements)))
    linear = unknowns.common[: assembly.n_linear]
    if isinstance(given.model, StructuralModel):
        return replace(updated_structure(given.model, linear, released_masses(assembly.plant)), effects=effects)
    return replace(given.model, linear=linear, effects=effects)


def _placed(assembly: Assembly, unknowns: Unknowns, deviations: FloatArray, placement: int) -> PlacedEffect:
    item = assembly.placements[placement]
    values = unknowns.values(assembly, placement)
    spread = dict(zip(item.common, deviations[assembly.common_of(placement)], strict=False))
    direction = unknowns.directions(assembly, placement) if isinstance(item.effect, ForceEffect) else np.ones(1)
    return PlacedEffect(
        effect=item.effect.key,
        where=item.where,
        names=tuple(kind.name for kind in item.effect.parameters),
        values=tuple(float(np.mean(value)) for value in values),
        deviations=tuple(float(spread.get(j, np.nan)) for j in range(len(values))),
        local_values=tuple(
            tuple(float(one) for one in np.ravel(value)) if j in item.local else () for j, value in enumerate(values)
        ),
        direction=tuple(float(one) for one in direction) if len(direction) > 1 else (),
    )


def simulate(
    model: Any,
    record_or_inputs: Record | npt.ArrayLike,
    *,
    dt: float | None = None,
    input_hold: InputHold = "zero_order",
    initial_state: npt.ArrayLike | None = None,
    sensor_kind: SensorKind | Sequence[SensorKind] | None = None,
    catalogue: Mapping[str, Effect] = CATALOGUE,
) -> Record:
    """Simulate a model in free run.

    Args:
        model: `StructuralModel`, a model with effects, `control.StateSpace`, `era.Realisation`, or a callable that
            takes a Record and returns one.
        record_or_inputs: A record, whose inputs are used, or inputs (n_samples, n_inputs).
        dt: Sampling interval [s]; needed with plain inputs, taken from a record otherwise.
        input_hold: How plain inputs go on between samples; a record knows its own.
        initial_state: (n_states,) displacements then velocities of a structural model; at rest by default.
        sensor_kind: What the outputs of a state space are (it matters to effects only).
        catalogue: Where the model's effects are found.

    Returns:
        A record with the same inputs and simulated outputs.

    Raises:
        InvalidDataError: If the model and the inputs do not match.
        NumericalError: If the motion grows without bound or no simulation was found.

    Example:
        >>> import numpy as np
        >>> from modal.structure.structural_model import StructuralModel
        >>> model = StructuralModel.chain([1.0], [100.0], [0.4], force_dofs=[0], sensor_dofs=[0])
        >>> push = np.ones((4000, 1))
        >>> simulate(model, push, dt=0.01).outputs[-1].round(4)
        array([0.01])
        >>> stiffer = model.with_effect("cubic_stiffness", "element_0", k3=1e6)
        >>> simulate(stiffer, push, dt=0.01).outputs[-1].round(4)
        array([0.0068])
    """
    record = _record(record_or_inputs, dt, input_hold)
    if callable(model) and not hasattr(model, "A"):
        called = model(record)
        if not isinstance(called, Record) or called.n_samples != record.n_samples:
            raise InvalidDataError(
                f"a callable model takes a Record and returns one of as many samples ({record.n_samples}); "
                f"it returned {type(called).__name__}"
            )
        return called
    given = given_model(model, [record], sensor_kind=sensor_kind)
    plant = given.plant
    if record.n_inputs != plant.n_inputs:
        raise InvalidDataError(
            f"the model has {plant.n_inputs} inputs and the record has {record.n_inputs}; pass the same ones in the "
            f"same order ({', '.join(plant.input_names)})"
        )
    refuse_missing_inputs(record)
    blank = replace(
        record,
        outputs=np.zeros((record.n_samples, plant.n_outputs)),
        output_names=plant.output_names,
        output_units=plant.output_units,
    )
    drive = drive_of([blank], steps_per_sample(plant, given.linear, [blank]))
    initial = None if initial_state is None else _state(initial_state, plant.n_states)[np.newaxis]
    assembly, unknowns = placed_assembly(plant, given.linear, given.effects, drive, catalogue, initial=initial)
    scheme, _ = scheme_and_slopes(plant, unknowns.common[: assembly.n_linear], drive.dt)
    found = simulate_states(assembly, unknowns, drive, scheme, resting_states(assembly, drive))
    if found is None or not np.isfinite(found.outputs).all():
        raise NumericalError(
            "the model could not be simulated: its motion grows without bound under these inputs; lower the level, or "
            "check the signs of its effects"
        )
    return replace(blank, outputs=found.outputs)


def refuse_missing_inputs(record: Record) -> None:
    """Whether a model can be simulated along a record.

    Raises:
        InvalidDataError: If an input is missing somewhere.
    """
    missing = np.flatnonzero(np.isnan(record.inputs).any(axis=1))
    if len(missing):
        raise InvalidDataError(
            f"the inputs of record {record.name or 'without a name'} are missing (NaN) at {len(missing)} of "
            f"{record.n_samples} samples, first at number {missing[0] + 1}, so no model can be simulated along it; cut "
            "the record there, or fill them"
        )


def _record(given: Record | npt.ArrayLike, dt: float | None, input_hold: InputHold) -> Record:
    if isinstance(given, Record):
        return given
    inputs = np.asarray(given, dtype=float)
    if dt is None:
        raise InvalidDataError("plain inputs need a time step; pass dt in seconds, or a Record")
    return Record(inputs, np.zeros((len(inputs), 1)), dt, input_hold=input_hold)


def _state(given: npt.ArrayLike, n_states: int) -> FloatArray:
    state = np.asarray(given, dtype=float).reshape(-1)
    if len(state) != n_states:
        raise InvalidDataError(f"the model has {n_states} states and {len(state)} initial values were given")
    return state
