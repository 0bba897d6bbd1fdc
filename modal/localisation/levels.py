"""Frequency and damping of each mode at each level: how the best linear model moves with the size of the motion.

A spring that hardens raises the frequency with level, one that softens, yields or slips lowers it; dry friction lowers
the damping ratio, drag raises it. How the models are made, and their deviations: `modal.localisation.level_fits`.

References:
    Kerschen, Worden, Vakakis, Golinval, Past, present and future of nonlinear system identification in structural
    dynamics, Mechanical Systems and Signal Processing 20(3), 2006, 505-592, doi 10.1016/j.ymssp.2005.04.008.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from modal.estimation.modal_states import one_blas_thread
from modal.localisation.gap import BEYOND_CHANCE, excitation_levels
from modal.localisation.level_fits import LevelFit, decay_start, decay_windows, driven_start, follow_levels, partners
from modal.modes.mode import Mode, ModeKind
from modal.modes.shape_comparison import IndexArray
from modal.modes.shape_sets import assurance
from modal.preparation.steps import split_at_input_gaps
from okid.arrays import FloatArray
from okid.display import Displayed
from okid.errors import IdentificationError
from okid.record import Record
from okid.rows import as_records

__all__ = ["LevelMode", "LevelModes", "Tendency", "level_modes", "measured_modes", "tendency"]

Tendency = Literal["rises", "falls", "stays", "mixed", "unknown"]
"""With rising level; "mixed" where it rises and falls, "unknown" where the deviations are too large to tell."""

FREQUENCY_THAT_COUNTS = 2e-3
"""Say nothing of a smaller relative change of a frequency."""
DAMPING_THAT_COUNTS = 0.05
"""Say nothing of a smaller relative change of a damping ratio."""
STAYS_WITHIN = 5.0
"""Say that a mode stays within so many times the change that counts."""
HEAVY = 0.5
"""Leave a mode above this damping ratio, beside lighter ones, to the model's order: it is none of the structure's."""
FASTEST_SEEN = 0.95
"""Drop a mode above this share of the Nyquist frequency, wherever its pole is."""
KNOWN_TO = 0.05
"""Call a mode not found at a level where its frequency has a larger relative deviation."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class LevelMode(Displayed):
    """One mode at every level, nan where it was not found.

    Attributes:
        number: by rising frequency, from 1; oscillatory modes and first-order poles are counted apart.
        kind: "oscillatory", or "real" for a first-order pole.
        frequencies: (n_levels,) |pole| / 2 pi [Hz].
        frequency_stds: (n_levels,) their standard deviations [Hz].
        damping_ratios: (n_levels,).
        damping_ratio_stds: (n_levels,).
        assurances: (n_levels,) of the shape with that of the level which a linear model fits best.
        frequency_tendency: with rising level.
        damping_tendency: with rising level; "unknown" for a real pole.
    """

    number: int
    kind: ModeKind
    frequencies: FloatArray
    frequency_stds: FloatArray
    damping_ratios: FloatArray
    damping_ratio_stds: FloatArray
    assurances: FloatArray
    frequency_tendency: Tendency
    damping_tendency: Tendency


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class LevelModes(Displayed):
    """The modes of the best linear model of each level.

    Attributes:
        levels: (n_levels,) mean size of the excitation (free decays: of the motion) of the records of a level, relative
            to the loudest record.
        modes: by rising frequency, those found at two levels at least.
        left_over: (n_levels, n_outputs) mean square that the level's own linear model leaves, over the variance.
        order: of the linear models, 0 where there is none.
        reason: why there are no modes to compare, "" when there are.
    """

    levels: FloatArray
    modes: tuple[LevelMode, ...]
    left_over: FloatArray
    order: int
    reason: str


def level_modes(records: Record | Sequence[Record]) -> LevelModes:
    """Identify every level by itself and follow each mode from level to level.

    Args:
        records: measured, of one system, of as many levels as there are; records of one level are fitted together.
            Records that no input drives are free decays: their windows are the levels.

    Raises:
        InvalidDataError: records that do not belong together.

    Example:
        >>> force = np.random.default_rng(1).standard_normal(1500)
        >>> tip = np.zeros(1500)
        >>> for k in range(2, 1500):
        ...     tip[k] = 1.6 * tip[k - 1] - 0.9 * tip[k - 2] + force[k - 1]
        >>> noise = 0.01 * np.random.default_rng(2).standard_normal((2, 1500))
        >>> found = level_modes([Record(force, tip + noise[0], 0.01), Record(3 * force, 3 * tip + noise[1], 0.01)])
        >>> [(mode.frequencies.round(2).tolist(), mode.frequency_tendency) for mode in found.modes]
        [([9.07, 9.07], 'stays')]
    """
    several = as_records(records)
    driven = any((np.nanmax(r.inputs, axis=0) > np.nanmin(r.inputs, axis=0)).any() for r in several)
    if not driven:
        several = decay_windows(several) or several
    own, numbers = _levels(several, driven=driven)
    n_levels = int(numbers.max())
    levels = np.array([own[numbers == number].mean() for number in range(1, n_levels + 1)])

    def nothing(reason: str) -> LevelModes:
        left = np.full((n_levels, several[0].n_outputs), np.nan)
        return LevelModes(levels=levels, modes=(), left_over=left, order=0, reason=reason)

    if n_levels < 2:
        return nothing("all records are of one level, so nothing can be followed from level to level")
    groups = [[r for r, own_ in zip(several, numbers.tolist(), strict=True) if own_ == n + 1] for n in range(n_levels)]
    with one_blas_thread():
        try:
            prepared = [_prepared(group) for group in groups]
            found = follow_levels(prepared, driven_start if driven else decay_start)
        except IdentificationError as error:
            return nothing(f"a level could not be identified: {error}".rstrip("."))
    if found is None:
        return nothing("at no level do the outputs follow the inputs as those of a stable linear model")
    best, fits = found
    left = np.array([np.full(several[0].n_outputs, np.nan) if fit is None else fit.left_over for fit in fits])
    reference = fits[best]
    if reference is None:
        return nothing("the model of the most linear level could not be refined")
    modes = _paired(best, fits, reference, dt=several[0].dt)
    reason = "" if modes else "no mode was found again at a second level"
    return LevelModes(levels=levels, modes=modes, left_over=left, order=reference.model.order, reason=reason)


def tendency(values: FloatArray, deviations: FloatArray, *, counts: float) -> Tendency:
    """How numbers with known deviations move from each level to the next.

    Args:
        values: (n_levels,) by rising level, nan where unknown.
        deviations: (n_levels,) standard deviations.
        counts: change relative to the mean from which on it counts.

    Returns:
        "rises" or "falls" when some change between two levels is above both `counts` and four standard deviations and
        none goes the other way; "mixed" when one does; "stays" when every change, two deviations added, is below
        five times `counts` among the levels, more than half of them, whose own two deviations are; else "unknown".

    Example:
        >>> tendency(np.array([5.0, 5.1, 5.3]), np.full(3, 0.01), counts=2e-3)
        'rises'
    """
    known = np.isfinite(values) & np.isfinite(deviations)
    value, deviation = values[known], deviations[known]
    if value.size < 2:
        return "unknown"
    change = value[np.newaxis, :] - value[:, np.newaxis]
    spread = np.sqrt(np.square(deviation)[np.newaxis, :] + np.square(deviation)[:, np.newaxis])
    least = counts * float(np.abs(value).mean())
    upward = np.triu(np.ones(change.shape, dtype=np.bool_), 1)
    up = bool(((change > np.maximum(BEYOND_CHANCE * spread, least)) & upward).any())
    down = bool(((-change > np.maximum(BEYOND_CHANCE * spread, least)) & upward).any())
    if up and down:
        return "mixed"
    if up or down:
        return "rises" if up else "falls"
    telling = 2.0 * deviation < STAYS_WITHIN * least  # a level known less could show no such change, nor refuse one
    between = upward & telling[np.newaxis, :] & telling[:, np.newaxis]
    small = np.abs(change) + 2.0 * spread < STAYS_WITHIN * least
    return "stays" if 2 * telling.sum() > max(telling.size, 2) and small[between].all() else "unknown"


def _levels(records: Sequence[Record], *, driven: bool) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Level and its number, of the inputs or, for free decays, of the motion."""
    levels, numbers, _ = excitation_levels(records if driven else [record.select(inputs=()) for record in records])
    return levels, numbers


def _prepared(records: Sequence[Record]) -> tuple[Record, ...]:
    return tuple(part.detrended() for record in records for part in split_at_input_gaps(record))


def _paired(best: int, fits: Sequence[LevelFit | None], reference: LevelFit, *, dt: float) -> tuple[LevelMode, ...]:
    """The modes of the reference level, each with its continuation at the others."""
    index = _continuations(best, fits, reference)
    table = np.full((5, len(fits), len(reference.modes)), np.nan)
    for i, fit in enumerate(fits):
        for k, own in enumerate(index[i].tolist()):
            if fit is None or own < 0 or not fit.frequency_stds[own] < KNOWN_TO * fit.modes[own].frequency:
                continue
            mode, first = fit.modes[own], reference.modes[k]
            alike = assurance(first.shape[:, np.newaxis], mode.shape[:, np.newaxis])[0, 0]
            table[:, i, k] = (
                mode.frequency,
                fit.frequency_stds[own],
                mode.damping_ratio,
                fit.damping_ratio_stds[own],
                alike,
            )
    kept = [k for k in measured_modes(reference.modes, dt) if np.isfinite(table[0, :, k]).sum() > 1]
    kinds = [reference.modes[k].kind for k in kept]
    numbers = [kinds[: i + 1].count(kind) for i, kind in enumerate(kinds)]
    return tuple(
        _level_mode(number, reference.modes[k], table[:, :, k]) for number, k in zip(numbers, kept, strict=True)
    )


def measured_modes(modes: Sequence[Mode], dt: float) -> list[int]:
    """Which modes may be the structure's: no faster than the sampling, not heavily damped beside lighter ones.

    Args:
        modes: of one model.
        dt: time step [s].
    """
    light = any(mode.kind == "oscillatory" and mode.damping_ratio <= HEAVY for mode in modes)
    return [
        k
        for k, mode in enumerate(modes)
        if mode.frequency <= FASTEST_SEEN * 0.5 / dt
        and not (light and mode.kind == "oscillatory" and mode.damping_ratio > HEAVY)
    ]


def _continuations(best: int, fits: Sequence[LevelFit | None], reference: LevelFit) -> IndexArray:
    """(n_levels, n_modes) index of each mode of the reference at every level, -1 where it has none."""
    n_modes = len(reference.modes)
    found = np.full((len(fits), n_modes), -1, dtype=np.intp)
    found[best] = np.arange(n_modes)
    for walk in (range(best + 1, len(fits)), range(best - 1, -1, -1)):
        last, index = reference, found[best]
        for i in walk:
            fit = fits[i]
            if fit is None:
                continue
            partner = np.append(partners(last.modes, fit.modes), -1)
            last, index = fit, partner[index]  # the appended -1 is what index -1 points at
            found[i] = index
    return found


def _level_mode(number: int, mode: Mode, table: FloatArray) -> LevelMode:
    frequencies, frequency_stds, damping_ratios, damping_ratio_stds, assurances = table
    real = mode.kind == "real"
    return LevelMode(
        number=number,
        kind=mode.kind,
        frequencies=frequencies,
        frequency_stds=frequency_stds,
        damping_ratios=damping_ratios,
        damping_ratio_stds=damping_ratio_stds,
        assurances=assurances,
        frequency_tendency=tendency(frequencies, frequency_stds, counts=FREQUENCY_THAT_COUNTS),
        damping_tendency="unknown"
        if real
        else tendency(damping_ratios, damping_ratio_stds, counts=DAMPING_THAT_COUNTS),
    )
