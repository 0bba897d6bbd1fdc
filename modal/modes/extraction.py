"""From a realisation to its modes: continuous poles, shapes, participation and everything the data's SVD tells of them.

The realisation alone cannot say whether a mode belongs to the system: that needs the records, see
`modal.verdict.judgement`.

With H(0) = O R the factors of the block Hankel matrix (a block rows, b block columns) and Psi the eigenvectors of A,
the modal observability Om = O Psi and the modal controllability Rm = Psi^-1 R hold, mode by mode, what the *data* did
from sample to sample. An exact mode repeats itself: block k of its column of Om is C psi lambda^k. The amplitude
coherence and EMAC measure by how much it does not. Rebuilt from (A, B, C) the factors would repeat themselves by
construction and both indicators would be 1 for every pole, so they are read from `Realisation.factors` and from
nowhere else.

**Channels.** Amplitude coherence and EMAC compare with the Hankel matrix whose SVD was taken, so they are the
textbook's on its scaled channels: a change of unit changes neither. Phase collinearity, mean phase deviation and mode
singular value are functions of the pole, shape and participation that a mode publishes, and are computed in those
units, so that anyone can recompute them from a report. With unit scales all of them are the textbook's to rounding.

**Modes that die out.** EMAC compares the last block of the Hankel matrix with its prediction; for a mode that has
died out long before, that is 0 / 0 and noise decides. The default is the textbook's all the same. With a `decay_limit`
(pyYeti's is 0.1) a mode whose |lambda|^(a-1) is below it is compared at the last block in which it still has that share
of its first amplitude, never before the third block.

References:
    Juang, Pappa, An eigensystem realization algorithm for modal parameter identification and model reduction, Journal
    of Guidance, Control, and Dynamics 8(5), 1985, doi 10.2514/3.20031 (amplitude coherence). Juang, Applied System
    Identification, 1994, equations 5.42-5.50. Pappa, Elliott, Schenk, A consistent-mode indicator for the eigensystem
    realization algorithm, NASA TM-107607, 1992. Reynders, Houbrechts, De Roeck, Fully automated (operational) modal
    analysis, Mechanical Systems and Signal Processing 29, 2012, doi 10.1016/j.ymssp.2012.01.007 (mean phase
    deviation).
"""

from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from era.realisation import HankelFactors, Realisation
from modal.modes.modal_form import ModalBasis, continuous_poles, kind_of, largest_component, modal_basis, norms
from modal.modes.mode import ModalModel, Mode
from okid.arrays import ComplexArray, FloatArray, frozen_complex, require

DECAY_LIMIT = 0.0
"""By default EMAC is the textbook's: the last block, also for modes that have died out before it."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Indicators:
    """Every indicator, one value a pole, in the order of the basis; names and meanings as in `modal.Mode`."""

    amplitude_coherence: FloatArray
    phase_collinearity: FloatArray
    emac_output: FloatArray
    emac_input: FloatArray
    emac: FloatArray
    cmi: FloatArray
    msv: FloatArray
    mpd: FloatArray


def evaluate(factors: HankelFactors, basis: ModalBasis, *, decay_limit: float = DECAY_LIMIT) -> Indicators:
    """All indicators of the poles of a basis.

    Args:
        factors: of the Hankel matrix, in the state coordinates of the basis.
        basis: modal coordinates of the realisation.
        decay_limit: see the module; 0 compares the last block for every mode.
    """
    emac_output, emac_input = extended_amplitude_coherence(factors, basis, decay_limit=decay_limit)
    collinearity = phase_collinearity(basis.outputs)
    emac = emac_output * emac_input
    return Indicators(
        amplitude_coherence=amplitude_coherence(factors, basis),
        phase_collinearity=collinearity,
        emac_output=emac_output,
        emac_input=emac_input,
        emac=emac,
        cmi=emac * collinearity,
        msv=mode_singular_values(basis, n_steps=factors.n_block_rows + factors.n_block_columns - 1),
        mpd=mean_phase_deviation(basis.outputs),
    )


def amplitude_coherence(factors: HankelFactors, basis: ModalBasis) -> FloatArray:
    """Modal amplitude coherence: cosine between a mode's row of Rm and the sequence [b, lambda b, lambda^2 b, ...].

    gamma = |q_hat^H q_bar| / sqrt(q_hat^H q_hat q_bar^H q_bar), Juang 1994, equation 5.49.

    Returns:
        (n_poles,) in [0, 1]; nan with a single block column, where there is nothing to compare.
    """
    n_poles, n_columns = basis.poles.size, factors.n_block_columns
    if n_poles == 0 or n_columns < 2 or factors.controllability.shape[1] == 0:
        return np.full(n_poles, np.nan)
    measured = (basis.left @ factors.controllability).reshape(n_poles, n_columns, -1)
    powers = _powers(basis.poles, n_columns)
    size = np.linalg.norm(measured.reshape(n_poles, -1), axis=1)
    # q_hat^H q_bar = sum over k of conj(lambda)^k b^H q_bar_k
    along = np.einsum("pm,pkm->pk", measured[:, 0].conj(), measured)
    inner = np.abs(np.einsum("pk,pk->p", powers.conj(), along))
    predicted = np.linalg.norm(powers, axis=1) * np.linalg.norm(measured[:, 0], axis=1)
    return _ratio(inner, predicted * size)


def extended_amplitude_coherence(
    factors: HankelFactors, basis: ModalBasis, *, decay_limit: float = DECAY_LIMIT
) -> tuple[FloatArray, FloatArray]:
    """Output and input EMAC: does the last block of the data hold what the first block and the pole predict?

    Each channel scores R W: R the smaller over the larger amplitude, W = 1 - |phase error| / (pi/4), at least 0; the
    channels are weighted by their share of |c|^2 (NASA TM-107607).

    Returns:
        output and input EMAC, each (n_poles,) in [0, 1]; nan with a single block.
    """
    if basis.poles.size == 0:
        return np.empty(0), np.empty(0)
    observability = factors.observability.reshape(factors.n_block_rows, -1, factors.observability.shape[1])
    order = factors.controllability.shape[0]
    controllability = factors.controllability.reshape(order, factors.n_block_columns, -1).transpose(1, 2, 0)
    return (
        _block_agreement(observability, basis.right.T, basis.poles, decay_limit),
        _block_agreement(controllability, basis.left, basis.poles, decay_limit),
    )


def _block_agreement(blocks: FloatArray, vectors: ComplexArray, poles: ComplexArray, decay_limit: float) -> FloatArray:
    """Agreement of one block with the first one, for blocks (n_blocks, n_channels, order), vectors (n_poles, order)."""
    last = blocks.shape[0] - 1
    if last < 1 or blocks.shape[1] == 0:
        return np.full(poles.size, np.nan)
    block = _compared_block(poles, last, decay_limit)
    first = vectors @ blocks[0].T
    found = np.einsum("pcn,pn->pc", blocks[block], vectors)
    with np.errstate(over="ignore", invalid="ignore"):
        expected = first * (poles**block)[:, np.newaxis]
    smaller = np.minimum(np.abs(found), np.abs(expected))
    amplitude = _ratio(smaller, np.maximum(np.abs(found), np.abs(expected)), otherwise=0.0)
    phase = np.abs(np.angle(found * expected.conj()))
    score = np.nan_to_num(amplitude * np.clip(1 - phase / (np.pi / 4), 0.0, None))
    weight = np.abs(first) ** 2
    return _ratio((score * weight).sum(axis=1), weight.sum(axis=1))


def _compared_block(poles: ComplexArray, last: int, decay_limit: float) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    block = np.full(poles.size, last, dtype=np.intp)
    size = np.abs(poles)
    if decay_limit <= 0:
        return block
    died = size**last < decay_limit * (1 - 1e-12)
    block[died] = np.clip((np.log(decay_limit) / np.log(size[died])).astype(np.intp), min(2, last), last)
    return block


def phase_collinearity(shapes: ComplexArray) -> FloatArray:
    """Modal phase collinearity |phi' phi|^2 / (phi^H phi)^2: 1 for a shape whose channels move in or against phase.

    Neither centred nor weighted. With one output it is always 1, and a random shape of q outputs has mean 2 / (q + 1).

    Args:
        shapes: (n_outputs, n_modes).

    Returns:
        (n_modes,), nan for a shape of zeros.

    Example:
        >>> phase_collinearity(np.array([[1.0, 1.0], [-0.5, 1.0j]])).round(6).tolist()
        [1.0, 0.0]
    """
    plain = np.abs((shapes * shapes).sum(axis=0))
    return _ratio(plain, (np.abs(shapes) ** 2).sum(axis=0)) ** 2


def mean_phase_deviation(shapes: ComplexArray) -> FloatArray:
    """Mean phase deviation [deg]: |phi|-weighted mean angle to the straight line through 0 that fits the shape best.

    The total-least-squares line has the angle arg(phi' phi) / 2.

    Args:
        shapes: (n_outputs, n_modes).

    Returns:
        (n_modes,) from 0 (all in or against phase) to at most 90; nan for a shape of zeros.

    Example:
        >>> mean_phase_deviation(np.array([[1.0, 1.0], [-0.5, 1.0j]])).round(3).tolist()
        [0.0, 45.0]
    """
    square = (shapes * shapes).sum(axis=0)
    turned = shapes * np.exp(-0.5j * np.angle(square))
    deviation = np.degrees(np.arctan2(np.abs(turned.imag), np.abs(turned.real)))
    size = np.abs(shapes)
    return _ratio((size * deviation).sum(axis=0), size.sum(axis=0))


def mode_singular_values(basis: ModalBasis, *, n_steps: int) -> FloatArray:
    """Mode singular values sqrt(|c| |b| (1 + |lambda| + ... + |lambda|^(n_steps-1))), relative to the largest.

    Computed by logarithms, so that an unstable pole does not overflow. Juang 1994, equation 5.50; n_steps = a + b - 1.

    Returns:
        (n_poles,) in [0, 1].
    """
    if basis.poles.size == 0:
        return np.empty(0)
    size = np.abs(basis.poles)
    small = np.minimum(size, 1 / size)
    with np.errstate(divide="ignore", invalid="ignore"):
        closed = -np.expm1(n_steps * np.log(small)) / (1 - small)
        series = np.log(np.where(1 - small < 1e-12, float(n_steps), closed))
        logarithm = np.log(norms(basis.outputs, 0) * norms(basis.inputs, 1)) + series
    logarithm += np.where(size > 1, (n_steps - 1) * np.log(size), 0.0)
    if not np.isfinite(logarithm.max()):
        return np.zeros_like(size)
    return cast("FloatArray", np.exp(0.5 * (logarithm - logarithm.max())))


def _powers(poles: ComplexArray, count: int) -> ComplexArray:
    # An unstable sequence is divided by its last value: only its direction counts, and its start may underflow freely.
    size = np.abs(poles)
    exponent = np.arange(count) - np.where(size > 1, count - 1, 0)[:, np.newaxis]
    return poles[:, np.newaxis] ** exponent


def _ratio(above: FloatArray, below: FloatArray, *, otherwise: float = np.nan) -> FloatArray:
    result = np.full(np.shape(below), otherwise)
    np.divide(above, below, out=result, where=below > 0)
    return result


NYQUIST_MARGIN = 0.05
"""A damped frequency within this share of the Nyquist frequency is remarked on."""

NOT_JUDGED = "not judged: repeatability needs the records; use modal.identify"


def extract_modes(realisation: Realisation, *, decay_limit: float = DECAY_LIMIT) -> ModalModel:
    """Modes of a realisation, one a conjugate pair, by rising frequency, with all indicators.

    With lambda a discrete pole: s = ln(lambda) / dt, frequency |s| / (2 pi), damping ratio -Re(s) / |s|. Poles that
    die within a sample (|lambda| <= 1e-3 max(1, largest |lambda|): deadbeat, pure delay) are no modes, left out. A pole
    with |lambda| > 1 is "unstable" whatever its frequency, one on the negative real axis "nyquist", one on the positive
    "real". Only poles that cannot be modes get a verdict here ("noise"); all others stay "doubtful" until the records
    have been asked again.

    Args:
        realisation: from `era.realise`, or from any state-space model: without Hankel factors indicators are nan.
        decay_limit: share of its first amplitude below which a mode counts as died out, see `modal.modes.extraction`.

    Returns:
        Modes with shape and participation such that outer(shape, participation) is the residue of the pulse response;
        of a model that looks ahead in its inputs, of the pulse response that rings on after the instant of the pulse.

    References:
        Juang, Pappa, Journal of Guidance, Control, and Dynamics 8(5), 1985, doi 10.2514/3.20031.

    Example:
        >>> pole = 0.99 * np.exp(0.2j)
        >>> A = np.array([[pole.real, pole.imag], [-pole.imag, pole.real]])
        >>> model = Realisation(A, np.ones((2, 1)), np.ones((1, 2)), np.zeros((1, 1)), 0.01)
        >>> [(round(mode.frequency, 3), round(mode.damping_ratio, 4)) for mode in extract_modes(model)]
        [(3.187, 0.0502)]
    """
    require(realisation, Realisation, where="extract_modes", made_by="era.realise")
    basis = modal_basis(realisation)
    factors = realisation.factors
    indicators = None if factors is None else evaluate(factors, basis, decay_limit=decay_limit)
    modes = [_mode(basis, indicators, i, realisation) for i in range(basis.poles.size)]
    caution, missing = np.nan, ""
    if factors is None:
        missing = (
            "the realisation holds no Hankel factors: it was not cut from data, so there is nothing to compare with"
        )
    else:
        n_past = factors.observer_order if factors.observer_order is not None else factors.n_block_rows
        caution = realisation.order / (n_past * realisation.C.shape[0])
    return ModalModel(
        modes=tuple(sorted(modes, key=lambda mode: (mode.frequency, mode.pole.imag))),
        dt=realisation.dt,
        indicator_caution=caution,
        indicators_missing=missing,
    )


def _mode(basis: ModalBasis, indicators: Indicators | None, index: int, realisation: Realisation) -> Mode:
    discrete = complex(basis.poles[index])
    pole = complex(continuous_poles(basis.poles[index], realisation.dt))
    kind = kind_of(discrete)
    shape = basis.outputs[:, index]
    largest = complex(largest_component(shape[:, np.newaxis])[0])
    driven = basis.inputs[index] * largest * discrete**realisation.lead if realisation.n_inputs else []
    size = abs(pole)
    mode = Mode(
        pole=pole,
        kind=kind,
        frequency=size / (2 * np.pi),
        damping_ratio=-pole.real / size if size > 0 else np.nan,
        shape=frozen_complex(shape / largest, name="shape"),
        participation=frozen_complex(driven, name="participation"),
    )
    is_noise = cannot_be_a_mode(mode, realisation.dt)
    if is_noise:
        mode = replace(mode, probability=0.0, verdict="noise")
    words = [*remarks(mode, realisation.dt), *([] if is_noise else [NOT_JUDGED])]
    if not basis.separable[index]:
        words.append("its pole coincides with another one: shape and participation of the two cannot be told apart")
    mode = replace(mode, reason="; ".join(words))
    return mode if indicators is None else _with_indicators(mode, indicators, index)


def cannot_be_a_mode(mode: Mode, dt: float) -> bool:
    """Whether a pole of samples `dt` apart is no mode to be listed, however often it is found again.

    It grows, or its natural frequency |s| / (2 pi) lies above half of the sampling frequency, however slowly it may
    turn for its damping: samples tell no such frequency from one that is folded, nor from an answer within a sample.

    Example:
        >>> one = np.ones(1)
        >>> fast = Mode(
        ...     pole=complex(-690, 290), kind="oscillatory", frequency=119.1, damping_ratio=0.92, shape=one,
        ...     participation=one
        ... )
        >>> cannot_be_a_mode(fast, 1 / 200), cannot_be_a_mode(fast, 1 / 400)
        (True, False)
    """
    return mode.kind in ("unstable", "nyquist") or (mode.kind == "oscillatory" and _is_too_fast(mode, dt))


def _is_too_fast(mode: Mode, dt: float) -> bool:
    return abs(mode.pole) * dt > np.pi


def _with_indicators(mode: Mode, indicators: Indicators, index: int) -> Mode:
    return replace(
        mode,
        amplitude_coherence=float(indicators.amplitude_coherence[index]),
        phase_collinearity=float(indicators.phase_collinearity[index]),
        emac_output=float(indicators.emac_output[index]),
        emac_input=float(indicators.emac_input[index]),
        emac=float(indicators.emac[index]),
        cmi=float(indicators.cmi[index]),
        msv=float(indicators.msv[index]),
        mpd=float(indicators.mpd[index]),
    )


def remarks(mode: Mode, dt: float) -> tuple[str, ...]:
    """What the pole alone lets the reader know: a kind that is no vibration, a frequency next to the Nyquist frequency.

    Example:
        >>> one = np.ones(1)
        >>> mode = Mode(pole=-3, kind="real", frequency=0.5, damping_ratio=1.0, shape=one, participation=one)
        >>> remarks(mode, 0.01)
        ('a real pole: overdamped or drift, not a vibration mode',)
    """
    nyquist = 0.5 / dt
    if mode.kind == "unstable":
        return (f"grows in time (damping ratio {100 * mode.damping_ratio:.2g} %): no mode of a stable system",)
    if mode.kind == "nyquist":
        return (f"a negative real pole, at half the sampling frequency ({nyquist:.4g} Hz): no mode of the system",)
    if mode.kind == "real":
        return ("a real pole: overdamped or drift, not a vibration mode",)
    if _is_too_fast(mode, dt):
        return (f"a natural frequency above half of the sampling frequency ({nyquist:.4g} Hz): no mode of the system",)
    if abs(mode.pole.imag) / (2 * np.pi) >= (1 - NYQUIST_MARGIN) * nyquist:
        return (f"within {100 * NYQUIST_MARGIN:.0f} % of the Nyquist frequency {nyquist:.4g} Hz: may be an alias",)
    return ()
