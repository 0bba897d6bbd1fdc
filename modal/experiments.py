"""The observer run on the inputs that show one mode, and backwards for every number that is asked of it.

See `modal.propagation`: the gradient of a number with respect to the observer's coefficients is the sum over steps of
v(s) nu(s)', v the regressors of the run of its mode and nu its own backward run.
"""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from modal.sensitivity import ModeSensitivities
from okid.arrays import ComplexArray, FloatArray
from okid.observer import ObserverFit
from okid.recovery import recover_system
from okid.recursion import solve_recursion

__all__ = ["ModeExperiments", "ScaledObserver", "mode_experiments", "scaled_observer"]

_Samples = TypeVar("_Samples", FloatArray, ComplexArray)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ScaledObserver:
    """The observer equation of scaled channels.

    Attributes:
        feedthrough: (n_outputs, n_inputs) D.
        inputs: (order, n_outputs, n_inputs) alpha.
        outputs: (order, n_outputs, n_outputs) beta.
    """

    feedthrough: FloatArray
    inputs: FloatArray
    outputs: FloatArray

    def pulse_response(self, n_lags: int) -> FloatArray:
        """(n_lags + 1, n_outputs, n_inputs) Markov parameters of the system."""
        return recover_system(self.feedthrough, self.inputs, self.outputs, n_lags)

    def pulse_regressors(self, system: FloatArray, channel: int) -> FloatArray:
        """(n_unknowns, n_lags + 1) regressors while a unit pulse in one input is answered."""
        pulse = np.zeros((system.shape[0], system.shape[2]))
        pulse[0, channel] = 1.0
        order, _, n_inputs = self.inputs.shape
        return regressor_columns(np.concatenate([pulse, system[:, :, channel]], axis=1), order, n_inputs)


def scaled_observer(observer: ObserverFit) -> ScaledObserver:
    """The observer in channels of unit size: there its recursion loses no digits to units."""
    size, into = observer.output_scale[:, np.newaxis], observer.input_scale
    return ScaledObserver(
        feedthrough=observer.feedthrough * into / size,
        inputs=observer.input_coefficients * into / size,
        outputs=observer.output_coefficients * observer.output_scale / size,
    )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ModeExperiments:
    """Forward and backward runs of all modes.

    Attributes:
        samples: (n_modes, n_steps, n_inputs + n_outputs) inputs and answers of each mode's run.
        weights: (n_modes, n_numbers, n_steps, n_outputs) nu(s) of every number.
        order: of the observer.
        n_inputs: of the observer.
    """

    samples: ComplexArray
    weights: ComplexArray
    order: int
    n_inputs: int

    def regressors(self, mode: int) -> ComplexArray:
        """(n_unknowns, n_steps) of one mode's run."""
        return regressor_columns(self.samples[mode], self.order, self.n_inputs)


def mode_experiments(sensitivities: ModeSensitivities, observer: ScaledObserver) -> ModeExperiments:
    """Run all modes forward and all their numbers backward.

    Channels of the Hankel matrix beyond the inputs are those of the gain: they enter as residuals do.

    Args:
        sensitivities: left and right sequences, for scaled channels.
        observer: of scaled channels.
    """
    n_outputs, n_inputs = observer.feedthrough.shape
    n_modes, n_numbers, n_after, _ = sensitivities.left.shape
    n_before, width = sensitivities.right.shape[1:]
    n_steps = n_before + n_after
    driven = np.zeros((n_steps, width, n_modes), dtype=np.complex128)
    driven[:n_before] = sensitivities.right[:, ::-1].transpose(1, 2, 0)
    inputs = driven[:, :n_inputs]
    forcing = np.zeros((n_steps, n_outputs, n_modes), dtype=np.complex128)
    if n_inputs:
        forcing += observer.feedthrough @ inputs
        for lag in range(1, min(observer.inputs.shape[0], n_steps - 1) + 1):
            forcing[lag:] += observer.inputs[lag - 1] @ inputs[:-lag]
    if width > n_inputs:
        forcing += driven[:, n_inputs:]
    answers = _solved(observer.outputs, forcing)
    # the last answers come first: the adjoint runs backwards
    pull = np.zeros((n_steps, n_outputs, n_modes, n_numbers), dtype=np.complex128)
    pull[:n_after] = sensitivities.left[:, :, ::-1].transpose(2, 3, 0, 1)
    backward = _solved(observer.outputs.transpose(0, 2, 1), pull.reshape(n_steps, n_outputs, -1))[::-1]
    return ModeExperiments(
        samples=np.concatenate([inputs, answers], axis=1).transpose(2, 0, 1),
        weights=backward.reshape(pull.shape).transpose(2, 3, 0, 1),
        order=observer.outputs.shape[0],
        n_inputs=n_inputs,
    )


def _solved(coefficients: FloatArray, forcing: ComplexArray) -> ComplexArray:
    """The recursion is real: real and imaginary parts run side by side."""
    n_columns = forcing.shape[2]
    both = solve_recursion(coefficients, np.concatenate([forcing.real, forcing.imag], axis=2))
    solved: ComplexArray = both[:, :, :n_columns] + 1j * both[:, :, n_columns:]
    return solved


def regressor_columns(samples: _Samples, order: int, n_inputs: int) -> _Samples:
    """(n_unknowns, n_steps) v(s) = [0; u(s); u(s-1); y(s-1); ...]: a pulse response has no offset."""
    n_steps, n_channels = samples.shape
    padded = np.concatenate([np.zeros((order, n_channels), dtype=samples.dtype), samples])
    windows = np.lib.stride_tricks.sliding_window_view(padded, order + 1, axis=0)[:, :, ::-1]
    past = windows[:, :, 1:].transpose(2, 1, 0).reshape(order * n_channels, n_steps)
    return np.concatenate([np.zeros((1, n_steps), dtype=samples.dtype), samples[:, :n_inputs].T, past])
