r"""Which mode of one result is which mode of another: the assignment of least cost over all modes at once.

The cost of a pair is how far its poles and its shapes lie apart, in units of what a change of the structure may do:

    cost = |s_a - s_b| / (d |s|) + (1 - assurance) / m + doubts,    |s| = sqrt(|s_a| |s_b|),  d = 0.3,  m = 0.5

A pair is worth no more than 1: a mode whose best partner costs more has none. So a frequency may shift by 30 % where
the shape stays, and among modes of close frequency the shape decides. A doubtful pole is a worse partner than a mode of
the system (0.2 each), so that a second pole beside a mode does not take its place; noise poles are no partners at all.
All pairs are chosen together (Hungarian method), not each mode its nearest. Where the outputs have several units, each
is counted in units of its own root mean square over the modes, else the largest numbers alone would decide.

References:
    Crouse, "On implementing 2D rectangular assignment algorithms", IEEE Transactions on Aerospace and Electronic
    Systems 52(4), 2016, doi 10.1109/TAES.2016.140952.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modal.comparison.source import ResultSummary
from modal.modes.mode import Mode
from modal.modes.shape_comparison import assurance
from okid.arrays import ComplexArray, FloatArray

__all__ = ["Matching", "common_outputs", "match_modes", "pair_costs", "shared_shapes"]

POLE_SCALE = 0.3
"""Relative distance of poles that alone makes two modes different ones."""

SHAPE_SCALE = 0.5
"""Loss of assurance that alone does."""

DOUBT = 0.2
"""Cost of a pole of the pair that is doubtful."""

TOO_FAR = 1.0


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Matching:
    """Pairs of modes, as indices into the modes of the two results.

    Attributes:
        pairs: (index before, index after) by rising frequency before.
        lost: indices before that have no partner; noise poles are not among them.
        new: indices after that have no partner.
        assurance: (n_before, n_after) of the shapes over the outputs that both results have; nan with fewer than two.
    """

    pairs: tuple[tuple[int, int], ...]
    lost: tuple[int, ...]
    new: tuple[int, ...]
    assurance: FloatArray


def match_modes(before: ResultSummary, after: ResultSummary) -> Matching:
    """The pairs of least cost among the modes of two results; see the module for the cost.

    Args:
        before: the one result.
        after: the other.
    """
    import scipy

    similarity = _assurance(before, after)
    costs = pair_costs(before.modes, after.modes, similarity)
    rows = [index for index, mode in enumerate(before.modes) if mode.verdict != "noise"]
    columns = [index for index, mode in enumerate(after.modes) if mode.verdict != "noise"]
    capped = np.minimum(costs[np.ix_(rows, columns)], TOO_FAR)
    chosen = zip(*scipy.optimize.linear_sum_assignment(capped), strict=True)
    pairs = [(rows[i], columns[j]) for i, j in chosen if capped[i, j] < TOO_FAR]
    return Matching(
        pairs=tuple(sorted(pairs, key=lambda pair: before.modes[pair[0]].frequency)),
        lost=tuple(sorted(set(rows) - {row for row, _ in pairs})),
        new=tuple(sorted(set(columns) - {column for _, column in pairs})),
        assurance=similarity,
    )


def pair_costs(before: Sequence[Mode], after: Sequence[Mode], similarity: FloatArray) -> FloatArray:
    """(n_before, n_after) cost of every pair; infinite where an oscillation would meet an overdamped pole."""
    poles_before = np.array([mode.pole for mode in before], dtype=np.complex128)[:, np.newaxis]
    poles_after = np.array([mode.pole for mode in after], dtype=np.complex128)
    size = np.sqrt(np.abs(poles_before) * np.abs(poles_after))
    distance = np.abs(poles_before - poles_after) / np.where(size > 0, size, 1.0)
    doubts = np.add.outer(_doubts(before), _doubts(after))
    loss = np.nan_to_num(1.0 - similarity)  # without shapes to compare, the poles decide
    same_kind = np.array([[one.kind == other.kind for other in after] for one in before], dtype=bool)
    costs = distance / POLE_SCALE + loss / SHAPE_SCALE + doubts
    return np.where(same_kind.reshape(costs.shape), costs, np.inf)


def common_outputs(before: ResultSummary, after: ResultSummary) -> tuple[list[int], list[int]]:
    """Indices of the outputs that both results have, with the same unit, in the order of the first."""
    where = {channel: index for index, channel in enumerate(after.outputs)}
    both = [(index, where[channel]) for index, channel in enumerate(before.outputs) if channel in where]
    return [first for first, _ in both], [second for _, second in both]


def _doubts(modes: Sequence[Mode]) -> FloatArray:
    return DOUBT * np.array([mode.verdict == "doubtful" for mode in modes], dtype=np.float64)


def shared_shapes(before: ResultSummary, after: ResultSummary) -> tuple[ComplexArray, ComplexArray, FloatArray]:
    """Shapes of both results over the outputs that both have, in columns, and the (n_shared,) unit of each output."""
    first, second = common_outputs(before, after)
    shapes = _shapes(before.modes, first), _shapes(after.modes, second)
    several_units = len({before.outputs[index].unit for index in first}) > 1
    size = np.sqrt(np.mean(np.abs(np.hstack(shapes)) ** 2, axis=1)) if several_units else np.ones(len(first))
    unit = np.where(size > 0, size, 1.0)
    return shapes[0] / unit[:, np.newaxis], shapes[1] / unit[:, np.newaxis], unit


def _assurance(before: ResultSummary, after: ResultSummary) -> FloatArray:
    first, second, unit = shared_shapes(before, after)
    if unit.size < 2:  # one component alone says nothing of a shape
        return np.full((len(before.modes), len(after.modes)), np.nan)
    return assurance(first, second)


def _shapes(modes: Sequence[Mode], outputs: Sequence[int]) -> ComplexArray:
    columns = [mode.shape[list(outputs)] for mode in modes]
    return np.array(columns, dtype=np.complex128).reshape(len(modes), len(outputs)).T
