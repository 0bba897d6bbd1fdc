"""Does the input drive this mode? How much of the outputs on held-out rows is lost when it is left out.

A periodic disturbance is found again in every part of a record, as an undamped pole, and the fit gives it some
participation by chance. On rows that the model has not seen, that participation only does harm: the free run is better
without the pole. For a mode that the input drives it gets worse.
"""

from collections.abc import Sequence

import numpy as np

from era.realisation import Realisation
from modal.basis import discrete_poles
from modal.mode import ModalModel, Mode
from okid.arrays import BoolArray, ComplexArray, FloatArray
from okid.record import Record

__all__ = ["held_out_gain", "undriven_doubt"]

LEAST_DECAY = 1.0
"""Decay -Re(s) T over the longest record below which a mode cannot be told from a line that never ends."""
UNDAMPED_GAIN = 0.1
"""Held-out gain from which such a mode is taken for driven all the same."""


def held_out_gain(
    realisation: Realisation,
    model: ModalModel,
    records: Sequence[Record],
    rows: Sequence[BoolArray],
    *,
    output_scale: FloatArray,
) -> FloatArray:
    """Share of the squared free-run error without a mode that the mode removes, on held-out rows.

        gain_i = 1 - |e|^2 / |e + y_i|^2,   e = y - D u - sum of y_i over all modes that do not grow

    with y_i what the input makes mode i do, in a free run from rest through each whole record, outputs in unit size and
    means removed.

    Args:
        realisation: identified without these rows.
        model: its modes.
        records: whole records; missing inputs count as zero, rows with a missing output are left out.
        rows: (n_samples,) a record, True where it is held out.
        output_scale: (n_outputs,) sizes of the outputs.

    Returns:
        (n_modes,) at most 1; negative where the free run is better without the mode; nan for growing modes, and for all
        without inputs or without a complete held-out row.
    """
    modes = model.modes
    gains = np.full(len(modes), np.nan)
    if not modes or realisation.B.shape[1] == 0:
        return gains
    poles, is_pair = discrete_poles(modes, realisation.dt)
    driven = [i for i in range(len(modes)) if modes[i].kind != "unstable"]
    without, error, scored = np.zeros(len(modes)), 0.0, False
    for record, held_out in zip(records, rows, strict=True):
        inputs = np.nan_to_num(record.inputs)
        kept = held_out & ~np.isnan(record.outputs).any(axis=1)
        if not kept.any():
            continue
        scored = True
        weight = np.where(is_pair, 2.0, 1.0)
        parts = [
            _response(inputs @ modes[i].participation, complex(poles[i]), weight[i] * modes[i].shape, kept)
            / output_scale
            for i in driven
        ]
        rest = (record.outputs[kept] - inputs[kept] @ realisation.D.T) / output_scale - sum(parts)
        rest = rest - rest.mean(axis=0)
        error += float((rest**2).sum())
        for i, part in zip(driven, parts, strict=True):
            without[i] += float(((rest + part - part.mean(axis=0)) ** 2).sum())
    if scored:
        gains[driven] = 1 - error / np.maximum(without[driven], np.finfo(float).tiny)
    return gains


def _response(drive: ComplexArray, pole: complex, shape: ComplexArray, kept: BoolArray) -> FloatArray:
    """(n_kept, n_outputs) of x(k+1) = pole x(k) + drive(k), y(k) = Re(shape x(k)), from rest."""
    import scipy.signal

    state: ComplexArray = scipy.signal.lfilter([0.0, 1.0], [1.0, -pole], drive)
    return (state[kept, np.newaxis] * shape).real


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
    undamped = mode.kind == "oscillatory" and -mode.pole.real * duration < LEAST_DECAY
    if gain < 0:
        line = "an undamped line that the input does not drive" if undamped else "the input does not drive it"
        return (f"{line} (held-out gain negative){': periodic disturbance?' if mode.kind == 'oscillatory' else ''}",)
    if undamped and not gain >= UNDAMPED_GAIN:
        share = -100 * np.expm1(mode.pole.real * duration)
        return (f"an undamped line, which decays by only {share:.2g} % over {duration:.4g} s: periodic disturbance?",)
    return ()
