"""Modes beside those of the model: what the inputs leave shows them, or the user adds and drops some.

What the inputs leave is a record of its own. Where forces that nobody measured make most of the motion, the free run
takes away what the inputs explain, and the rest rings at the poles of the same system: it is identified as ambient
motion, and judged as such. Where more than half of what is left follows the inputs, they made it in a way that the
model does not know, and a mode of it is not told apart from their own colour: it does not count.

A verdict weighs what the data say; the user may know more. What is changed by hand says so, in the mode, in a choice
and in the fit, which is that of the changed model.

A mode is taken out of a model exactly: with its right vectors R and left vectors L (L R = 1), null(L) is the invariant
subspace of all other poles, and a state x = R a + N b has b = N' (x - R L x) there, for N an orthonormal basis of it.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import scipy

from era.realisation import Realisation
from modal.estimation.fits import fit_of, model_runs
from modal.identification.result import Identification
from modal.modes.modal_form import discrete_poles, modal_basis
from modal.modes.modal_mass import driving_point_of, normalise_shapes, phase_words
from modal.modes.mode import Choice, Fit, ModalModel, Mode, Uncertainty, numbered
from modal.preparation.band import missed_share, share_that_follows
from modal.preparation.delay import late_and_early, late_inputs
from modal.preparation.drift import summed_inputs, without_drift
from modal.verdict.judgement import DOUBTED
from modal.verdict.linearity import powers_of_motion
from modal.verdict.probability import FILTER_EDGE, MOST_MISSED
from modal.wording.text import LEAST_FIT, NINETY_FIVE, fit_text, hertz, listed
from okid.errors import IdentificationError, IdentificationWarning, InvalidDataError
from okid.record import Record


def with_undriven(result: Identification, again: Callable[[Sequence[Record]], Identification]) -> Identification:
    """The identification with the modes that only what the inputs leave shows, where that is most of the motion.

    A mode that the inputs show as well keeps what they say of it, unless that is not even certain within its
    bandwidth; then, as a pole of the same mode that was no mode of the system, it makes room. Nothing else of the
    result changes: the realisation is what the inputs do.

    Args:
        result: of records with inputs.
        again: identifies records without inputs as ambient motion.
    """
    left = [record.outputs - run.outputs for record, run in zip(result.records, result.simulated, strict=True)]
    if not _asks(result, left):
        return result
    remains = [replace(record, outputs=rest) for record, rest in zip(result.records, left, strict=True)]
    try:
        ambient = again([record.select(inputs=[]) for record in remains])
    except IdentificationError:  # too short, or a channel that the model explains to rounding
        return result
    edge = FILTER_EDGE * 0.5 / remains[0].dt  # the band was perhaps chosen, and filtered to it
    seen = [mode for mode in ambient.modes.system if mode.frequency < edge]
    shares = share_that_follows(remains, [mode.frequency for mode in seen], [0.5 * _half_width(mode) for mode in seen])
    own = [
        mode
        for mode, share in zip(seen, shares.tolist(), strict=True)
        if share < MOST_MISSED and not any(_sure(known) and _same(mode, known) for known in result.modes)
    ]
    if not own:
        return result
    crooked = powers_of_motion(result.records, result.predicted).told
    return _joined(result, ambient, [_told(mode, result.channels.n_inputs, crooked=crooked) for mode in own])


def _asks(result: Identification, left: Sequence[np.ndarray]) -> bool:
    """Whether noise or forces that were not measured make most of the motion, beside what the inputs surely drive."""
    if result.record_kind != "driven" or not result.modes.system or not result.fit.mean < LEAST_FIT:
        return False
    return not missed_share(result.records, left) > MOST_MISSED


def _sure(mode: Mode) -> bool:
    """Whether this is a mode of the system whose interval, where it has one, lies within its own bandwidth."""
    return mode.verdict == "system" and not NINETY_FIVE * mode.frequency_std > _half_width(mode)


def _same(one: Mode, other: Mode) -> bool:
    """Whether two poles are one mode, as far as can be told: each within the bandwidth of the other."""
    return abs(one.frequency - other.frequency) <= _half_width(one) + _half_width(other)


def _half_width(mode: Mode) -> float:
    return max(0.0, mode.damping_ratio) * mode.frequency


def _told(mode: Mode, n_inputs: int, *, crooked: bool) -> Mode:
    """The mode beside those that the inputs drive: doubtful where what is left follows powers of their answer."""
    none = np.zeros(n_inputs, dtype=np.complex128)
    where = "in what the inputs leave: most of what drives it was not measured"
    where += ", and its damping holds if that is broad-band"
    if not crooked:
        return replace(mode, participation=none, reason=f"{mode.reason}; {where}")
    doubt = "what the inputs leave follows powers of the motion: it may be made by what is not linear"
    return replace(
        mode,
        participation=none,
        verdict="doubtful",
        probability=min(mode.probability, DOUBTED),
        doubts=(*mode.doubts, ("data", doubt)),
        reason=f"{doubt}; {mode.reason}; {where}",
    )


def _joined(result: Identification, ambient: Identification, added: Sequence[Mode]) -> Identification:
    """A doubtful mode takes nothing's place."""
    place = {mode.pole: i for i, mode in enumerate(ambient.modes)}
    certain = [mode for mode in added if mode.verdict == "system"]
    kept = [_sure(mode) or not any(_same(mode, one) for one in certain) for mode in result.modes]
    stay = [mode for mode, stays in zip(result.modes, kept, strict=True) if stays]
    added = [mode for mode in added if mode in certain or not any(_same(mode, one) for one in stay)]
    if not added:
        return result
    known = result.uncertainty
    rows = [(mode, known, i) for i, (mode, stays) in enumerate(zip(result.modes, kept, strict=True)) if stays]
    rows += [(mode, ambient.uncertainty, place[mode.pole]) for mode in added]
    rows.sort(key=lambda row: row[0].frequency)
    choice = Choice(
        what="what the inputs leave",
        value="one mode" if len(added) == 1 else f"{len(added)} modes",
        reason="identified by itself as ambient motion, because it is most of the outputs: "
        f"{listed([hertz(mode.frequency) for mode in added])} Hz",
    )
    return replace(
        result,
        modes=replace(result.modes, modes=tuple(mode for mode, _, _ in rows)),
        uncertainty=None if known is None else _uncertainty_of(known, rows, result.modes),
        choices=(*result.choices, choice),
        warnings=(*result.warnings, *_shown_by_none(certain)),
    )


def _shown_by_none(certain: Sequence[Mode]) -> tuple[str, ...]:
    """That no response of the model shows these modes, in words."""
    if not certain:
        return ()
    names = listed([hertz(mode.frequency) for mode in certain])
    modes = f"The mode at {names} Hz was" if len(certain) == 1 else f"The modes at {names} Hz were"
    which = "it" if len(certain) == 1 else "them"
    why = f"forces that were not measured drive {which} most, so the responses of the model do not show {which}"
    return (f"{modes} found in what the inputs leave: {why}, and no modal mass can be told.",)


def _uncertainty_of(
    known: Uncertainty, rows: Sequence[tuple[Mode, Uncertainty | None, int]], before: ModalModel
) -> Uncertainty:
    """Of the joined modes, in their order; no modal mass of a mode that no input drives."""
    n_outputs, n_inputs = before.modes[0].shape.size, before.modes[0].participation.size
    unknown = np.full((n_outputs, n_inputs), np.nan)
    return replace(
        known,
        frequency_std=np.array([mode.frequency_std if own is None else own.frequency_std[i] for mode, own, i in rows]),
        damping_ratio_std=np.array(
            [mode.damping_ratio_std if own is None else own.damping_ratio_std[i] for mode, own, i in rows]
        ),
        shape_std=np.array([np.full(n_outputs, np.nan) if own is None else own.shape_std[i] for _, own, i in rows]),
        found=np.array([1.0 if own is None else own.found[i] for _, own, i in rows]),
        mass_std=None
        if known.mass_std is None
        else np.array([known.mass_std[i] if own is known else unknown for _, own, i in rows]),
    )


def with_modes(identification: Identification, *, add: Sequence[int] = (), drop: Sequence[int] = ()) -> Identification:
    """The identification with modes that the user takes for modes of the system, and without others.

    Args:
        identification: of records, from `modal.identify`.
        add: numbers of modes, as every table shows them, that become "system" whatever their verdict was.
        drop: numbers of modes that become "noise" and are taken out of the realisation.

    Returns:
        The same with the user's choice among its `choices`, with the free run and the fit of the changed model; its
        `fit.cross_validated` and `fit.folds` are nan where a mode was dropped: nothing was fitted anew.

    Raises:
        InvalidDataError: no such number, a number in both lists, or a result of frequency responses.
        NumericalError: what is left cannot run freely.

    Example:
        >>> rng = np.random.default_rng(1)
        >>> tip = np.zeros(1500)
        >>> force = rng.standard_normal(1500)
        >>> for k in range(2, 1500):
        ...     tip[k] = 1.6 * tip[k - 1] - 0.95 * tip[k - 2] + force[k - 1]
        >>> from modal.identification.pipeline import identify
        >>> from okid.record import Record
        >>> found = identify(Record(force, tip + 0.1 * rng.standard_normal(1500), 0.02))
        >>> with_modes(found, add=[1]).choices[-1].value
        'added 1'
    """
    if not identification.records:
        raise InvalidDataError("modes are added and dropped by hand in results of records, not of frequency responses.")
    by_number = dict(numbered(identification.modes))
    add, drop = tuple(dict.fromkeys(add)), tuple(dict.fromkeys(drop))
    unknown = [number for number in (*add, *drop) if number not in by_number]
    if unknown or set(add) & set(drop):
        raise InvalidDataError(
            f"modes are numbered from 1 to {len(by_number)}, and each is added or dropped, but add is {list(add)} and "
            f"drop {list(drop)}; take the numbers from the table of modes."
        )
    if not add and not drop:
        return identification
    added, dropped = [by_number[number] for number in add], [by_number[number] for number in drop]
    changed = {
        id(mode): replace(mode, verdict="system", doubts=(), reason=f"added by hand; it was {_was(mode)}")
        for mode in added
    }
    changed |= {
        id(mode): replace(mode, verdict="noise", doubts=(), reason=f"dropped by hand; it was {_was(mode)}")
        for mode in dropped
    }
    modes = tuple(changed.get(id(mode), mode) for mode in identification.modes)
    result = replace(identification, modes=replace(identification.modes, modes=modes))
    before = float(identification.fit.whole.mean())
    if dropped:
        result = _run_anew(result, dropped)
    named = [(word, [str(number) for number in some]) for word, some in (("added", add), ("dropped", drop)) if some]
    value = ", ".join(f"{word} {listed(numbers)}" for word, numbers in named)
    reason = f"the user's choice; the free run through all rows fits by {fit_text(float(result.fit.whole.mean()))}"
    choice = Choice(what="modes by hand", value=value, reason=f"{reason}, {fit_text(before)} before")
    return replace(result, choices=(*result.choices, choice))


def with_modal_mass(identification: Identification, *, driving_point: tuple[str, str]) -> Identification:
    """The identification with the modal mass of each mode, for the report and every table.

    Args:
        identification: with a force among its inputs.
        driving_point: name of the output and of the input [N] at one place and in one direction.

    Returns:
        The same, `modal_mass` and `modal_mass_std` of its modes of the system known [kg], the driving point among its
        `choices`. Where the point cannot be one, because a mode has a negative mass there, the sentence is a warning.

    Raises:
        InvalidDataError: no such channel, or units that give no modal mass in kg.
    """
    model = identification.modes
    output, force = driving_point
    _, acting = driving_point_of(model, driving_point)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", IdentificationWarning)
            scaled = normalise_shapes(model, driving_point=driving_point)
    except InvalidDataError as error:
        return replace(identification, warnings=(*identification.warnings, f"There is no modal mass: {error}"))
    known = zip(scaled.modal_mass.tolist(), scaled.modal_mass_std.tolist(), strict=True)
    modes = tuple(
        replace(mode, **dict(zip(("modal_mass", "modal_mass_std"), next(known), strict=True)))
        if mode.verdict == "system"
        else mode
        for mode in model
    )
    reason = "a sensor and a force at one place and in one direction give modal masses"
    return replace(
        identification,
        modes=replace(model, modes=modes),
        choices=(*identification.choices, Choice(what="driving point", value=f"{output}, {force}", reason=reason)),
        warnings=(*identification.warnings, *filter(None, [phase_words(model, acting)])),
    )


def _was(mode: Mode) -> str:
    return f"{mode.verdict}" + (f" ({mode.reason})" if mode.reason else "")


def _run_anew(result: Identification, dropped: Sequence[Mode]) -> Identification:
    dropped = [mode for mode in dropped if mode.participation.any() or not mode.participation.size]
    fitted = without_modes(result.fitted_model or result.realisation, dropped)
    late, early = late_and_early(result.input_delay)
    runs = model_runs(fitted, late_inputs(_as_fitted(result), result.input_delay))
    unknown = np.full_like(result.fit.cross_validated, np.nan), np.full_like(result.fit.folds, np.nan)
    return replace(
        result,
        records=tuple(record.samples(late, record.n_samples - early) for record in result.records),
        realisation=without_modes(result.realisation, dropped),
        fitted_model=fitted,
        simulated=runs.simulated,
        predicted=runs.predicted,
        fit=Fit(
            cross_validated=unknown[0],
            folds=unknown[1],
            whole=fit_of(runs.records, runs.simulated),
            one_step=fit_of(runs.records, runs.predicted),
        ),
    )


def _as_fitted(result: Identification) -> tuple[Record, ...]:
    """The records with their inputs summed, once for each integrator of the realisation, as its model was fitted to.

    Sums start from an unknown level: what that adds is among the slow functions that the outputs were freed of.
    """
    if result.fitted_model is None:
        return result.records
    late, n_inputs = (
        sum(result.input_delay) + result.channels.n_inputs * result.realisation.lead,
        result.channels.n_inputs,
    )
    number = (result.realisation.order - result.fitted_model.order - late) // max(1, n_inputs)
    if not number:
        return result.records
    return tuple(without_drift(summed_inputs(record, number), number) for record in result.records)


def without_modes(realisation: Realisation, modes: Sequence[Mode]) -> Realisation:
    """The realisation without the poles of some modes: the responses of all others stay as they are."""
    basis = modal_basis(realisation)
    wanted, _ = discrete_poles(tuple(modes), realisation.dt)
    own = np.unique(np.abs(wanted[:, np.newaxis] - basis.poles).argmin(axis=1))
    right, left, pair = basis.right[:, own], basis.left[own], basis.is_pair[own]
    R = np.hstack([right.real, right.imag[:, pair]])
    L = np.vstack([left.real * np.where(pair, 2.0, 1.0)[:, np.newaxis], -2.0 * left.imag[pair]])
    N = scipy.linalg.null_space(L)

    def rest(into: np.ndarray) -> np.ndarray:
        return np.asarray(N.T @ (into - R @ (L @ into)))

    return Realisation(
        N.T @ realisation.A @ N,
        rest(realisation.B),
        realisation.C @ N,
        realisation.D,
        realisation.dt,
        K=None if realisation.K is None else rest(realisation.K),
        lead=realisation.lead,
    )
