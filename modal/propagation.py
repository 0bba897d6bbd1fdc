"""First-order propagation of an observer's uncertainty to modes and Markov parameters.

A number of a mode is `sum of left[i]' h[1 + i + j] right[j]` (`modal.sensitivity`). Feed the observer with right[b-1],
..., right[0]: what it answers from the next sample on, weighed with left[0], left[1], ..., is that number. So with the
regressors v(s) of this experiment and the answer y(s) = Theta' v(s),

    dy(s) = dTheta' v(s) + sum_i beta_i dy(s-i),    nu(s) = left[s-b] + sum_i beta_i' nu(s+i),
    d number = sum_s nu(s)' dTheta' v(s),           gradient = sum_s v(s) nu(s)'

One forward run a mode and one backward run a number give all gradients; the covariance of the Markov parameters, whose
size is that of (lags x channels)^2, is never formed.

References:
    Juang, Pappa, Journal of Guidance, Control, and Dynamics 9(3), 1986, 294-303, doi 10.2514/3.20106 (ERA).
    Ljung, System Identification: Theory for the User, 2nd edition, Prentice Hall 1999, section 9.4 (covariance of a
    least-squares ARX estimate).
"""

from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np

from era.realisation import Realisation
from modal.experiments import ModeExperiments, ScaledObserver, mode_experiments, scaled_observer
from modal.mode import Mode
from modal.noise_models import BlockNoise, WhiteNoise, block_noise, white_noise
from modal.sensitivity import mode_sensitivities
from modal.uncertainty import Uncertainty
from okid.arguments import require
from okid.arrays import ComplexArray, FloatArray
from okid.errors import InvalidDataError
from okid.markov import MarkovParameters
from okid.observer import ObserverFit
from okid.record import Record
from okid.rows import as_records

__all__ = ["Residuals", "propagated"]

Residuals = Literal["blocks", "white"]


def propagated(
    records: Record | Sequence[Record],
    *,
    observer: ObserverFit,
    markov: MarkovParameters,
    realisation: Realisation,
    modes: Sequence[Mode],
    residuals: Residuals = "blocks",
) -> Uncertainty:
    """Standard deviations of modes and Markov parameters from the noise that the observer left over.

    What "white" takes for granted (`okid.check_residuals` tells: ratio near 1) seldom holds: the observer of a lightly
    damped structure needs hundreds of lags to whiten sensor noise, and a ridge leaves part of the signal. Where
    residuals carry over from sample to sample, "white" is wrong by factors, too large where the observer is too short,
    too small with a ridge. "blocks" asks only that a twentieth of the record is long against their memory and that of
    the modes; where it is not, its deviations are too large.

    An interval from either lacks the bias: that of a short observer or of a ridge (both damp too much), of neighbours
    that the model order merges, and of a mode so weak that first order is not enough.

    Args:
        records: that the observer was fitted to.
        observer: fitted to all their rows.
        markov: recovered from it.
        realisation: cut from them, not refined afterwards.
        modes: of the realisation.
        residuals: "white" (covariance Sigma_e (x) (V V')^-1 of least squares, ridge included) or "blocks" (clustered by
            contiguous blocks of rows: right for residuals of any colour, known to 16 %).

    Raises:
        InvalidDataError: records that the observer was not fitted to, a realisation without Hankel factors, or modes of
            another one.

    Example:
        >>> from okid.observer import fit_observer
        >>> from okid.recovery import recover_markov
        >>> from era.balanced import realise
        >>> from modal.extraction import extract_modes
        >>> rng = np.random.default_rng(1)
        >>> force, tip = rng.standard_normal(2000), np.zeros(2000)
        >>> for k in range(2, 2000):
        ...     tip[k] = 1.6 * tip[k - 1] - 0.9 * tip[k - 2] + force[k - 1] + 0.1 * rng.standard_normal()
        >>> record = Record(force, tip, 0.01)
        >>> observer = fit_observer(record, order=2)
        >>> markov = recover_markov(observer)
        >>> model = realise(markov, order=2)
        >>> modes = extract_modes(model).modes
        >>> known = propagated(record, observer=observer, markov=markov, realisation=model, modes=modes)
        >>> half_width = known.interval_factor(0.95) * known.frequency_std[0]
        >>> print(f"{modes[0].frequency:.2f} Hz +- {half_width:.3f} Hz")
        9.07 Hz +- 0.018 Hz
    """
    require(observer, ObserverFit, where="propagated", made_by="okid.fit_observer")
    require(markov, MarkovParameters, where="propagated", made_by="okid.recover_markov")
    require(realisation, Realisation, where="propagated", made_by="era.realise")
    if residuals not in get_args(Residuals):
        raise InvalidDataError(f'residuals must be "blocks" or "white", but is {residuals!r}.')
    sensitivities = mode_sensitivities(realisation, modes)
    recursion = scaled_observer(observer)
    several = as_records(records)
    noise = white_noise(several, observer) if residuals == "white" else block_noise(several, observer)
    first, second = _mode_products(mode_experiments(sensitivities, recursion), noise)
    frequency, damping = _pole_deviations(sensitivities.poles, first[:, 0], second[:, 0], realisation.dt)
    shape = np.sqrt(np.maximum(first[:, 1:], 0.0))
    for array in (frequency, damping, shape):
        array[~sensitivities.separable] = np.nan
    scale = observer.output_scale[:, np.newaxis] / observer.input_scale
    return Uncertainty(
        method="propagation",
        frequency_std=frequency,
        damping_ratio_std=damping,
        shape_std=shape,
        markov_std=_markov_deviations(recursion, noise, markov.n_lags) * scale,
        degrees_of_freedom=noise.degrees_of_freedom,
    )


def _mode_products(experiments: ModeExperiments, noise: WhiteNoise | BlockNoise) -> tuple[FloatArray, ComplexArray]:
    """E |d number|^2 and E (d number)^2, each (n_modes, n_numbers)."""
    n_modes, n_numbers = experiments.weights.shape[:2]
    first = np.empty((n_modes, n_numbers))
    second = np.empty((n_modes, n_numbers), dtype=np.complex128)
    for mode in range(n_modes):
        first[mode], second[mode] = noise.products(experiments.regressors(mode), experiments.weights[mode])
    return first, second


def _pole_deviations(
    poles: ComplexArray, first: FloatArray, second: ComplexArray, dt: float
) -> tuple[FloatArray, FloatArray]:
    """Standard deviations of frequency [Hz] and damping ratio: both are Re(weight dlambda)."""
    s = np.log(poles) / dt
    size = np.abs(s)
    slope = 1.0 / (poles * dt)
    # |s| moves by Re(conj(s) ds) / |s|, -Re(s)/|s| by -Re(ds) / |s| + Re(s) d|s| / |s|^2
    growth = np.conj(s) * slope / size
    frequency = growth / (2 * np.pi)
    damping = (-slope + s.real * growth / size) / size
    deviations = [
        np.sqrt(np.maximum(0.5 * (np.abs(weight) ** 2 * first + (weight**2 * second).real), 0.0))
        for weight in (frequency, damping)
    ]
    return deviations[0], deviations[1]


def _markov_deviations(recursion: ScaledObserver, noise: WhiteNoise | BlockNoise, n_lags: int) -> FloatArray:
    """(n_lags + 1, n_outputs, n_inputs) standard deviations in scaled channels."""
    n_outputs, n_inputs = recursion.feedthrough.shape
    variance = np.zeros((n_lags + 1, n_outputs, n_inputs))
    system = recursion.pulse_response(n_lags)
    for channel in range(n_inputs):
        regressors = recursion.pulse_regressors(system, channel)
        variance[:, :, channel] = noise.response_variance(regressors, recursion.outputs)
    return np.sqrt(variance)
