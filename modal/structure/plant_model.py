"""A model that is a plant with effects: what a state space becomes when it gets ports, sensors of a kind, and effects.

A StructuralModel keeps M, C and K; this is the same for a control.StateSpace, an era.Realisation, or a model that was
identified from a simulation program. The plant is kept as it was made, so that the directions of forces, which have no
names in a state space, stay those of the file.
"""

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from typing import Any

from modal.effects.catalogue import CATALOGUE
from modal.effects.effect import Effect
from modal.simulation.plant import Plant, PlantMatrices, plant_matrices
from modal.structure.equations import equations_of_plant
from modal.structure.model_file import KeptModel
from modal.structure.placed import PlacedEffect, placed_effect
from modal.structure.state_space_plant import state_space_plant
from modal.structure.structural_model import SensorKind
from okid.arrays import FloatArray, frozen
from okid.display import first_names
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
