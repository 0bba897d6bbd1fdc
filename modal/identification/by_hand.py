"""Modes that the user adds or drops, and what that costs.

A verdict weighs what the data say; the user may know more. What is changed by hand says so, in the mode, in a choice
and in the fit, which is that of the changed model.

A mode is taken out of a model exactly: with its right vectors R and left vectors L (L R = 1), null(L) is the invariant
subspace of all other poles, and a state x = R a + N b has b = N' (x - R L x) there, for N an orthonormal basis of it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from era.realisation import Realisation
from modal.estimation.fits import fit_of, model_runs
from modal.identification.result import Identification
from modal.modes.modal_form import discrete_poles, modal_basis
from modal.modes.mode import Choice, Fit, Mode, numbered
from modal.wording.text import fit_text, listed
from okid.errors import InvalidDataError


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


def _was(mode: Mode) -> str:
    return f"{mode.verdict}" + (f" ({mode.reason})" if mode.reason else "")


def _run_anew(result: Identification, dropped: Sequence[Mode]) -> Identification:
    fitted = without_modes(result.fitted_model or result.realisation, dropped)
    runs = model_runs(fitted, result.records)
    unknown = np.full_like(result.fit.cross_validated, np.nan), np.full_like(result.fit.folds, np.nan)
    return replace(
        result,
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
    )
