"""Exact Cramer-Rao bound of frequency and damping: no unbiased estimate from these rows can scatter less.

Output error with white Gaussian noise of known size on each output; every parameter of the system is unknown. With a
mode's modal state x, residue parts c (n_outputs,) and b (n_inputs,), and weight w = 1 for a real pole, and
y = 2 Re(c x) for a pair:

    x(k+1) = lambda x(k) + b' u(k),    y(k) = sum over modes w Re(c x(k)) + D u(k) + level + e(k)

The parameters of a mode are lambda, c, b up to scale (its largest entry is held, since c b' alone is seen) and x(0),
complex for a pair, real for a real pole; then D, and a constant level of each output where it is not known. With the
sensitivities J of all outputs to all parameters and R the noise variances, the information is the sum over rows of
J' R^-1 J; the bound is its inverse (Kay, Fundamentals of Statistical Signal Processing: Estimation Theory, 1993,
section 3.9). With s = ln(lambda) / dt: frequency |s| / 2 pi, damping ratio -Re(s) / |s|, by first order. Nothing
here imports okid, era or modal.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.signal import lfilter
from systems import TruthSystem

Level = Literal["known", "unknown"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CramerRaoBound:
    """(n_modes,) least standard deviations, in the order of `TruthSystem.poles`; nan damping for a real pole."""

    frequency_std: np.ndarray
    damping_ratio_std: np.ndarray


def cramer_rao_bound(
    system: TruthSystem, inputs: np.ndarray, *, initial_state: np.ndarray, noise_std: np.ndarray, level: Level = "known"
) -> CramerRaoBound:
    """Bound for one record with these inputs, this (unknown) initial state and this noise on each output."""
    information = information_matrix(system, inputs, initial_state=initial_state, noise_std=noise_std, level=level)
    # units apart by many powers of ten: scaled to a unit diagonal before the inverse
    scale = 1 / np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
    frequency_std, damping_std = [], []
    first = 0
    for pole, discrete in zip(system.poles, system.discrete_poles, strict=True):
        n_own = 2 if pole.imag > 0 else 1
        own = covariance[first : first + n_own, first : first + n_own]
        directions = np.array([1.0, 1j])[:n_own] / (discrete * system.dt)  # d pole / d (Re, Im lambda)
        size = abs(pole)
        d_size = (pole.conjugate() * directions).real / size
        d_ratio = -directions.real / size + pole.real * d_size / size**2
        frequency_std.append(np.sqrt(d_size @ own @ d_size) / (2 * np.pi))
        damping_std.append(np.sqrt(d_ratio @ own @ d_ratio) if n_own == 2 else np.nan)
        first += n_own
    return CramerRaoBound(frequency_std=np.array(frequency_std), damping_ratio_std=np.array(damping_std))


def information_matrix(
    system: TruthSystem, inputs: np.ndarray, *, initial_state: np.ndarray, noise_std: np.ndarray, level: Level = "known"
) -> np.ndarray:
    """Fisher information; the poles' own parameters come first, in the order of `TruthSystem.poles`."""
    modes = _modal_parts(system, initial_state)
    poles, others = [], []
    for discrete, c, b, start in modes:
        own, rest = _sensitivities(discrete, c, b, start, inputs)
        poles.append(own)
        others.append(rest)
    total = 0.0
    for i in range(system.n_outputs):
        columns = [own[i] for own in poles] + [rest[i] for rest in others] + [_direct(inputs, i, system.n_outputs)]
        if level == "unknown":
            columns.append(np.eye(system.n_outputs)[i] * np.ones((len(inputs), 1)))
        J = np.hstack(columns)
        total = total + J.T @ J / noise_std[i] ** 2
    return total


def _modal_parts(system: TruthSystem, initial_state: np.ndarray):
    """(lambda, c, b, x(0)) of each mode, in the order of `TruthSystem.poles`."""
    values, vectors = np.linalg.eig(system.A)
    rows = np.linalg.inv(vectors)
    parts = []
    for discrete in system.discrete_poles:
        i = int(np.argmin(np.abs(values - discrete)))
        parts.append((values[i], system.C @ vectors[:, i], rows[i] @ system.B, rows[i] @ initial_state))
    return parts


def _sensitivities(discrete, c, b, start, inputs):
    """Of every output, (n_samples, n_parameters): to lambda, and to c, the free entries of b and x(0)."""
    n_samples, n_outputs = len(inputs), len(c)
    zeros = np.zeros((1, inputs.shape[1]), dtype=complex)
    # one filter an input: x driven by a unit in b; the free decay is the filter's answer to one pulse
    driven = lfilter([1.0], [1.0, -discrete], np.vstack([zeros, inputs[:-1]]), axis=0)
    decay = discrete ** np.arange(n_samples)
    state = driven @ b + start * decay
    slope = lfilter([1.0], [1.0, -discrete], np.concatenate([[0.0], state[:-1]]))  # d x / d lambda
    free = np.arange(len(b)) != np.argmax(np.abs(b))
    real = abs(discrete.imag) < 1e-14
    own, rest = [], []
    for i in range(n_outputs):
        to_c = np.zeros((n_samples, n_outputs), dtype=complex)
        to_c[:, i] = state
        both = np.hstack([to_c, c[i] * driven[:, free], c[i] * decay[:, np.newaxis]])
        own.append(_parts(c[i] * slope[:, np.newaxis], real=real))
        rest.append(_parts(both, real=real))
    return own, rest


def _parts(derivative: np.ndarray, *, real: bool) -> np.ndarray:
    """To the real and to the imaginary part of a parameter on which the output depends as 2 Re(...)."""
    return derivative.real if real else np.hstack([2 * derivative.real, -2 * derivative.imag])


def _direct(inputs: np.ndarray, output: int, n_outputs: int) -> np.ndarray:
    n_inputs = inputs.shape[1]
    columns = np.zeros((len(inputs), n_outputs * n_inputs))
    columns[:, output * n_inputs : (output + 1) * n_inputs] = inputs
    return columns
