"""Textbook ERA, its mode indicators, loop by loop, from Markov parameters, and LSCF; nothing of okid, era or modal.

Juang, Applied System Identification, 1994, chapter 5; Pappa, Elliott, Schenk, NASA TM-107607, 1992. And poles from
frequency responses by least squares with a common denominator (LSCF): Guillaume, Verboven, Vanlanduit, ISMA 1998.
And merged subspaces of several set-ups (PreGER): Mevel, Basseville, Benveniste, Goursat, JSV 249, 2002, 719-741;
Doehler, Andersen, Mevel, IMAC 2010; the projection is that of PO-MOESP: Verhaegen, Automatica 30, 1994, 61-74.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TextbookModel:
    """A, B, C of the eigensystem realisation algorithm, with the two factors of its Hankel matrix."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    observability: np.ndarray
    controllability: np.ndarray
    n_rows: int
    n_columns: int


def hankel(h: np.ndarray, n_rows: int, n_columns: int, first: int) -> np.ndarray:
    """Block (i, j) is h[first + i + j]."""
    return np.block([[h[first + i + j] for j in range(n_columns)] for i in range(n_rows)])


def textbook_era(h: np.ndarray, n_rows: int, n_columns: int, order: int) -> TextbookModel:
    n_outputs, n_inputs = h.shape[1:]
    left, values, right = np.linalg.svd(hankel(h, n_rows, n_columns, 1), full_matrices=False)
    root = np.sqrt(values[:order])
    left, right = left[:, :order], right[:order]
    observability, controllability = left * root, root[:, None] * right
    A = (left / root).T @ hankel(h, n_rows, n_columns, 2) @ (right / root[:, None]).T
    return TextbookModel(
        A=A,
        B=controllability[:, :n_inputs],
        C=observability[:n_outputs],
        observability=observability,
        controllability=controllability,
        n_rows=n_rows,
        n_columns=n_columns,
    )


def textbook_indicators(model: TextbookModel) -> list[dict[str, float]]:
    """One dictionary a pole with imaginary part >= 0, in numpy's order of eigenvalues; EMAC at the last block."""
    poles, vectors = np.linalg.eig(model.A)
    rows = np.linalg.inv(vectors)
    n_outputs, n_inputs = model.C.shape[0], model.B.shape[1]
    result = []
    for i in range(poles.size):
        if poles[i].imag < 0:
            continue
        b = rows[i] @ model.controllability[:, :n_inputs]
        c = model.observability[:n_outputs] @ vectors[:, i]
        predicted = np.concatenate([b * poles[i] ** k for k in range(model.n_columns)])
        measured = rows[i] @ model.controllability
        gamma = abs(predicted.conj() @ measured) / np.sqrt(
            (predicted.conj() @ predicted).real * (measured.conj() @ measured).real
        )
        last = model.observability[-n_outputs:] @ vectors[:, i]
        emac_output = _emac(c, last, poles[i] ** (model.n_rows - 1))
        last = rows[i] @ model.controllability[:, -n_inputs:]
        emac_input = _emac(b, last, poles[i] ** (model.n_columns - 1))
        sxx, syy, sxy = c.real @ c.real, c.imag @ c.imag, c.real @ c.imag
        collinearity = ((sxx - syy) ** 2 + 4 * sxy**2) / (sxx + syy) ** 2
        series = sum(abs(poles[i]) ** k for k in range(model.n_rows + model.n_columns - 1))
        result.append(
            {
                "pole": poles[i],
                "amplitude_coherence": gamma,
                "emac_output": emac_output,
                "emac_input": emac_input,
                "emac": emac_output * emac_input,
                "phase_collinearity": collinearity,
                "cmi": emac_output * emac_input * collinearity,
                "msv": np.sqrt(np.linalg.norm(c) * np.linalg.norm(b) * series),
            }
        )
    largest = max(entry["msv"] for entry in result)
    for entry in result:
        entry["msv"] /= largest
    return result


def textbook_lscf(response: np.ndarray, frequencies: np.ndarray, order: int) -> np.ndarray:
    """Poles [1/s] with imaginary part > 0 from responses (n_lines, n_outputs, n_inputs) at lines [Hz] from 0 up.

    Each response is N_oi(z) / D(z) with z = exp(s / (2 f_last)) and real coefficients up to z^order; N is eliminated,
    and the lowest coefficient of D is 1, which puts poles without meaning outside the unit circle.
    """
    dt = 0.5 / frequencies[-1]
    powers = np.exp(2j * np.pi * np.outer(frequencies, np.arange(order + 1)) * dt)
    normal = np.zeros((order + 1, order + 1))
    own = (powers.conj().T @ powers).real
    for H in response.reshape(len(frequencies), -1).T:
        mine = -H[:, None] * powers
        cross = (powers.conj().T @ mine).real
        normal += (mine.conj().T @ mine).real - cross.T @ np.linalg.solve(own, cross)
    denominator = np.r_[1.0, -np.linalg.solve(normal[1:, 1:], normal[1:, 0])]
    roots = np.roots(denominator[::-1]).astype(complex)
    return np.log(roots[roots.imag > 0]) / dt


def merged_subspaces(
    setups: Sequence[tuple[np.ndarray, np.ndarray]], *, n_references: int, order: int, n_blocks: int
) -> tuple[np.ndarray, np.ndarray]:
    """Discrete poles (order,) and their shapes (n_outputs, order): the references, then what moves in each set-up.

    In every set-up the future outputs are projected on the past inputs and references, what the future inputs explain
    taken out: H_j = O_j X_j. The references' rows of all set-ups stand side by side and are cut to the order once, so
    they have one observability matrix O_ref; X_j = O_ref^+ H_ref,j is then in one basis for all, and what moved follows
    with O_mov,j = H_mov,j X_j^+, whatever the level of its set-up.

    Args:
        setups: inputs (n, n_inputs) and outputs (n, n_outputs) of each, references first; no inputs: n_inputs = 0.
        n_references: outputs that every set-up has, in one place and order.
        order: of the model, told.
        n_blocks: samples of past, and of future.
    """
    projected = [_projection(np.asarray(u), np.asarray(y), n_references, n_blocks) for u, y in setups]
    of_references = np.hstack([H[:, :n_references].reshape(-1, H.shape[2]) for H in projected])
    left, values, _ = np.linalg.svd(of_references, full_matrices=False)
    merged = [(left[:, :order] * np.sqrt(values[:order])).reshape(n_blocks, n_references, order)]
    inverse = np.linalg.pinv(merged[0].reshape(-1, order))
    for H in projected:
        states = inverse @ H[:, :n_references].reshape(-1, H.shape[2])
        moving = H[:, n_references:]
        merged.append((moving.reshape(-1, H.shape[2]) @ np.linalg.pinv(states)).reshape(*moving.shape[:2], order))
    observability = np.concatenate(merged, axis=1)
    before, after = observability[:-1].reshape(-1, order), observability[1:].reshape(-1, order)
    poles, vectors = np.linalg.eig(np.linalg.lstsq(before, after, rcond=None)[0])
    return poles, observability[0] @ vectors


def _projection(inputs: np.ndarray, outputs: np.ndarray, n_references: int, n_blocks: int) -> np.ndarray:
    """(n_blocks, n_outputs, n_columns), as large as 1 in the references."""
    n_columns = outputs.shape[0] - 2 * n_blocks + 1

    def stacked(values: np.ndarray, first: int) -> np.ndarray:
        return np.hstack([values[first + k : first + k + n_columns] for k in range(n_blocks)])

    known = stacked(inputs, n_blocks), stacked(inputs, 0), stacked(outputs[:, :n_references], 0)
    triangle = np.linalg.qr(np.hstack([*known, stacked(outputs, n_blocks)]), mode="r").T
    future_inputs, past = known[0].shape[1], known[1].shape[1] + known[2].shape[1]
    rows = triangle[future_inputs + past :, future_inputs : future_inputs + past]
    H = rows.reshape(n_blocks, outputs.shape[1], past)
    return H / np.linalg.norm(H[:, :n_references])


def _emac(first: np.ndarray, last: np.ndarray, growth: complex) -> float:
    above = 0.0
    for start, end in zip(first, last, strict=True):
        expected = start * growth
        amplitude = min(abs(end / expected), abs(expected / end))
        phase = abs(np.angle(end / expected))
        above += amplitude * max(0.0, 1 - phase / (np.pi / 4)) * abs(start) ** 2
    return above / sum(abs(start) ** 2 for start in first)
