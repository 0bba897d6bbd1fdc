"""Textbook ERA, its mode indicators, loop by loop, from Markov parameters, and LSCF; nothing of okid, era or modal.

Juang, Applied System Identification, 1994, chapter 5; Pappa, Elliott, Schenk, NASA TM-107607, 1992. And poles from
frequency responses by least squares with a common denominator (LSCF): Guillaume, Verboven, Vanlanduit, ISMA 1998.
"""

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


def _emac(first: np.ndarray, last: np.ndarray, growth: complex) -> float:
    above = 0.0
    for start, end in zip(first, last, strict=True):
        expected = start * growth
        amplitude = min(abs(end / expected), abs(expected / end))
        phase = abs(np.angle(end / expected))
        above += amplitude * max(0.0, 1 - phase / (np.pi / 4)) * abs(start) ** 2
    return above / sum(abs(start) ** 2 for start in first)
