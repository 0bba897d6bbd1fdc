"""Markov parameters: the response of a system to a pulse of one unit for one sample.

`system[0] = D`, `system[k] = C A^(k-1) B`; nothing is multiplied or divided by dt. With an observer gain,
`gain[0] = I`, `gain[k] = C A^(k-1) K`.
"""

from dataclasses import KW_ONLY, dataclass

import numpy as np

from okid.arrays import FloatArray, frozen
from okid.errors import InvalidDataError
from okid.scalars import time_step

__all__ = ["MarkovParameters"]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MarkovParameters:
    """Pulse response of a discrete-time system, recovered by OKID or given by hand (an impulse test is one already).

    Attributes:
        system: (n_lags + 1, n_outputs, n_inputs), output unit per input unit; lag 0 is the feedthrough D.
        dt: time step [s].
        gain: (n_lags + 1, n_outputs, n_outputs) Markov parameters of the observer gain, or None where there is none.
        input_scale: (n_inputs,) size of each input in its own unit, by which a realisation makes channels comparable;
            ones unless given.
        output_scale: (n_outputs,) the same for outputs.
        observer_order: order of the observer they were recovered from, None when they were measured directly.

    Raises:
        InvalidDataError: wrong shapes, values that are not finite, dt or scales that are not positive.

    Example:
        >>> MarkovParameters(system=[[[0.0]], [[1.0]], [[0.5]]], dt=0.01).n_lags
        2
    """

    _: KW_ONLY
    system: FloatArray
    dt: float
    gain: FloatArray | None = None
    input_scale: FloatArray = None  # type: ignore[assignment]  # ones once constructed
    output_scale: FloatArray = None  # type: ignore[assignment]
    observer_order: int | None = None

    def __post_init__(self) -> None:
        system = frozen(self.system, name="system Markov parameters")
        if system.ndim != 3:
            raise InvalidDataError(
                f"system Markov parameters must have shape (n_lags + 1, n_outputs, n_inputs), but have {system.shape}; "
                "those of one input and one output are given as .reshape(-1, 1, 1)."
            )
        if system.shape[0] < 2 or system.shape[1] < 1:
            raise InvalidDataError(
                f"Markov parameters need at least lags 0 and 1 and one output, but have shape {system.shape}."
            )
        dt = time_step(self.dt)
        n_outputs, n_inputs = system.shape[1:]
        object.__setattr__(self, "system", system)
        object.__setattr__(self, "dt", dt)
        if self.gain is not None:
            gain = frozen(self.gain, name="gain Markov parameters", shape=(system.shape[0], n_outputs, n_outputs))
            object.__setattr__(self, "gain", gain)
        object.__setattr__(self, "input_scale", _scale(self.input_scale, n_inputs, "input_scale"))
        object.__setattr__(self, "output_scale", _scale(self.output_scale, n_outputs, "output_scale"))

    def __repr__(self) -> str:
        return (
            f"MarkovParameters({self.n_lags} lags every {self.dt:.6g} s, {self.n_inputs} inputs, "
            f"{self.n_outputs} outputs, {'no gain' if self.gain is None else 'with gain'})"
        )

    @property
    def n_lags(self) -> int:
        """Number of lags beyond the feedthrough."""
        return self.system.shape[0] - 1

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        return self.system.shape[1]

    @property
    def n_inputs(self) -> int:
        """Number of inputs; 0 when only the gain is known (no input was measured)."""
        return self.system.shape[2]


def _scale(values: FloatArray | None, length: int, name: str) -> FloatArray:
    scale = frozen(np.ones(length) if values is None else values, name=name, shape=(length,))
    if not (scale > 0).all():
        raise InvalidDataError(f"{name} must be positive, but its smallest value is {scale.min()}.")
    return scale
