"""One candidate: fitted on the rows outside a fold, reduced to every model order by one SVD, run freely and scored.

The squared error of the run counts on the fold's rows only. Without inputs there is no free run to score: the one-step
prediction of the reduced model takes its place.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from era.balanced import HankelDecomposition
from modal.estimation.cross_validation import Ground, corner, training_decomposition
from modal.estimation.free_run import ModalForm, free_run, modal_form, modal_form_of, one_step_predictor
from okid.arrays import FloatArray

__all__ = ["Trial", "make_trials", "trial_of"]

GAIN = 0.99
"""Leave larger models of an observer out after some in a row that do not bring the error below this share."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Trial:
    """One candidate that was fitted and scored.

    Attributes:
        observer_order: of the observer.
        ridge: of its fit.
        model_order: of the reduced model.
        squared_errors: (n_folds, n_outputs) on held-out rows, scaled channels; nan for folds not run.
        block_errors: (n_blocks,) squared error of each held-out block relative to the power of all of them, mean over
            outputs: what two trials are compared by.
        error: relative held-out error, mean over outputs: 1 - fit.
        refinement_steps: output-error steps made on each fold's training rows before scoring.
        weak_modes: modes of the model order that were added from what the refined model left over.
    """

    observer_order: int
    ridge: float
    model_order: int
    squared_errors: FloatArray
    block_errors: FloatArray
    error: float
    refinement_steps: int = 0
    weak_modes: int = 0


def make_trials(
    ground: Ground,
    observer_orders: Sequence[int],
    ridge: float,
    model_orders: Sequence[int],
    fold_indices: Sequence[int],
    *,
    patience: int | None = None,
) -> list[Trial]:
    """Fit every observer order with one ridge and score its models; what was done before is not done again.

    Args:
        ground: of all trials.
        observer_orders: to fit.
        ridge: of the fits.
        model_orders: rising.
        fold_indices: folds to score on.
        patience: model orders in a row that do not bring an observer's error below `GAIN` of its best, after which its
            larger ones are left out; None scores all.
    """
    trials = []
    power = ground.power[list(fold_indices)]
    for p in observer_orders:
        best, without_gain = np.inf, 0
        for n in model_orders:
            blocks = [_scored(ground, (p, ridge, n, i), max(model_orders)) for i in fold_indices]
            whole = [errors for errors in blocks if errors is not None]
            if len(whole) == len(blocks):
                trials.append(trial_of(p, ridge, n, whole, power))
                without_gain = 0 if trials[-1].error < GAIN * best else without_gain + 1
                best = min(best, trials[-1].error)
            if without_gain == patience:
                break
    return trials


def _scored(ground: Ground, candidate: tuple[int, float, int, int], max_order: int) -> FloatArray | None:
    """Block errors of (observer order, ridge, model order, fold); None where the candidate cannot run."""
    if candidate not in ground.scores:
        observer_order, ridge, model_order, fold = candidate
        found = training_decomposition(ground, observer_order, ridge, fold, max_order)
        ground.scores[candidate] = None if found is None else _block_errors(ground, found, model_order, fold)
    return ground.scores[candidate]


def trial_of(
    observer_order: int,
    ridge: float,
    model_order: int,
    blocks: Sequence[FloatArray],
    power: FloatArray,
    *,
    refinement_steps: int = 0,
    weak_modes: int = 0,
) -> Trial:
    """A trial from the squared errors of each fold's blocks, (n_blocks, n_outputs) a fold."""
    squared = np.array([errors.sum(axis=0) for errors in blocks])
    whole = power.sum(axis=0)
    return Trial(
        observer_order=observer_order,
        ridge=ridge,
        model_order=model_order,
        squared_errors=squared,
        block_errors=(np.concatenate(blocks) / whole).mean(axis=1),
        error=float(np.sqrt(squared.sum(axis=0) / whole).mean()),
        refinement_steps=refinement_steps,
        weak_modes=weak_modes,
    )


def _block_errors(ground: Ground, decomposition: HankelDecomposition, model_order: int, fold: int) -> FloatArray | None:
    """(n_blocks, n_outputs) squared error of the free run on the fold's blocks; None when the model cannot run."""
    form = _form(decomposition, model_order)
    if form is None:
        return None
    errors = []
    for record, trained, held_out, edges in zip(
        ground.scaled, ground.trained[fold], ground.held_out[fold], ground.blocks[fold], strict=True
    ):
        if edges:
            missed = record.outputs - free_run(form, record, trained).outputs
            missed[~held_out] = 0.0
            np.square(missed, out=missed)
            # what lies between two blocks is a segment, too, and left out
            errors.append(np.add.reduceat(missed, np.ravel(edges)[: None if edges[-1][1] < len(missed) else -1])[::2])
    return np.concatenate(errors)


def _form(decomposition: HankelDecomposition, order: int) -> ModalForm | None:
    """The model that runs: without inputs the one-step predictor; None beyond the rank or where it cannot run."""
    found = decomposition
    if found.D.shape[1] == 0:
        model = corner(found, order)
        return None if model is None else modal_form(one_step_predictor(model))
    if order > min(found.rank, found.max_order):
        return None
    return modal_form_of(found.A[:order, :order], found.B[:order], found.C[:, :order], found.D)
