"""Markov parameters: the response of a system to a pulse of one unit for one sample.

`system[0] = D`, `system[k] = C A^(k-1) B`; nothing is multiplied or divided by dt. With an observer gain,
`gain[0] = I`, `gain[k] = C A^(k-1) K`.

From the observer, the second half of OKID:

    h_0 = D,  h_k = alpha_k + sum_{i=1..min(k,p)} beta_i h_{k-i}      system, C A^(k-1) B
    g_0 = I,  g_k =           sum_{i=1..min(k,p)} beta_i g_{k-i}      gain,   C A^(k-1) K

with alpha_k = 0 beyond the observer order p. The last term of each sum, beta_k D or beta_k I, belongs to it: without it
the parameters are wrong by about half on noise-free data. The number of lags is independent of the observer order.

The recursion is solved in blocks of steps: one product with the constant Toeplitz strip that carries the past and one
triangular solve with the constant unit lower triangle that links the steps of the block.
"""

from dataclasses import KW_ONLY, dataclass

import numpy as np
import scipy

from okid.arrays import FloatArray, frozen, require, time_step, whole_number
from okid.display import Displayed
from okid.errors import InvalidDataError, NumericalError
from okid.observer import ObserverFit


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MarkovParameters(Displayed):
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


def solve_recursion(output_coefficients: FloatArray, forcing: FloatArray) -> FloatArray:
    """Run the recursion forward from rest for several columns at once.

    Args:
        output_coefficients: (order, n_outputs, n_outputs) beta_1 ... beta_order.
        forcing: (n_steps, n_outputs, n_columns) x(0), x(1), ...

    Returns:
        (n_steps, n_outputs, n_columns).

    Example:
        >>> solve_recursion(np.array([[[0.5]]]), np.array([[[1.0]], [[0.0]], [[0.0]]])).ravel()
        array([1.  , 0.5 , 0.25])
    """
    order, n_outputs = output_coefficients.shape[:2]
    n_steps, _, n_columns = forcing.shape
    values = np.empty((order + n_steps, n_outputs, n_columns))
    values[:order] = 0.0
    steps = max(1, min(n_steps, 64 // n_outputs))  # rows of a block: the triangle stays in cache
    strip, triangle = _strip_and_triangle(output_coefficients, steps)
    flat = values.reshape((order + n_steps) * n_outputs, n_columns)
    flat_forcing = forcing.reshape(n_steps * n_outputs, n_columns)
    past = order * n_outputs
    for start in range(0, n_steps * n_outputs, steps * n_outputs):
        size = min(steps * n_outputs, n_steps * n_outputs - start)
        right = flat_forcing[start : start + size] + strip[:size] @ flat[start : start + past]
        if steps > 1:
            # X' T' = R' with C-ordered operands is what BLAS sees as T X = R: no copy is made.
            right = scipy.linalg.blas.dtrsm(
                1.0, triangle[:size, :size].T, right.T, side=1, lower=0, diag=1, overwrite_b=1
            ).T
        flat[start + past : start + past + size] = right
    return values[order:]


def _strip_and_triangle(output_coefficients: FloatArray, steps: int) -> tuple[FloatArray, FloatArray]:
    """Coefficients of a block of steps on the `order` steps before it, and on the steps in it (unit lower triangle)."""
    order, q = output_coefficients.shape[:2]
    padded = np.zeros((order + 2 * steps, q, q))
    padded[steps : steps + order] = output_coefficients[::-1]
    block, row, column = padded.strides
    # Row r, block t of the strip is beta_(order + r - t), which stands at padded[steps + t - r].
    strip = np.lib.stride_tricks.as_strided(padded[steps:], (steps, q, order, q), (-block, row, block, column))
    # Row r, block t of the triangle is -beta_(r - t), which stands at padded[steps + order + t - r].
    inner = np.lib.stride_tricks.as_strided(padded[steps + order :], (steps, q, steps, q), (-block, row, block, column))
    triangle = -np.ascontiguousarray(inner).reshape(steps * q, steps * q)
    return np.ascontiguousarray(strip).reshape(steps * q, order * q), triangle


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
