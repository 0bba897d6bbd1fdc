"""Records as laboratories make them, clean or with one known fault; independent of okid, era and modal.

A record here is (inputs, outputs, dt); `clean_record` draws one of the kinds of `KINDS`, `with_fault` spoils it.
"""

from typing import Literal

import numpy as np
import scipy.signal
from signals import random_inputs

KINDS = (
    "white", "coloured", "narrow_band", "sweep", "multisine", "periodic_multisine", "hammer", "hits", "steps", "step",
    "sine", "square", "prbs", "burst", "uniform", "quantised_12", "quantised_16", "small_units", "large_units",
    "offset", "output_only", "free_decay", "many_outputs", "displacement", "feedthrough_hits",
    "feedthrough_steps",
)  # fmt: skip


def clean_record(
    rng: np.random.Generator, kind: str, *, n_samples: int = 6000, noise: float = 0.01
) -> tuple[np.ndarray, np.ndarray, float]:
    """Inputs (n_samples, n_inputs), outputs (n_samples, n_outputs) and dt of a structure with nothing wrong in it."""
    dt = float(rng.choice([0.001, 0.002, 0.005, 0.01]))
    n_inputs = int(rng.integers(1, 3)) if kind in {"white", "coloured", "multisine", "steps", "uniform"} else 1
    n_outputs = 12 if kind == "many_outputs" else int(rng.integers(1, 5))
    inputs = _inputs(rng, kind.removeprefix("feedthrough_"), n_samples, n_inputs)
    outputs = _response(rng, inputs, n_outputs, dt, displacement=kind == "displacement")
    if kind.startswith("feedthrough"):
        outputs = outputs + inputs @ rng.standard_normal((n_inputs, n_outputs))
    if kind == "free_decay":
        pulse = np.zeros((n_samples, 1))
        pulse[0] = 1.0
        outputs = _response(rng, pulse, n_outputs, dt)[1:]
        inputs = np.empty((n_samples - 1, 0))
    if kind == "output_only":
        inputs = np.empty((n_samples, 0))
    outputs = outputs / np.abs(outputs).max() * rng.uniform(0.3, 3.0)
    outputs = outputs + noise * outputs.std(axis=0) * rng.standard_normal(outputs.shape)
    if kind == "offset":
        outputs = outputs + 5.0 * outputs.std(axis=0) * rng.standard_normal(outputs.shape[1])
    scale = {"small_units": 1e-9, "large_units": 1e7}.get(kind, 1.0)
    outputs, inputs = scale * outputs, inputs / scale
    if kind.startswith("quantised"):
        outputs = quantised(outputs, int(kind.split("_")[1]))
        inputs = quantised(inputs, int(kind.split("_")[1]))
    return inputs, outputs, dt


def quantised(values: np.ndarray, bits: int) -> np.ndarray:
    """As a converter of so many bits gives them, its range a little wider than the largest value."""
    step = 2.0 * 1.3 * np.abs(values).max(axis=0) / 2**bits
    return step * np.round(values / step)


def _inputs(rng: np.random.Generator, kind: str, n_samples: int, n_inputs: int) -> np.ndarray:  # noqa: PLR0911 - one return a kind
    k = np.arange(n_samples)[:, np.newaxis]
    if kind in {"coloured", "sweep", "multisine", "hits", "steps"}:
        return random_inputs(rng, n_samples, n_inputs, kind=kind)
    if kind == "narrow_band":
        centre = rng.uniform(0.05, 0.3)
        return scipy.signal.lfilter(
            *scipy.signal.butter(2, [centre, 1.3 * centre], "band"), rng.standard_normal(k.shape), axis=0
        )
    if kind == "periodic_multisine":
        return np.tile(random_inputs(rng, n_samples // 8, n_inputs, kind="multisine"), (8, 1))
    if kind == "hammer":
        values = np.zeros((n_samples, n_inputs))
        width = int(rng.integers(4, 20))
        starts = 40 + np.arange(0, n_samples - 40, n_samples // int(rng.integers(1, 5)))
        for start in starts[starts < n_samples - width]:
            values[start : start + width, 0] = rng.uniform(0.8, 1.2) * np.sin(np.pi * np.arange(width) / width) ** 2
        return values + 2e-4 * rng.standard_normal(values.shape)
    if kind == "step":
        return np.where(k > n_samples // 10, 1.0, 0.0) * np.ones((1, n_inputs))
    if kind == "sine":
        return np.sin(2 * np.pi * rng.uniform(0.005, 0.05) * k) * np.ones((1, n_inputs))
    if kind == "square":
        return np.sign(np.sin(2 * np.pi * rng.uniform(0.002, 0.02) * k + 0.1)) * np.ones((1, n_inputs))
    if kind == "prbs":
        return np.repeat(rng.choice([-1.0, 1.0], (-(-n_samples // 3), n_inputs)), 3, axis=0)[:n_samples]
    if kind == "burst":
        return rng.standard_normal((n_samples, n_inputs)) * (k % (n_samples // 4) < n_samples // 8)
    if kind == "uniform":
        return rng.uniform(-1.0, 1.0, (n_samples, n_inputs))
    return rng.standard_normal((n_samples, n_inputs))


def _response(
    rng: np.random.Generator, inputs: np.ndarray, n_outputs: int, dt: float, *, displacement: bool = False
) -> np.ndarray:
    """Sum of three or four sampled modes, each one recursion of second order."""
    outputs = np.zeros((len(inputs), n_outputs))
    for frequency in np.sort(rng.uniform(0.01, 0.35, int(rng.integers(3, 5)))):
        radius = np.exp(-2 * np.pi * frequency * rng.uniform(0.01, 0.04))
        poles = [1.0, -2 * radius * np.cos(2 * np.pi * frequency), radius**2]
        size = (1.0 / frequency if displacement else 1.0) * (1 - radius)
        for column in inputs.T:
            motion = scipy.signal.lfilter([0.0, 1.0], poles, column)
            outputs += size * motion[:, np.newaxis] * rng.standard_normal(n_outputs)
    return outputs


Fault = Literal[
    "constant", "stuck", "missing", "clipped", "coarse", "spikes", "hum", "noise", "copy", "negated", "ahead", "drift",
    "level", "white",
]  # fmt: skip


def with_fault(  # noqa: PLR0912 - one branch a fault
    rng: np.random.Generator, outputs: np.ndarray, dt: float, fault: Fault, size: float
) -> np.ndarray:
    """The outputs with a fault of a given size in channel 0.

    `size` is the share of the samples (stuck, missing, clipped, spikes), the fault's standard deviation over the
    channel's (hum, noise, drift), levels a standard deviation (coarse), samples (ahead), or a factor (level).
    """
    outputs, n_samples = outputs.copy(), len(outputs)
    channel = outputs[:, 0]
    std, k = channel.std(), np.arange(n_samples)
    if fault == "hum" and dt > 0.005:
        raise ValueError("50 Hz lies above the band")
    if fault == "constant":
        channel[:] = channel[0]
    elif fault == "stuck":
        length = max(2, round(size * n_samples))
        start = int(rng.integers(n_samples // 4, n_samples // 2))
        channel[start : start + length] = channel[start]
    elif fault == "missing":
        channel[rng.random(n_samples) < size] = np.nan
    elif fault == "clipped":
        low, high = np.quantile(channel, [size / 2, 1 - size / 2])
        channel[:] = np.clip(channel, low, high)
    elif fault == "coarse":
        channel[:] = std / size * np.round(channel * size / std)
    elif fault == "spikes":
        places = rng.choice(n_samples - 20, max(1, round(size * n_samples)), replace=False) + 10
        channel[places] += 5.0 * std * rng.choice([-1.0, 1.0], places.size)
    elif fault == "hum":
        channel += size * std * np.sqrt(2.0) * np.sin(2 * np.pi * 50.02 * dt * k + 1.0)
    elif fault == "noise":
        channel += size * std * rng.standard_normal(n_samples)
    elif fault == "white":
        channel[:] = std * rng.standard_normal(n_samples)
    elif fault == "copy":
        outputs[:, -1] = channel
    elif fault == "negated":
        outputs[:, -1] = -channel
    elif fault == "ahead":
        shift = round(size)
        channel[:-shift] = channel[shift:].copy()
    elif fault == "drift":
        slow = np.cumsum(rng.standard_normal(n_samples))
        slow = np.convolve(slow, np.ones(n_samples // 5), "same")
        channel += size * std * (slow - slow.mean()) / slow.std()
    elif fault == "level":
        channel[n_samples // 2 :] *= size
    return outputs
