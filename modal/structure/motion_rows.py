"""What displacement and velocity each output of a state space shows, and whether there is one."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from modal.simulation.tolerances import ROUNDING
from modal.structure.continuous_time import ContinuousSystem
from modal.structure.structural_model import SensorKind
from okid.arrays import TINY, FloatArray
from okid.errors import InvalidDataError

__all__ = ["OutputMotion", "motion_of_outputs"]


_AT_ONCE = 0.5
"""Share of the largest velocity that an input calls up at any frequency: when it calls up that much at infinite
frequency, it moves the displacement at once. A structure gives 0, a first-order plant 1."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class OutputMotion:
    """The motion that an output shows.

    Attributes:
        nature: "mechanical": it has a displacement that no force moves at once; "shaft": it has a velocity only;
            "flow": a displacement (level) that a flow moves at once.
        displacement: Row over [x; u], None for a shaft.
        velocity: Row over [x; u], None for a flow.
        driven: (n_states,) what a force changes at once: the velocity's row over x, of a flow the displacement's.
        direct: (n_states,) how a direction of the states enters the output at once: `driven` for an accelerometer.
        unit: Unit of its displacement.
    """

    nature: Literal["mechanical", "shaft", "flow"]
    displacement: FloatArray | None
    velocity: FloatArray | None
    driven: FloatArray
    direct: FloatArray
    unit: str

    @property
    def force_unit(self) -> str:
        """Unit of a force per effective mass, or of a flow per area."""
        return f"{self.unit}/s" if self.nature == "flow" else f"{self.unit}/s^2"

    def less(self, other: "OutputMotion") -> "OutputMotion":
        """The difference to another output of the same nature."""
        return replace(
            self,
            displacement=_difference(self.displacement, other.displacement),
            velocity=_difference(self.velocity, other.velocity),
            driven=self.driven - other.driven,
            direct=self.direct - other.direct,
        )


def motion_of_outputs(
    system: ContinuousSystem, kinds: tuple[SensorKind, ...], units: tuple[str, ...]
) -> tuple[OutputMotion, ...]:
    """The motion that each output shows.

    Args:
        system: In a form in which the poles stand on the diagonal or near it.
        kinds: Sensor kind of each output.
        units: Unit of each output, "" where it is not known (then SI).

    Raises:
        InvalidDataError: An accelerometer on a system with an integrator that its reading does not show.
    """
    return tuple(_motion(system, output, kind, units[output]) for output, kind in enumerate(kinds))


def _motion(system: ContinuousSystem, output: int, kind: SensorKind, unit: str) -> OutputMotion:
    A, B, row, direct = system.A, system.B, system.C[output], system.D[output]
    none = np.zeros_like(direct)
    if kind == "displacement":
        displacement, velocity = np.concatenate([row, direct]), np.concatenate([row @ A, row @ B])
        held: FloatArray | None = row
    elif kind == "velocity":
        held = _antiderivative(system, row, direct)
        velocity = np.concatenate([row, direct])
        displacement = velocity if held is None else np.concatenate([held, none])
    else:
        rate = _antiderivative(system, row, direct)
        if rate is None:
            raise InvalidDataError(
                f"an integrator needs its displacement or velocity measured, but output {output} is an acceleration of "
                "a model with a pole at 0; measure one of them, or give the model as StructuralModel."
            )
        held = _antiderivative(system, rate, none)
        velocity = np.concatenate([rate, none])
        displacement = velocity if held is None else np.concatenate([held, none])
    n_states = len(A)
    length = _length_unit(unit, kind)
    mechanical = held is not None and n_states > 1 and not _moved_at_once(system, held)
    if not mechanical and kind == "displacement":
        return OutputMotion(
            nature="flow", displacement=displacement, velocity=None, driven=row, direct=np.zeros(n_states), unit=length
        )
    driven = velocity[:n_states]
    return OutputMotion(
        nature="mechanical" if mechanical else "shaft",
        displacement=displacement if mechanical else None,
        velocity=velocity,
        driven=driven,
        direct=driven if kind == "acceleration" else np.zeros(n_states),
        unit=length,
    )


def _antiderivative(system: ContinuousSystem, row: FloatArray, direct: FloatArray) -> FloatArray | None:
    """The row r with d/dt (r x) = row x + direct u; None where an integrator leaves it open."""
    poles = np.abs(np.linalg.eigvals(system.A))
    if poles.min() > ROUNDING * poles.max():
        return np.asarray(np.linalg.solve(system.A.T, row))
    # r A = row alone leaves r open along what the integrator holds; what the inputs do settles it where it can
    both = np.hstack([system.A, system.B])
    wanted = np.concatenate([row, direct])
    scale = np.maximum(np.linalg.norm(both, axis=0), TINY)
    found, _, rank, _ = np.linalg.lstsq((both / scale).T, wanted / scale, rcond=1e-12)
    misfit = np.abs(found @ both - wanted) / scale
    if rank < len(system.A) or misfit.max() > 1e-6 * np.abs(wanted / scale).max():
        return None
    return np.asarray(found)


def _moved_at_once(system: ContinuousSystem, row: FloatArray) -> bool:
    """Whether the inputs move row x at once, as they move a level, and not through its velocity."""
    size = np.linalg.norm(system.B, axis=0)
    at_once = np.divide(row @ system.B, size, out=np.zeros_like(size), where=size > 0)
    poles = np.abs(np.linalg.eigvals(system.A))
    poles = poles[poles > ROUNDING * poles.max()]
    if poles.size == 0 or not size.any():
        return False
    span = np.geomspace(poles.min() / 10, poles.max() * 10, 400)
    angular = np.unique(np.concatenate([span, *(poles * factor for factor in (0.98, 1.0, 1.02))]))
    moved = ContinuousSystem(A=system.A, B=system.B, C=row[None], D=np.zeros((1, len(size)))).response(angular)
    velocity = angular[:, None] * np.abs(moved[:, 0])
    velocity = np.divide(velocity, size, out=np.zeros_like(velocity), where=size > 0)
    return bool(np.linalg.norm(at_once) > _AT_ONCE * np.linalg.norm(velocity.max(axis=0)))


def _difference(first: FloatArray | None, second: FloatArray | None) -> FloatArray | None:
    return None if first is None or second is None else first - second


def _length_unit(unit: str, kind: SensorKind) -> str:
    """The unit of the displacement behind a reading; SI where the reading's unit is not known."""
    suffixes: dict[SensorKind, tuple[str, ...]] = {
        "displacement": ("",),
        "velocity": ("/s",),
        "acceleration": ("/s^2", "/s**2", "/s2", "/s²"),
    }
    if not unit:
        return "m"
    for suffix in suffixes[kind]:
        if unit.endswith(suffix):
            return unit.removesuffix(suffix)
    return f"{unit} s" if kind == "velocity" else f"{unit} s^2"
