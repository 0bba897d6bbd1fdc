"""A plant with effects at its places, and the layout of everything in it that is unknown.

Unknowns come in two kinds. Common to all records: the linear parameters, the effects' parameters and, where the
direction of a force is not known, its components. Of each record: its initial state and what an effect has of its own
in each record (the phase of a disturbance).

A delayed drive comes from before the record at first, where nothing is known of it. The initial state makes up for that
from then on; until then the outputs are as good as missing. Where a record starts without a drive there was none.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from modal.effects.effect import Effect, ForceEffect, InputEffect, SensorEffect
from modal.simulation.drive import Drive
from modal.simulation.plant import Plant, Port, plant_matrices
from okid.arrays import BoolArray, FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class EffectPlacement:
    """An effect at a place.

    Attributes:
        effect: The effect.
        where: Name of the place: a port, an input or an output.
        port: The port of a force, None for an input or an output.
        channel: Index of the input or output, -1 for a force.
        displacement_scale: Standard deviation of the port's displacement over the records to fit.
        velocity_scale: Likewise of its velocity.
        held: Indices of parameters that stay at their neutral value, because the linear parameters stand for them.
    """

    effect: Effect
    where: str
    port: Port | None = None
    channel: int = -1
    displacement_scale: float = 1.0
    velocity_scale: float = 1.0
    held: tuple[int, ...] = ()

    @property
    def common(self) -> tuple[int, ...]:
        """Indices of the effect's parameters that all records share."""
        return tuple(j for j, kind in enumerate(self.effect.parameters) if not kind.local)

    @property
    def local(self) -> tuple[int, ...]:
        """Indices of the effect's parameters that each record has for itself."""
        return tuple(j for j, kind in enumerate(self.effect.parameters) if kind.local)

    @property
    def n_memory(self) -> int:
        """Number of states of the effect itself."""
        return self.effect.n_memory

    @property
    def force_and_port(self) -> tuple[ForceEffect, Port]:
        """The effect and its port, for a placement that `Assembly.forces` lists."""
        return cast("ForceEffect", self.effect), cast("Port", self.port)

    @property
    def input_effect(self) -> InputEffect:
        """The effect, for a placement that `Assembly.inputs` lists."""
        return cast("InputEffect", self.effect)

    @property
    def sensor_effect(self) -> SensorEffect:
        """The effect, for a placement that `Assembly.sensors` lists."""
        return cast("SensorEffect", self.effect)

    @property
    def n_own(self) -> int:
        """Number of unknowns that each record has for itself: the initial memory and the local parameters."""
        return self.n_memory + len(self.local)

    @property
    def n_directions(self) -> int:
        """Number of free components of the force's direction."""
        return 0 if self.port is None else len(self.port.columns) - 1


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Assembly:
    """A plant with effects."""

    plant: Plant
    placements: tuple[EffectPlacement, ...]

    @property
    def forces(self) -> tuple[int, ...]:
        """Indices of the placements that are forces, or sensors that remember."""
        return tuple(i for i, item in enumerate(self.placements) if item.port is not None)

    @property
    def inputs(self) -> tuple[int, ...]:
        """Indices of the placements that change an input: gain, then limit, then delay, whatever their order."""
        return tuple(i for i, item in enumerate(self.placements) if isinstance(item.effect, InputEffect))

    @property
    def sensors(self) -> tuple[int, ...]:
        """Indices of the placements that change an output at once."""
        return tuple(
            i for i, item in enumerate(self.placements) if isinstance(item.effect, SensorEffect) and item.port is None
        )

    @property
    def n_memory(self) -> int:
        """Number of states of the effects themselves."""
        return sum(item.n_memory for item in self.placements)

    @property
    def n_linear(self) -> int:
        """Number of linear parameters."""
        return len(self.plant.parameters)

    def stiffness_parameter(self, placement: int) -> int | None:
        """Index of the linear parameter that is the stiffness at a force's place, None where there is none."""
        names = [parameter.name for parameter in self.plant.parameters]
        wanted = f"stiffness of {self.placements[placement].where}"
        return names.index(wanted) if wanted in names else None

    def common_of(self, placement: int) -> slice:
        """Where the common unknowns of a placement stand: its parameters, then its directions."""
        first = self.n_linear + sum(len(item.common) + item.n_directions for item in self.placements[:placement])
        item = self.placements[placement]
        return slice(first, first + len(item.common) + item.n_directions)

    def own_of(self, placement: int) -> slice:
        """Where a record's own unknowns of a placement stand: its initial memory, then its local parameters."""
        first = self.plant.n_states + sum(item.n_own for item in self.placements[:placement])
        return slice(first, first + self.placements[placement].n_own)

    def local_of(self, placement: int) -> slice:
        """Where the local parameters of a placement stand among a record's own unknowns."""
        own = self.own_of(placement)
        return slice(own.start + self.placements[placement].n_memory, own.stop)

    def memory_of(self, placement: int) -> slice:
        """Where a placement's own states stand among all states, after those of the plant."""
        first = self.plant.n_states + sum(item.n_memory for item in self.placements[:placement])
        return slice(first, first + self.placements[placement].n_memory)

    @property
    def initial(self) -> tuple[int, ...]:
        """Where the initial value of each state, of the plant and of the effects, stands among a record's unknowns."""
        found = list(range(self.plant.n_states))
        for i in self.forces:
            first = self.own_of(i).start
            found += range(first, first + self.placements[i].n_memory)
        return tuple(found)

    @property
    def n_common(self) -> int:
        """Number of common unknowns."""
        return self.n_linear + sum(len(item.common) + item.n_directions for item in self.placements)

    @property
    def n_local(self) -> int:
        """Number of unknowns of each record."""
        return self.plant.n_states + sum(item.n_own for item in self.placements)

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Hard bounds (n_common,) of the common unknowns."""
        lower = [parameter.lower for parameter in self.plant.parameters]
        upper = [parameter.upper for parameter in self.plant.parameters]
        for item in self.placements:
            kinds, neutral = item.effect.parameters, item.effect.neutral
            lower += [neutral[j] if j in item.held else kinds[j].lower for j in item.common]
            upper += [neutral[j] if j in item.held else kinds[j].upper for j in item.common]
            lower += [-np.inf] * item.n_directions
            upper += [np.inf] * item.n_directions
        return np.array(lower), np.array(upper)

    def prior(self) -> tuple[FloatArray, FloatArray]:
        """Centre and standard deviation (n_common,) of the weak priors; infinite where there is none."""
        centre = np.zeros(self.n_common)
        deviation = np.full(self.n_common, np.inf)
        centre[: self.n_linear] = self.plant.nominal
        deviation[: self.n_linear] = [parameter.deviation for parameter in self.plant.parameters]
        return centre, deviation

    def local_deviation(self) -> FloatArray:
        """Standard deviation (n_local,) of the weak priors about zero: an effect's initial memory has the motion's."""
        deviation = np.full(self.n_local, np.inf)
        for i, item in enumerate(self.placements):
            first = self.own_of(i).start
            scales = (item.displacement_scale, *[item.velocity_scale] * max(item.n_memory - 1, 0))
            deviation[first : first + item.n_memory] = scales[: item.n_memory]
        return deviation

    def largest_own(self, local: FloatArray, drive: Drive) -> FloatArray:
        """(n_records, n_local) hard bounds on the size of each record's own unknowns, at their values now.

        A hysteretic link is loaded by motion: where a record begins, by no more than the motion there. Were its load
        free in each record, a link that never gives way would be a free constant force in each, the held-out ones
        too, and would explain a sensor whose zero moves.
        """
        most = np.full(local.shape, np.inf)
        for i in self.links:
            item = self.placements[i]
            displacement, velocity = self.begun(i, local, drive)
            most[:, self.own_of(i).start] = np.hypot(
                displacement, velocity * item.displacement_scale / item.velocity_scale
            )
        return most

    @property
    def links(self) -> tuple[int, ...]:
        """Indices of the placements whose memory is a load, whatever the pace at which it came."""
        return tuple(i for i in self.forces if self.placements[i].effect.rate_independent)

    def begun(self, placement: int, local: FloatArray, drive: Drive) -> tuple[FloatArray, FloatArray]:
        """(n_records,) displacement and velocity at a force's place where each record begins."""
        _, port = self.placements[placement].force_and_port
        at = np.hstack([local[:, : self.plant.n_states], drive.sample[list(drive.firsts[:-1])]])
        displacement, velocity = (
            np.zeros(len(at)) if row is None else at @ row for row in (port.displacement, port.velocity)
        )
        return displacement, velocity


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Unknowns:
    """Values of all that is unknown.

    Attributes:
        common: (n_common,) linear parameters, then each placement's parameters and directions.
        local: (n_records, n_local) initial state, then each placement's initial memory and values of the record.
    """

    common: FloatArray
    local: FloatArray

    def values(self, assembly: Assembly, placement: int) -> list[FloatArray]:
        """Values of a placement's parameters: one number each, or one a record where the parameter is local."""
        item = assembly.placements[placement]
        common = self.common[assembly.common_of(placement)]
        local = self.local[:, assembly.local_of(placement)]
        found: list[FloatArray] = [np.empty(0)] * len(item.effect.parameters)
        for position, j in enumerate(item.common):
            found[j] = common[position]
        for position, j in enumerate(item.local):
            found[j] = local[:, position]
        return found

    def directions(self, assembly: Assembly, placement: int) -> FloatArray:
        """Components (1 + n_directions,) of a force over the columns of its port."""
        item = assembly.placements[placement]
        free = self.common[assembly.common_of(placement)][len(item.common) :]
        return np.concatenate([[1.0], free])


def place_effect(
    plant: Plant, effect: Effect, where: str, *, displacement_scale: float = 1.0, velocity_scale: float = 1.0
) -> EffectPlacement:
    """Put an effect at a place of the plant.

    Raises:
        KeyError: If the plant has no such place for this kind of effect.
    """
    if not isinstance(effect, ForceEffect):
        names = plant.input_names if isinstance(effect, InputEffect) else plant.output_names
        if where not in names:
            raise KeyError(where)
        channel = names.index(where)
        port = _output_port(plant, channel) if isinstance(effect, SensorEffect) and effect.n_memory else None
        return EffectPlacement(
            effect=effect, where=where, port=port, channel=channel, displacement_scale=displacement_scale
        )
    return EffectPlacement(
        effect=effect,
        where=where,
        port=plant.port(where),
        displacement_scale=displacement_scale,
        velocity_scale=velocity_scale,
    )


def _output_port(plant: Plant, channel: int) -> Port:
    """An output as the place of a sensor that remembers: its displacement is the output."""
    matrices = plant_matrices(plant, plant.nominal)
    return Port(
        name=plant.output_names[channel],
        displacement=np.concatenate([matrices.C[channel], matrices.D[channel]]),
        velocity=None,
        columns=(0,),
        length_unit=plant.output_units[channel],
        force_unit=plant.output_units[channel],
        accepts=frozenset(),
    )


def assemble(plant: Plant, placements: Sequence[EffectPlacement] = ()) -> Assembly:
    """A plant with effects."""
    return Assembly(plant=plant, placements=tuple(placements))


def initial_unknowns(assembly: Assembly, n_records: int) -> Unknowns:
    """The plant's nominal parameters, records that start at rest, effects at zero."""
    common = np.zeros(assembly.n_common)
    common[: assembly.n_linear] = assembly.plant.nominal
    return Unknowns(common=common, local=np.zeros((n_records, assembly.n_local)))


STILL = 0.01
"""Take a drive that starts below this share of its root mean square for none before."""
MOST = 10
"""Leave out no more than this part of a record."""


def per_time(value: FloatArray, drive: Drive) -> FloatArray:
    """A parameter's value at every time: a number stays one, one value a record is spread over its times."""
    if np.ndim(value) == 0:
        return value
    return np.repeat(value, np.diff(drive.firsts))


def per_row(value: FloatArray, drive: Drive) -> FloatArray:
    """Likewise at every measured row."""
    return value if np.ndim(value) == 0 else np.repeat(value, np.diff(drive.row_firsts))


def drive_inputs(assembly: Assembly, unknowns: Unknowns, drive: Drive, *, first: int = 0) -> Drive:
    """The drive after the effects at the inputs, from the placement `first` on."""
    acting = [i for i in assembly.inputs if i >= first]
    if not acting:
        return drive
    start, end, sample = drive.start.copy(), drive.end.copy(), drive.sample.copy()
    present = drive.present.copy()
    for i in acting:
        item = assembly.placements[i]
        effect = item.input_effect
        values = unknowns.values(assembly, i)
        for record in range(drive.n_records):
            times = drive.times_of(record)
            at = (times, item.channel)
            felt = start[at]
            started = bool(felt.size) and abs(float(felt[0])) > STILL * float(np.sqrt(np.mean(felt**2)))
            _leave_out(present, drive, record, effect.unheard(values, drive.dt), started=started)
            sample[at] = effect.at_samples(values, sample[at], start[at], end[at], drive.dt)
            start[at], end[at] = effect.apply(values, start[at], end[at], drive.dt)
    return replace(drive, start=start, end=end, sample=sample, present=present)


def _leave_out(present: BoolArray, drive: Drive, record: int, unheard: tuple[int, int], *, started: bool) -> None:
    """Mark outputs at the start and at the end of a record as missing, a tenth of it at most."""
    rows, times = drive.rows_of(record), drive.times_of(record)
    length = times.stop - times.start
    early, late = (min(count, length // MOST) for count in unheard)
    at = drive.rows[rows] - times.start
    present[rows][(at < early) & started | (at >= length - late)] = False
