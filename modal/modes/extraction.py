"""From a realisation to its modes: continuous poles, shapes, participation and everything the data's SVD tells of them.

The realisation alone cannot say whether a mode belongs to the system: that needs the records, see
`modal.verdict.judgement`.
"""

from dataclasses import replace

import numpy as np

from era.realisation import Realisation
from modal.modes.indicators import DECAY_LIMIT, Indicators, evaluate
from modal.modes.modal_form import ModalBasis, continuous_poles, kind_of, largest_component, modal_basis
from modal.modes.mode import ModalModel, Mode
from okid.arrays import frozen_complex, require

__all__ = ["NYQUIST_MARGIN", "aliased_frequency", "extract_modes", "remarks"]

NYQUIST_MARGIN = 0.05
"""A damped frequency within this share of the Nyquist frequency is remarked on."""

NOT_JUDGED = "not judged: repeatability needs the records; use modal.identify"


def extract_modes(realisation: Realisation, *, decay_limit: float = DECAY_LIMIT) -> ModalModel:
    """Modes of a realisation, one a conjugate pair, by rising frequency, with all indicators.

    With lambda a discrete pole: s = ln(lambda) / dt, frequency |s| / (2 pi), damping ratio -Re(s) / |s|. Poles that
    die within a sample (|lambda| <= 1e-3 max(1, largest |lambda|): deadbeat, pure delay) are no modes, left out. A pole
    with |lambda| > 1 is "unstable" whatever its frequency, one on the negative real axis "nyquist", one on the positive
    "real". Only unstable and Nyquist poles get a verdict here ("noise"); all others stay "doubtful" until the records
    have been asked again.

    Args:
        realisation: from `era.realise`, or from any state-space model: without Hankel factors indicators are nan.
        decay_limit: share of its first amplitude below which a mode counts as died out, see `modal.modes.indicators`.

    Returns:
        Modes with shape and participation such that outer(shape, participation) is the residue of the pulse response.

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
    n_inputs = realisation.B.shape[1]
    size = abs(pole)
    is_noise = kind in ("unstable", "nyquist")
    mode = Mode(
        pole=pole,
        kind=kind,
        frequency=size / (2 * np.pi),
        damping_ratio=-pole.real / size if size > 0 else np.nan,
        shape=frozen_complex(shape / largest, name="shape"),
        participation=frozen_complex(basis.inputs[index] * largest if n_inputs else [], name="participation"),
        probability=0.0 if is_noise else np.nan,
        verdict="noise" if is_noise else "doubtful",
    )
    words = [*remarks(mode, realisation.dt), *([] if is_noise else [NOT_JUDGED])]
    if not basis.separable[index]:
        words.append("its pole coincides with another one: shape and participation of the two cannot be told apart")
    mode = replace(mode, reason="; ".join(words))
    return mode if indicators is None else _with_indicators(mode, indicators, index)


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
    if abs(mode.pole.imag) / (2 * np.pi) >= (1 - NYQUIST_MARGIN) * nyquist:
        return (f"within {100 * NYQUIST_MARGIN:.0f} % of the Nyquist frequency {nyquist:.4g} Hz: may be an alias",)
    return ()


def aliased_frequency(frequency: float, dt: float) -> float:
    """Where a (damped) frequency appears when it is sampled: |f - fs round(f / fs)|, fs = 1 / dt.

    The decay rate is not changed by sampling, so the damping ratio is: it is quoted against another frequency.

    Args:
        frequency: damped frequency |Im s| / (2 pi) [Hz].
        dt: time step [s].

    Example:
        >>> aliased_frequency(37.0, 0.02)
        13.0
    """
    return abs(frequency - round(frequency * dt) / dt)
