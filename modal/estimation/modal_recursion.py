"""The free run of a model in modal form by matrix products over blocks of samples.

    x(k+1) = lambda x(k) + b' u(k),   y(k) = Re(c (w x(k))) + D u(k)

A block of samples takes two products: what its inputs and the states at its start make of its outputs, and what its
inputs add to the states after it. The states at the starts of blocks are the same diagonal recursion with lambda^L,
solved by pairing blocks until one is left. Rounding errors are those of the eigenvectors, eps times their condition.

An initial state shows in the starts of blocks as lambda^(L i) x(0), so its response, and the product of that response
with anything else, are one product each and no power of a pole is taken sample by sample.
"""

from dataclasses import dataclass

import numpy as np

from okid.arrays import ComplexArray, FloatArray

__all__ = ["ModalRecursion", "powers_of"]

BLOCK = 16
"""Samples of a block: longer ones multiply more, shorter ones leave more starts to solve for."""
DIED_OUT = 1e-12
"""Of a free response's first value: what is smaller is not followed any further."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ModalRecursion:
    """Products over blocks of `BLOCK` samples; a complex number is two neighbouring reals.

    Attributes:
        steps: (n_poles,) lambda^BLOCK.
        reach: (BLOCK n_inputs, 2 n_poles) states after a block from its inputs.
        free: (2 n_poles, BLOCK n_outputs) outputs of a block from the states at its start.
        forced: (BLOCK n_inputs, BLOCK n_outputs) outputs of a block from its inputs.
    """

    steps: ComplexArray
    reach: FloatArray
    free: FloatArray
    forced: FloatArray

    @classmethod
    def of(
        cls, poles: ComplexArray, participations: ComplexArray, weighted_shapes: ComplexArray, D: FloatArray
    ) -> "ModalRecursion":
        """The products of one model.

        Args:
            poles: (n_poles,).
            participations: (n_poles, n_inputs) b.
            weighted_shapes: (n_outputs, n_poles) w c.
            D: (n_outputs, n_inputs).
        """
        (n_outputs, n_inputs), n_poles = D.shape, poles.size
        powers = powers_of(poles, BLOCK + 1)
        reach = powers[BLOCK - 1 :: -1, np.newaxis, :] * participations.T
        response = np.conj(powers[:BLOCK, np.newaxis, :] * weighted_shapes)
        free = _as_reals(response.reshape(BLOCK * n_outputs, n_poles)).T
        pulse = np.empty((BLOCK, n_outputs, n_inputs))
        pulse[0] = D
        pulse[1:] = (free[:, : (BLOCK - 1) * n_outputs].T @ _as_reals(participations.T).T).reshape(BLOCK - 1, *D.shape)
        forced = np.zeros((BLOCK, n_inputs, BLOCK, n_outputs))
        for i in range(BLOCK):
            forced[i, :, i:] = pulse[: BLOCK - i].transpose(2, 0, 1)
        return cls(
            steps=powers[BLOCK],
            reach=_as_reals(reach.reshape(BLOCK * n_inputs, n_poles)),
            free=free,
            forced=forced.reshape(BLOCK * n_inputs, BLOCK * n_outputs),
        )

    def from_rest(self, inputs: FloatArray) -> FloatArray:
        """(n_samples, n_outputs) outputs for (n_samples, n_inputs) inputs."""
        blocks = _in_blocks(inputs)
        starts = _starts(_as_complex(blocks @ self.reach), self.steps)
        outputs = np.hstack([blocks, _as_reals(starts)]) @ np.vstack([self.forced, self.free])
        return outputs.reshape(blocks.shape[0] * BLOCK, -1)[: inputs.shape[0]]

    def n_alive(self, n_samples: int) -> int:
        """Samples, of so many, until the slowest free response has died out."""
        slowest = float(np.abs(self.steps).max(initial=0.0))
        if slowest >= 1.0 - BLOCK * DIED_OUT:
            return n_samples
        n_blocks = 1 + int(np.ceil(np.log(DIED_OUT) / np.log(max(slowest, 1e-300))))
        return min(n_samples, n_blocks * BLOCK)

    def free_response(self, state: ComplexArray, n_samples: int) -> FloatArray:
        """(n_samples, n_outputs) outputs from an initial state without inputs."""
        starts = powers_of(self.steps, -(-n_samples // BLOCK)) * state
        outputs = _as_reals(starts) @ self.free
        return outputs.reshape(starts.shape[0] * BLOCK, -1)[:n_samples]

    def products(self, signals: FloatArray) -> ComplexArray:
        """(n_poles,) sums over rows and outputs of signals (n_samples, n_outputs) times w c lambda^k."""
        blocks = _in_blocks(signals)
        each = _as_complex(blocks @ self.free.T)
        return (powers_of(self.steps, blocks.shape[0]) * each.conj()).sum(axis=0)


def powers_of(poles: ComplexArray, count: int) -> ComplexArray:
    """(count, n_poles) poles^k for k = 0 ... count - 1, by doubling.

    Example:
        >>> powers_of(np.array([0.5 + 0j]), 4).real.ravel().tolist()
        [1.0, 0.5, 0.25, 0.125]
    """
    powers = np.empty((count, poles.size), dtype=np.complex128)
    powers[:1] = 1.0
    done, step = 1, poles
    while done < count:
        take = min(done, count - done)
        np.multiply(powers[:take], step, out=powers[done : done + take])
        done, step = done + take, step * step
    return powers


def _starts(added: ComplexArray, step: ComplexArray) -> ComplexArray:
    """States at the starts of blocks, x_0 = 0 and x_(i+1) = step x_i + added_i; pairs of blocks make longer ones."""
    n_blocks = added.shape[0]
    starts = np.zeros_like(added)
    if n_blocks > 1:
        n_pairs = n_blocks // 2
        first, second = added[: 2 * n_pairs : 2], added[1 : 2 * n_pairs : 2]
        pairs = _starts(step * first + second, step * step)
        starts[: 2 * n_pairs : 2] = pairs
        starts[1 : 2 * n_pairs : 2] = step * pairs + first
        if n_blocks % 2:
            starts[-1] = step * starts[-2] + added[-2]
    return starts


def _in_blocks(signals: FloatArray) -> FloatArray:
    """(n_blocks, BLOCK n_channels), zeros after the end."""
    n_samples, n_channels = signals.shape
    n_blocks = -(-n_samples // BLOCK)
    if n_samples < n_blocks * BLOCK:
        signals = np.vstack([signals, np.zeros((n_blocks * BLOCK - n_samples, n_channels))])
    return np.ascontiguousarray(signals).reshape(n_blocks, BLOCK * n_channels)


def _as_reals(values: ComplexArray) -> FloatArray:
    """(n, 2 m) real and imaginary parts side by side."""
    n_rows, n_columns = values.shape
    return np.ascontiguousarray(values).view(np.float64).reshape(n_rows, 2 * n_columns)


def _as_complex(values: FloatArray) -> ComplexArray:
    n_rows, n_columns = values.shape
    return values.view(np.complex128).reshape(n_rows, n_columns // 2)
