"""Output error in modal form by plain loops: runs, sensitivities and least squares; nothing of okid, era or modal.

    x_i(k+1) = lambda_i x_i(k) + b_i' u(k),   y(k) = sum over i of Re(c_i x_i(k)) + D u(k) + level + e(k)

A pole stands for a conjugate pair, or for itself where it is real. Its own two parameters are the logarithm of the
decay -ln|lambda| and the angle.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LoopModel:
    """poles (n,), is_pair (n,), b (n, n_inputs), starts (n_records, n), c (n_outputs, n), D, levels (n_records, q)."""

    poles: np.ndarray
    is_pair: np.ndarray
    b: np.ndarray
    starts: np.ndarray
    c: np.ndarray
    D: np.ndarray
    levels: np.ndarray

    @property
    def realisation(self):
        """Real A, B, C, D."""
        order = int(np.where(self.is_pair, 2, 1).sum())
        A, B, C = np.zeros((order, order)), np.zeros((order, self.b.shape[1])), np.zeros((self.c.shape[0], order))
        k = 0
        for i, pole in enumerate(self.poles):
            if self.is_pair[i]:
                A[k, k], A[k, k + 1], A[k + 1, k], A[k + 1, k + 1] = pole.real, -pole.imag, pole.imag, pole.real
                B[k], B[k + 1] = self.b[i].real, self.b[i].imag
                C[:, k], C[:, k + 1] = self.c[:, i].real, -self.c[:, i].imag
                k += 2
            else:
                A[k, k], B[k], C[:, k] = pole.real, self.b[i].real, self.c[:, i].real
                k += 1
        return A, B, C, self.D


def random_loop_model(rng, *, n_pairs=2, n_real=0, n_inputs=1, n_outputs=2, n_records=1, close=None, decay=(0.02, 0.1)):
    """Poles spread over the band, `close` puts the second a relative distance above the first; x(0) and D are not 0."""
    n = n_pairs + n_real
    is_pair = np.arange(n) < n_pairs
    angles = np.pi * (np.arange(n_pairs) + rng.uniform(0.3, 0.7, n_pairs)) / max(1, n_pairs)
    if close is not None:
        angles[1] = angles[0] * (1 + close)
    poles = np.exp(-rng.uniform(*decay, n) + 1j * np.r_[angles, np.zeros(n_real)])

    def drawn(*shape):
        size, angle = rng.uniform(0.5, 1.0, shape), rng.uniform(0, 2 * np.pi, shape)
        return size * np.exp(1j * angle)

    b, c, starts = drawn(n, n_inputs), drawn(n_outputs, n), 2 * drawn(n_records, n)
    b = np.where(is_pair[:, np.newaxis], b, b.real + 0j)
    return LoopModel(
        poles=np.where(is_pair, poles, poles.real + 0j),
        is_pair=is_pair,
        b=b,
        starts=np.where(is_pair, starts, starts.real + 0j),
        c=np.where(is_pair, c, c.real + 0j),
        D=rng.uniform(0.2, 0.8, (n_outputs, n_inputs)),
        levels=rng.uniform(-1, 1, (n_records, n_outputs)),
    )


def loop_states(model: LoopModel, r: int, inputs: np.ndarray) -> np.ndarray:
    """(n_samples, n_poles) complex, one sample after the other."""
    x = model.starts[r].astype(complex)
    states = np.empty((len(inputs), x.size), dtype=complex)
    for k, u in enumerate(inputs):
        states[k] = x
        x = model.poles * x + model.b @ u
    return states


def loop_run(model: LoopModel, r: int, inputs: np.ndarray) -> np.ndarray:
    """(n_samples, n_outputs) outputs without noise."""
    return (loop_states(model, r, inputs) @ model.c.T).real + inputs @ model.D.T + model.levels[r]


def loop_sensitivities(model: LoopModel, r: int, inputs: np.ndarray) -> np.ndarray:
    """(n_samples, 1 + n_inputs + n_records, n_poles): of a state to ln lambda, to each b and to each record's x(0)."""
    n, m, n_records = model.poles.size, inputs.shape[1], model.starts.shape[0]
    states = loop_states(model, r, inputs)
    now = np.zeros((1 + m + n_records, n), dtype=complex)
    now[1 + m + r] = 1.0
    result = np.empty((len(inputs), *now.shape), dtype=complex)
    for k, u in enumerate(inputs):
        result[k] = now
        now = model.poles * now
        now[0] += model.poles * states[k]  # d(lambda x) / d(ln lambda) = lambda x + lambda dx
        now[1 : 1 + m] += u[:, np.newaxis]
    return result


def loop_signals(model: LoopModel, r: int, inputs: np.ndarray, outputs: np.ndarray) -> np.ndarray:
    """Every signal of one record: states, inputs, a level for each record, sensitivities, outputs."""
    x, s = loop_states(model, r, inputs), loop_sensitivities(model, r, inputs).reshape(len(inputs), -1)
    levels = np.zeros((len(inputs), model.starts.shape[0]))
    levels[:, r] = 1.0
    return np.hstack([x.real, x.imag, inputs, levels, s.real, s.imag, outputs])


def regressors(model: LoopModel, inputs: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Of the linear part, record by record; the imaginary part of a real pole's state is left out."""
    result = []
    for r, u in enumerate(inputs):
        x = loop_states(model, r, u)
        levels = np.zeros((len(u), len(inputs)))
        levels[:, r] = 1.0
        result.append(np.hstack([x.real, x.imag[:, model.is_pair], u, levels]))
    return result


def projected_errors(model: LoopModel, inputs, outputs, rows) -> np.ndarray:
    """(n_outputs,) squared error over these rows, shapes, D and levels by least squares."""
    phi = np.vstack([block[there] for block, there in zip(regressors(model, inputs), rows, strict=True)])
    y = np.vstack([block[there] for block, there in zip(outputs, rows, strict=True)])
    return np.square(y - phi @ np.linalg.lstsq(phi, y, rcond=None)[0]).sum(axis=0)


# --- all parameters, one after the other -----------------------------------------------------------------------------


def parameter_places(model: LoopModel) -> list[tuple[str, tuple[int, ...], complex]]:
    """Field, place and direction of every free parameter; the largest entry of each b is held."""
    places = []
    for i in range(model.poles.size):
        held = int(np.argmax(np.abs(model.b[i])))
        directions = (1.0, 1j) if model.is_pair[i] else (1.0,)
        for way in directions:
            places.append(("poles", (i,), way))
            places += [("b", (i, j), way) for j in range(model.b.shape[1]) if j != held]
            places += [("starts", (r, i), way) for r in range(model.starts.shape[0])]
            places += [("c", (o, i), way) for o in range(model.c.shape[0])]
    places += [("D", place, 1.0) for place in np.ndindex(model.D.shape)]
    return places + [("levels", place, 1.0) for place in np.ndindex(model.levels.shape)]


def changed(model: LoopModel, place: tuple[str, tuple[int, ...], complex], step: float) -> LoopModel:
    """The model with one parameter changed; a pole by ln of its decay (direction 1) or by its angle (direction j)."""
    field, where, way = place
    values = np.array(getattr(model, field))
    if field == "poles":
        decay, angle = -np.log(np.abs(values[where])), np.angle(values[where])
        if way == 1.0:
            decay *= np.exp(step)
        else:
            angle += step
        values[where] = np.exp(-decay + 1j * angle)
        if not model.is_pair[where]:
            values[where] = values[where].real
    else:
        values[where] += way * step
    return replace(model, **{field: values})


def differences(function, model: LoopModel, places, step: float = 1e-5) -> np.ndarray:
    """(n_parameters, ...) central differences of fourth order of a function of the model."""
    slopes = []
    for place in places:
        near = function(changed(model, place, step)) - function(changed(model, place, -step))
        far = function(changed(model, place, 2 * step)) - function(changed(model, place, -2 * step))
        slopes.append((8 * near - far) / (12 * step))
    return np.array(slopes)
