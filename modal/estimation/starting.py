"""Where a refinement starts: the modal form of a realisation, and the initial states that suit it best."""

import numpy as np

from era.realisation import Realisation
from modal.estimation.free_run import ModalForm, free_run
from modal.estimation.modal_states import ModalParameters
from modal.estimation.output_error import NONE, OutputError, Step, evaluate
from modal.modes.modal_form import modal_basis
from okid.arrays import BoolArray, ComplexArray

__all__ = ["starting_parameters"]


def starting_parameters(realisation: Realisation, data: OutputError, *, held_out: int = NONE) -> Step | None:
    """Modal form of a stable model with initial states fitted to the training rows.

    None where it is unstable, or where all its poles are zero: a pulse response that ends is left to the observer.
    """
    basis = modal_basis(realisation)
    if not basis.poles.size or np.abs(basis.poles).max() >= 1.0:
        return None
    # unit size of each participation, so that shapes and states have comparable sizes
    size = np.linalg.norm(basis.inputs, axis=1)
    size = np.where(size > 0.0, size, 1.0)
    form = ModalForm(
        poles=basis.poles,
        weights=np.where(basis.is_pair, 2.0, 1.0),
        shapes=basis.outputs * size,
        participations=basis.inputs / size[:, np.newaxis],
        feedthrough=realisation.D,
    )
    training = [rows.copy() for rows in data.rows]
    for block in data.blocks:
        if block.label == held_out:
            training[block.record][block.first : block.last] = False
    states = [free_run(form, record, rows).state for record, rows in zip(data.records, training, strict=True)]
    start = ModalParameters(
        poles=form.poles,
        is_pair=basis.is_pair,
        inputs=_real_unless(form.participations, basis.is_pair[:, np.newaxis]),
        states=_real_unless(np.array(states), basis.is_pair),
    )
    return evaluate(start, data, held_out=held_out)


def _real_unless(values: ComplexArray, is_pair: BoolArray) -> ComplexArray:
    return np.where(is_pair, values, values.real).astype(np.complex128)
