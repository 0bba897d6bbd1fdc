"""Does the input drive this mode? How much of the outputs is lost when its answer to the inputs is left out.

A periodic disturbance is found again in every part of a record, as an undamped pole, and the fit gives it some
participation by chance. On rows that the model has not seen, that participation only does harm: the free run is better
without it. For a mode that the input drives it gets worse.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from era.state_recursion import PoleRecursion
from modal.modes.modal_form import discrete_poles
from modal.modes.mode import ModalModel, Mode
from okid.arrays import BoolArray, ComplexArray, FloatArray
from okid.record import Record

__all__ = ["driven_gain", "undriven_doubt"]

LEAST_DECAY = 1.0
"""Decay -Re(s) T over the longest record below which a mode cannot be told from a line that never ends."""
DEVIATIONS = 3.0
"""Standard deviations by which the damping may be smaller than it seems."""
UNDAMPED_GAIN = 0.1
"""Held-out gain from which such a mode is taken for driven all the same."""


def driven_gain(
    model: ModalModel,
    records: Sequence[Record],
    left: Sequence[FloatArray],
    *,
    output_scale: FloatArray,
    rows: Sequence[BoolArray] | None = None,
) -> FloatArray:
    """Share of the squared error without what the inputs make a mode do that this removes.

        gain_i = 1 - |e|^2 / |e + y_i|^2

    with e what the model's free run leaves, initial states fitted, and y_i the mode's answer to the inputs from rest;
    what the mode could do by itself, from any state in each output, and a constant are projected out of both. A line
    that the inputs do not drive is all free motion, and its answer to them is chance; left in, the fitted state would
    make up for that answer, and the answer seem to matter.

    Args:
        model: modes of the model that ran.
        records: that it ran through; missing inputs count as zero.
        left: (n_samples, n_outputs) a record, NaN where an output is missing.
        output_scale: (n_outputs,) sizes of the outputs.
        rows: (n_samples,) a record, True where a row counts; all unless given.

    Returns:
        (n_modes,) at most 1, negative where the run is better without; nan for growing modes, and for all without
        inputs or without a row.
    """
    modes = model.modes
    gains = np.full(len(modes), np.nan)
    if not modes or not records[0].n_inputs:
        return gains
    poles, is_pair = discrete_poles(modes, model.dt)
    weight = np.where(is_pair, 2.0, 1.0)
    driven = [i for i in range(len(modes)) if modes[i].kind != "unstable"]
    counted = [np.ones(record.n_samples, dtype=np.bool_) for record in records] if rows is None else rows
    with_it, without = np.zeros(len(modes)), np.zeros(len(modes))
    n_rows = 0
    for record, errors, there in zip(records, left, counted, strict=True):
        inputs = np.nan_to_num(record.inputs)
        kept: BoolArray = np.isfinite(errors).all(axis=1) & there
        if not kept.any():
            continue
        n_rows += int(kept.sum())
        rest = errors[kept] / output_scale
        for i in driven:
            part = _response(inputs @ modes[i].participation, complex(poles[i]), weight[i] * modes[i].shape, kept)
            free = _free_motion(complex(poles[i]), np.flatnonzero(kept))
            for total, values in ((with_it, rest), (without, rest + part / output_scale)):
                total[i] += float((values**2).sum() - ((free.T @ values) ** 2).sum())
    if n_rows:
        gains[driven] = 1 - with_it[driven] / np.maximum(without[driven], np.finfo(float).tiny)
    return gains


def _free_motion(pole: complex, times: NDArray[np.intp]) -> FloatArray:
    """(n_times, 1 to 3) orthonormal: a constant, and what the mode does by itself from any state."""
    with np.errstate(under="ignore"):
        motion = np.exp(np.log(pole) * (times - times[0]))
    columns = [np.ones(times.size), motion.real, *([motion.imag] if pole.imag else [])]
    basis, corner = np.linalg.qr(np.column_stack(columns))
    size = np.abs(np.diag(corner))
    kept: FloatArray = basis[:, size > 1e-9 * size.max()]
    return kept


def _response(drive: ComplexArray, pole: complex, shape: ComplexArray, kept: BoolArray) -> FloatArray:
    """(n_kept, n_outputs) of x(k+1) = pole x(k) + drive(k), y(k) = Re(shape x(k)), from rest."""
    recursion = PoleRecursion.of(np.array([pole]), drive.size)
    states, _ = recursion.run(drive[np.newaxis], np.zeros(1, dtype=np.complex128))
    return (states[0, kept, np.newaxis] * shape).real


def undriven_doubt(mode: Mode, gain: float, duration: float) -> tuple[str, ...]:
    """Why a mode may be no answer to the input, in words; empty where there is no doubt.

    Args:
        mode: from the whole record.
        gain: its mean held-out gain; nan where unknown.
        duration: of the longest record [s]; nan where unknown.

    Example:
        >>> mode = Mode(pole=-0.01 + 9j, kind="oscillatory", frequency=1.43, damping_ratio=0.0011,
        ...             shape=np.ones(1), participation=np.ones(1))
        >>> undriven_doubt(mode, 0.02, 20.0)
        ('an undamped line, which decays by only 18 % over 20 s: periodic disturbance?',)
    """
    # the least decay that its standard deviation allows; a line's damping is not zero, but cannot be told from zero
    spread = 0.0 if np.isnan(mode.damping_ratio_std) else mode.damping_ratio_std / abs(mode.damping_ratio or 1.0)
    decay = -mode.pole.real * duration * max(0.0, 1.0 - DEVIATIONS * spread)
    undamped = mode.kind == "oscillatory" and decay < LEAST_DECAY
    if gain < 0:
        line = "an undamped line that the input does not drive" if undamped else "the input does not drive it"
        return (f"{line} (held-out gain negative){': periodic disturbance?' if mode.kind == 'oscillatory' else ''}",)
    if undamped and not gain >= UNDAMPED_GAIN:
        if -mode.pole.real * duration < LEAST_DECAY:
            share = -100 * np.expm1(mode.pole.real * duration)
            how = f"an undamped line, which decays by only {share:.2g} % over {duration:.4g} s"
        else:
            share = -100 * np.expm1(-decay)
            how = f"perhaps an undamped line: its decay over {duration:.4g} s may be as little as {share:.2g} %"
        return (f"{how}: periodic disturbance?",)
    return ()
