"""Standard deviations of the modes of an identification: of its refinement, else propagated through OKID and ERA."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from modal.estimation.propagation import propagated
from modal.identification.covariance import output_error_uncertainty
from modal.identification.final_model import FinalModel
from modal.modes.mode import ModalModel
from modal.modes.uncertainty import Uncertainty
from okid.errors import InsufficientDataError
from okid.record import Record

__all__ = ["with_deviations"]


def with_deviations(model: ModalModel, final: FinalModel, records: Sequence[Record]) -> tuple[ModalModel, Uncertainty]:
    """The modes with the standard deviations of frequency, damping ratio and shape, and all of them together.

    Args:
        model: modes of the final model's realisation.
        final: the final model.
        records: that it was fitted to.
    """
    if final.refined is not None:
        known = output_error_uncertainty(final.refined, model.modes, n_lags=final.markov.n_lags)
    else:
        known = _propagated(model, final, records)
    modes = tuple(
        replace(
            mode,
            frequency_std=float(known.frequency_std[i]),
            damping_ratio_std=float(known.damping_ratio_std[i]),
            shape_std=known.shape_std[i],
        )
        for i, mode in enumerate(model.modes)
    )
    return replace(model, modes=modes), known


def _propagated(model: ModalModel, final: FinalModel, records: Sequence[Record]) -> Uncertainty:
    try:
        return propagated(
            records, observer=final.observer, markov=final.markov, realisation=final.cut, modes=model.modes
        )
    except InsufficientDataError:  # too short for two blocks
        return _unknown(model, final)


def _unknown(model: ModalModel, final: FinalModel) -> Uncertainty:
    n_modes, n_outputs = len(model), final.cut.n_outputs
    return Uncertainty(
        method="propagation",
        frequency_std=np.full(n_modes, np.nan),
        damping_ratio_std=np.full(n_modes, np.nan),
        shape_std=np.full((n_modes, n_outputs), np.nan),
        markov_std=np.full((final.markov.n_lags + 1, n_outputs, final.cut.n_inputs), np.nan),
    )
