"""From the observer to the Markov parameters of the system and of its gain: the second half of OKID.

    h_0 = D,  h_k = alpha_k + sum_{i=1..min(k,p)} beta_i h_{k-i}      system, C A^(k-1) B
    g_0 = I,  g_k =           sum_{i=1..min(k,p)} beta_i g_{k-i}      gain,   C A^(k-1) K

with alpha_k = 0 beyond the observer order p. The last term of each sum, beta_k D or beta_k I, belongs to it: without it
the parameters are wrong by about half on noise-free data. The number of lags is independent of the observer order.
"""

import numpy as np

from okid.arguments import require
from okid.arrays import FloatArray
from okid.errors import NumericalError
from okid.markov import MarkovParameters
from okid.observer import ObserverFit
from okid.recursion import solve_recursion
from okid.scalars import whole_number

__all__ = ["recover_arrays", "recover_markov", "recover_system"]


def recover_markov(observer: ObserverFit, *, n_lags: int | None = None) -> MarkovParameters:
    """Markov parameters of the system and of the observer gain.

    Args:
        observer: from `fit_observer`.
        n_lags: lags beyond the feedthrough; twice the observer order, at least 20, unless given.

    Returns:
        In the units of the record, with the channels' sizes and the observer order.

    Raises:
        InvalidDataError: n_lags below 1.
        NumericalError: they grow beyond all numbers, so the observer describes no system that could be realised.

    References:
        Juang, Phan, Horta, Longman, "Identification of observer/Kalman filter Markov parameters: theory and
        experiments", Journal of Guidance, Control, and Dynamics 16(2), 1993, 320-329, doi 10.2514/3.21006.

    Example:
        >>> from okid.observer import fit_observer
        >>> from okid.record import Record
        >>> u = np.random.default_rng(2).standard_normal(300)
        >>> y = np.zeros(300)
        >>> for k in range(1, 300):
        ...     y[k] = 0.5 * y[k - 1] + u[k - 1]
        >>> recover_markov(fit_observer(Record(u, y, 0.1), order=1), n_lags=3).system.ravel().round(9) + 0.0
        array([0.  , 1.  , 0.5 , 0.25])
    """
    require(observer, ObserverFit, where="recover_markov", made_by="okid.fit_observer")
    if n_lags is None:
        n_lags = max(20, 2 * observer.order)
    n_lags = whole_number(n_lags, name="n_lags", least=1)
    # In scaled channels the recursion sees no units, so none of its sums is lost to another's size.
    size, into = observer.output_scale, observer.input_scale
    system, gain = recover_arrays(
        observer.feedthrough * into / size[:, np.newaxis],
        observer.input_coefficients * into / size[:, np.newaxis],
        observer.output_coefficients * size / size[:, np.newaxis],
        n_lags,
    )
    if not (np.isfinite(system).all() and np.isfinite(gain).all()):
        raise NumericalError(
            f"Markov parameters must stay finite, but those of this observer of order {observer.order} overflow within "
            f"{n_lags} lags; fit with a ridge (1e-3), another order, or recover fewer lags."
        )
    return MarkovParameters(
        system=_closed(system * size[:, np.newaxis] / into),
        gain=_closed(gain * size[:, np.newaxis] / size),
        dt=observer.dt,
        input_scale=into,
        output_scale=size,
        observer_order=observer.order,
    )


def recover_arrays(
    feedthrough: FloatArray, input_coefficients: FloatArray, output_coefficients: FloatArray, n_lags: int
) -> tuple[FloatArray, FloatArray]:
    """System (n_lags + 1, n_outputs, n_inputs) and gain (n_lags + 1, n_outputs, n_outputs) Markov parameters.

    Args:
        feedthrough: (n_outputs, n_inputs).
        input_coefficients: (order, n_outputs, n_inputs).
        output_coefficients: (order, n_outputs, n_outputs).
        n_lags: lags beyond 0.

    Example:
        >>> system, gain = recover_arrays(np.zeros((1, 1)), np.ones((1, 1, 1)), np.full((1, 1, 1), 0.5), 2)
        >>> system.ravel().tolist(), gain.ravel().tolist()
        ([0.0, 1.0, 0.5], [1.0, 0.5, 0.25])
    """
    n_outputs, n_inputs = feedthrough.shape
    forcing = np.zeros((n_lags + 1, n_outputs, n_inputs + n_outputs))
    _fill_forcing(forcing[:, :, :n_inputs], feedthrough, input_coefficients)
    forcing[0, :, n_inputs:] = np.eye(n_outputs)
    with np.errstate(over="ignore", invalid="ignore"):
        values = solve_recursion(output_coefficients, forcing)
    return values[:, :, :n_inputs], values[:, :, n_inputs:]


def recover_system(
    feedthrough: FloatArray, input_coefficients: FloatArray, output_coefficients: FloatArray, n_lags: int
) -> FloatArray:
    """As `recover_arrays`, the system's part only: what a candidate needs that is only compared with others."""
    forcing = np.zeros((n_lags + 1, *feedthrough.shape))
    _fill_forcing(forcing, feedthrough, input_coefficients)
    with np.errstate(over="ignore", invalid="ignore"):
        return solve_recursion(output_coefficients, forcing)


def _fill_forcing(forcing: FloatArray, feedthrough: FloatArray, input_coefficients: FloatArray) -> None:
    forcing[0] = feedthrough
    n_given = min(forcing.shape[0] - 1, input_coefficients.shape[0])
    forcing[1 : n_given + 1] = input_coefficients[:n_given]


def _closed(array: FloatArray) -> FloatArray:
    array.flags.writeable = False
    return array
