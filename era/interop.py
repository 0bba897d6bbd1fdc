"""Passage to and from python-control."""

from typing import Any

import numpy as np

from era.realisation import Realisation
from okid.errors import InvalidDataError

__all__ = ["from_control", "to_control"]


def to_control(realisation: Realisation) -> Any:
    """`control.StateSpace` with the same matrices and time step.

    Example:
        >>> to_control(Realisation([[0.5]], [[1.0]], [[2.0]], [[0.0]], 0.01)).dt
        0.01
    """
    import control

    model = realisation
    return control.StateSpace(model.A, model.B, model.C, model.D, model.dt, remove_useless_states=False)


def from_control(system: object) -> Realisation:
    """Realisation of a discrete-time linear system of python-control.

    Args:
        system: `control.StateSpace`, or a transfer function that `control.ss` can convert.

    Raises:
        InvalidDataError: not a linear system, continuous time, or no time step in seconds.

    Example:
        >>> import control
        >>> from_control(control.ss([[0.5]], [[1.0]], [[2.0]], [[0.0]], 0.01)).order
        1
    """
    import control

    given: Any = system
    if not isinstance(given, control.StateSpace):
        try:
            given = control.ss(given)
        except Exception as error:
            raise InvalidDataError(
                f"a realisation is made from a linear system of python-control, but {type(given).__name__} cannot be "
                f"converted ({error}); pass a control.StateSpace."
            ) from error
    dt = given.dt
    if dt is not None and not isinstance(dt, bool) and dt == 0:
        raise InvalidDataError(
            "a realisation is discrete in time, but this system is continuous; discretise it first, for example "
            "control.sample_system(system, dt, method='zoh')."
        )
    if dt is None or isinstance(dt, bool):
        raise InvalidDataError(
            f"a realisation needs a time step in seconds, but this system has dt={dt}; give it one, for example "
            "control.ss(A, B, C, D, 0.01)."
        )
    A, B, C, D = (np.asarray(part, dtype=np.float64) for part in (given.A, given.B, given.C, given.D))
    return Realisation(A, B, C, D, float(dt))
