"""Integrating systems: sums of the inputs drive a stable model, and the integrators come back as states with pole 1.

A free mass under a force, a tank, a heated block without losses: the response to a pulse never dies out, and no stable
model of the inputs can say so. But y = G(z) / (1 - z^-1) u is G(z) driven by the running sum of u, and G is stable. An
output that does not integrate has a zero of G at z = 1 instead, so all inputs are summed alike. The unknown state of an
integrator and the unknown mean of its input are a constant and a straight line in its output (two integrators: and a
parabola); those are taken off the sums and off the outputs, which leaves their relation as it is (see
`modal.preparation.drift`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from era.realisation import Realisation
from modal.estimation.cross_validation import WITHIN
from modal.modes.modal_form import discrete_poles
from modal.modes.mode import Choice, ModalModel
from modal.preparation.drift import (
    SIGNIFICANT,
    FreedTrials,
    choose_drift,
    held_out_squares,
    is_significant,
    lasting_share,
    slow_motion,
)
from okid.arrays import FloatArray, whole_number
from okid.errors import InvalidDataError
from okid.record import Record

MOST = 2
"""Force to position is the most that mechanics asks for."""
AS_GOOD = 2.0
"""Ratio to what a stable model leaves beside a drift of more functions, up to which an integrator is preferred."""
LEAST_GAIN = 0.2
"""Part of that error which it must take off: where a slow pole does as well, it is no integrator."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Integrators:
    """How often the system integrates its inputs."""

    number: int
    choice: Choice


def choose_integrators(records: Sequence[Record], *, trials: FreedTrials | None = None) -> Integrators:
    """As many as explain slow motion that neither a stable model nor a drift beside it explains.

    A quick model is driven by the inputs, by their sums and by the sums of those, each beside the drift that would
    otherwise be found; the mean square of what the free run leaves of slow motion on held-out rows decides. Nothing
    else is asked where the model of the records as they are leaves no motion that lasts, and forgets.

    Example:
        >>> push = np.random.default_rng(0).standard_normal(2000)
        >>> level = np.cumsum(push)
        >>> choose_integrators([Record(push, level, 0.01)]).number
        1
    """
    if records[0].n_inputs == 0:
        return _explained(0, "without inputs an integrator cannot be told from a drift")
    trials = FreedTrials.of(records) if trials is None else trials
    own, left = trials.model(0, 0), trials.left(0, 0)
    chosen, before = 0, 0.0
    if own is None or left is None or not own.forgets or lasting_share(left) > LEAST_GAIN:
        drift = choose_drift(records, trials=trials).n_functions
        beside_drift = _slow_error(trials, 0, drift)
        for number in range(1, MOST + 1):
            with_one = _slow_error(trials, number, number)
            without = _slow_error(trials, chosen, number)
            if without is None:  # no stable model at all: an integrator must do better than nothing
                outputs = [record.outputs for record in trials.freed(0, number)]
                without = held_out_squares(slow_motion(outputs), number)
            if with_one is None or not _much_better(with_one, without) or not _no_worse(trials, number, chosen):
                continue
            if drift > number and beside_drift is not None and with_one.sum() > AS_GOOD * beside_drift.sum():
                continue
            chosen, before = number, 1.0 - with_one.sum() / without.sum()
    if chosen == 0:
        return _explained(0, "sums of the inputs explain no slow motion that a stable model does not explain")
    return _explained(
        chosen,
        f"a model of the summed inputs leaves {100 * before:.3g} % less slow motion on held-out rows than one of fewer "
        "sums, and no more of the whole: the response to a pulse does not die out",
    )


def given_integrators(number: int) -> Integrators:
    """So many as the caller chose.

    Raises:
        InvalidDataError: a number outside 0 ... 2.
    """
    number = whole_number(number, name="the number of integrators", least=0)
    if number > MOST:
        raise InvalidDataError(
            f"at most {MOST} integrators (force to position) can be fitted, but {number} were given; give 0, 1 or 2."
        )
    return _explained(number, "given as an argument")


def with_integrators(realisation: Realisation, number: int) -> Realisation:
    """The model of summed inputs, driven by the inputs themselves: one more state for each input and each sum.

        s(k+1) = s(k) + u(k),   x(k+1) = A x(k) + B (s(k) + u(k)),   y(k) = C x(k) + D (s(k) + u(k))

    The first states are those of the model that was given; Hankel factors belong to that model and are left behind. The
    sums are known from the inputs, so the gain does not correct them.

    Example:
        >>> from era.simulation import simulate
        >>> level = with_integrators(Realisation([[0.0]], [[1.0]], [[0.0]], [[2.0]], 0.1), 1)
        >>> simulate(level, Record([1.0, 0.0, 1.0], [0.0, 0.0, 0.0], 0.1)).outputs.ravel().tolist()
        [2.0, 2.0, 4.0]
    """
    model = realisation
    for _ in range(number):
        n_inputs, nothing = model.n_inputs, np.zeros((model.n_inputs, model.order))
        model = Realisation(
            np.block([[model.A, model.B], [nothing, np.eye(n_inputs)]]),
            np.vstack([model.B, np.eye(n_inputs)]),
            np.hstack([model.C, model.D]),
            model.D,
            model.dt,
            K=None if model.K is None else np.vstack([model.K, np.zeros((n_inputs, model.n_outputs))]),
            singular_values=model.singular_values,
        )
    return model


def driven_by_inputs(modes: ModalModel, number: int) -> ModalModel:
    """The modes of a model of summed inputs with the participations that the inputs themselves have.

    At its pole the sum multiplies an input by lambda / (lambda - 1), once for each time: without it modal masses would
    be those of another structure.

    Example:
        >>> from modal.modes.extraction import extract_modes
        >>> slow = Realisation([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1)
        >>> [mode.participation.real.round(9).tolist() for mode in driven_by_inputs(extract_modes(slow), 1)]
        [[-1.0]]
    """
    if not number:
        return modes
    poles, _ = discrete_poles(modes.modes, modes.dt)
    return replace(
        modes,
        modes=tuple(
            mode if pole == 1.0 else replace(mode, participation=mode.participation * (pole / (pole - 1.0)) ** number)
            for mode, pole in zip(modes.modes, poles, strict=True)
        ),
    )


def _slow_error(trials: FreedTrials, number: int, n_functions: int) -> FloatArray | None:
    """Squared slow remainder of a quick model beside slow functions, group by group; None where there is no model."""
    left = trials.left(number, n_functions)
    return None if left is None else held_out_squares(left, n_functions)


def _no_worse(trials: FreedTrials, number: int, than: int) -> bool:
    """Whether the model with more sums leaves no more of the whole motion, which is what modes are made of."""
    more, fewer = trials.model(number, number), trials.model(than, number)
    return fewer is None or (more is not None and more.error <= WITHIN * fewer.error)


def _much_better(error: FloatArray, than: FloatArray) -> bool:
    gain = than - error
    return is_significant(gain, SIGNIFICANT) and bool(gain.sum() > LEAST_GAIN * than.sum())


def _explained(number: int, reason: str) -> Integrators:
    value = {0: "none", 1: "one"}.get(number, "two")
    return Integrators(number=number, choice=Choice(what="integrators", value=value, reason=reason))
