"""Where a refinement starts: the modal form of a realisation, and the initial states that suit it best."""

import numpy as np

from era.realisation import Realisation
from modal.modal_states import ModalParameters, block_grams
from modal.refinement import NONE, OutputError, Step, evaluate, training_gram
from okid.arrays import ComplexArray, FloatArray

__all__ = ["starting_parameters"]

STATE_REGULARISATION = 1e-9
LEAST_POLE = 1e-8


def starting_parameters(realisation: Realisation, data: OutputError, *, held_out: int = NONE) -> Step | None:
    """Modal form of a stable model with initial states fitted to the training rows.

    None where it is unstable, or where all its poles are zero: a pulse response that ends is left to the observer.
    """
    if realisation.order == 0:
        return None
    poles, vectors = np.linalg.eig(realisation.A)
    size = np.abs(poles)
    if size.max() >= 1.0:
        return None
    left = np.linalg.pinv(vectors)
    kept = (poles.imag >= 0.0) & (size > LEAST_POLE)
    if not kept.any():
        return None
    is_pair = poles[kept].imag > 0.0
    inputs = left[kept] @ realisation.B
    shapes = np.where(is_pair, 2.0, 1.0) * (realisation.C @ vectors[:, kept])
    # unit size of each participation, so that shapes and states have comparable sizes
    largest = np.linalg.norm(inputs, axis=1)
    largest = np.where(largest > 0.0, largest, 1.0)
    inputs, shapes = inputs / largest[:, np.newaxis], shapes * largest
    start = ModalParameters(
        poles=poles[kept].astype(np.complex128),
        is_pair=is_pair,
        inputs=np.where(is_pair[:, np.newaxis], inputs, inputs.real).astype(np.complex128),
        states=np.zeros((len(data.records), int(kept.sum())), dtype=np.complex128),
    )
    return evaluate(_with_states(start, shapes, realisation.D, data, held_out), data, held_out=held_out)


def _with_states(
    start: ModalParameters, shapes: ComplexArray, feedthrough: FloatArray, data: OutputError, held_out: int
) -> ModalParameters:
    """Initial states and levels by least squares on what the inputs leave, shapes and feedthrough as they are."""
    layout, grams = block_grams(start, data.records, data.rows, data.blocks)
    gram = training_gram(layout, grams, data.blocks, held_out)
    n, m, n_records = layout.n_poles, layout.n_inputs, layout.n_records
    known = np.zeros((layout.size, layout.n_outputs))
    known[:n], known[n : 2 * n], known[2 * n : 2 * n + m] = shapes.real.T, -shapes.imag.T, feedthrough.T
    known[layout.outputs] = -np.eye(layout.n_outputs)
    rest = -gram @ known  # products of every signal with what the inputs leave of the outputs
    levels = slice(2 * n + m, layout.n_regressors)
    count = np.maximum(np.diag(gram)[levels], 1.0)
    first = layout.real.start + n * (1 + m)
    real, imaginary = slice(first, layout.real.stop), slice(first + layout.n_sensitivities, layout.imaginary.stop)
    to_level = np.hstack([gram[levels, real], gram[levels, imaginary]]) / np.sqrt(count)[:, np.newaxis]
    own = np.block([[gram[real, real], gram[real, imaginary]], [gram[imaginary, real], gram[imaginary, imaginary]]])
    own = own - to_level.T @ to_level
    right = np.vstack([rest[real], rest[imaginary]]) - to_level.T @ (rest[levels] / np.sqrt(count)[:, np.newaxis])
    k = n * n_records
    rr, ri, ii = own[:k, :k], own[:k, k:], own[k:, k:]
    hermitian, symmetric = (rr + ii) + 1j * (ri - ri.T), (rr - ii) + 1j * (ri + ri.T)
    c = np.tile(shapes, n_records)
    first_, second = (c.conj().T @ c) * hermitian, (c.T @ c) * symmetric
    total, difference = 0.5 * (first_ + second), 0.5 * (first_ - second)
    matrix = np.block([[total.real, -total.imag], [difference.imag, difference.real]])
    slope = (c.T * (right[:k] + 1j * right[k:])).sum(axis=1)
    vector = np.concatenate([slope.real, -slope.imag])
    # relative to each free response's energy over the whole record, not only over the rows that count
    lengths = np.repeat([record.n_samples for record in data.records], n)
    decay = np.tile(np.abs(start.poles) ** 2, n_records)
    energy = 0.5 * (np.abs(c) ** 2).sum(axis=0) * (1.0 - decay**lengths) / (1.0 - decay)
    energy = np.tile(energy, 2)
    scale = np.sqrt(np.where(energy > 0.0, energy, 1.0))
    scaled = matrix / np.outer(scale, scale) + STATE_REGULARISATION * np.eye(2 * k)
    solution = np.linalg.lstsq(scaled, vector / scale, rcond=1e-13)[0] / scale
    states = (solution[:k] + 1j * solution[k:]).reshape(n_records, n)
    return ModalParameters(
        poles=start.poles,
        is_pair=start.is_pair,
        inputs=start.inputs,
        states=np.where(start.is_pair, states, states.real),
    )
