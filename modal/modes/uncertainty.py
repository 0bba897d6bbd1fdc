"""How far every number of an identification can be trusted: standard deviations, and intervals from them.

Two ways lead to the same type: the curvature of the output error at a refined model, and first-order propagation
through OKID and ERA (`modal.estimation.propagation`).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy

from okid.arrays import FloatArray, frozen_with_gaps
from okid.errors import InvalidDataError

__all__ = ["Uncertainty", "UncertaintyMethod"]

UncertaintyMethod = Literal["output error", "propagation"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Uncertainty:
    """Standard deviations of modes and Markov parameters; nan where one is not known.

    Attributes:
        method: "output error" or "propagation".
        frequency_std: (n_modes,) [Hz], in the order of the modes that were asked for.
        damping_ratio_std: (n_modes,); 0 for a real pole, whose damping ratio is 1 by definition.
        shape_std: (n_modes, n_outputs) root of the mean square distance of each complex component from its own mean, of
            shapes normalised as `Mode.shape`: the largest component is 1 and has none.
        markov_std: (n_lags + 1, n_outputs, n_inputs) of the system Markov parameters, in their unit.
        degrees_of_freedom: of the residuals that the noise was estimated from; infinite where it is known.

    Raises:
        InvalidDataError: arrays that do not fit together, or no positive number of degrees of freedom.

    Example:
        >>> known = Uncertainty(method="propagation", frequency_std=[0.1], damping_ratio_std=[0.01],
        ...                     shape_std=[[0.0]], markov_std=[[[0.1]]])
        >>> round(known.interval_factor(0.95), 3)
        1.96
    """

    method: UncertaintyMethod
    frequency_std: FloatArray
    damping_ratio_std: FloatArray
    shape_std: FloatArray
    markov_std: FloatArray
    degrees_of_freedom: float = np.inf

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "frequency_std", frozen_with_gaps(self.frequency_std, name="frequency_std", shape=(None,)))
        n_modes = self.frequency_std.size
        shapes: dict[str, tuple[int | None, ...]] = {
            "damping_ratio_std": (n_modes,),
            "shape_std": (n_modes, None),
            "markov_std": (None, None, None),
        }
        for name, shape in shapes.items():
            set_(self, name, frozen_with_gaps(getattr(self, name), name=name, shape=shape))
        if not self.degrees_of_freedom > 0:
            raise InvalidDataError(f"degrees_of_freedom must be positive, but is {self.degrees_of_freedom}.")

    def interval_factor(self, level: float = 0.95) -> float:
        """Half the width of the symmetric interval that covers with probability `level`, in standard deviations.

        Student's t with the residuals' degrees of freedom; the normal quantile where these are infinite.

        Raises:
            InvalidDataError: a level that does not lie between 0 and 1.
        """
        if not 0.0 < level < 1.0:
            raise InvalidDataError(f"a level must lie between 0 and 1, but is {level!r}; 0.95 is usual.")
        tail = 0.5 * (1.0 + level)
        # scipy's quantile of the t distribution is not defined at infinity
        if np.isinf(self.degrees_of_freedom):
            return float(scipy.special.ndtri(tail))
        return float(scipy.special.stdtrit(self.degrees_of_freedom, tail))
