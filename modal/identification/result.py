"""What `modal.identify` returns: every stage of the road from records to modes, and why each choice was made."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from era.realisation import Realisation
from modal.modes.mode import ModalModel
from modal.modes.uncertainty import Uncertainty
from okid.arrays import FloatArray, frozen_with_gaps
from okid.excitation import Excitation
from okid.markov import MarkovParameters
from okid.observer import ObserverFit
from okid.record import Record
from okid.residuals import ResidualCheck

__all__ = ["Choice", "Fit", "Identification", "OrderEvidence", "StabilisationPoint"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Choice:
    """One decision: what was chosen, and why, in words with numbers.

    Attributes:
        what: e.g. "observer order", "ridge", "model order", "frequency band".
        value: as it reads in a report, e.g. "40" or "0 to 25 Hz".
        reason: one sentence with its numbers.
    """

    what: str
    value: str
    reason: str


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Fit:
    """How well the model, fed with the inputs alone, repeats the outputs: 1 - |y - y_sim| / |y - mean(y)|.

    Attributes:
        cross_validated: (n_outputs,) on rows that the model was not fitted to (folds of interleaved blocks).
        folds: (n_folds,) mean over outputs on each fold.
        whole: (n_outputs,) of the final model on all rows: reported, never used to choose.
        one_step: (n_outputs,) of the one-step prediction: looks perfect even for a bad model.
    """

    cross_validated: FloatArray
    folds: FloatArray
    whole: FloatArray
    one_step: FloatArray

    def __post_init__(self) -> None:
        for name in ("cross_validated", "folds", "whole", "one_step"):
            object.__setattr__(self, name, frozen_with_gaps(getattr(self, name), name=name, shape=(None,)))

    @property
    def mean(self) -> float:
        """Cross-validated fit, mean over outputs."""
        return float(self.cross_validated.mean())


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StabilisationPoint:
    """One pole of the model of one order, compared with the model of the next lower order.

    Attributes:
        order: model order.
        frequency: [Hz].
        damping_ratio: [-].
        overlap: closed-form overlap, in [0, 1], of its own pulse response with that of the pole it continues (0: new).
        emac: extended modal amplitude coherence.
        repeatability: mean overlap, in [0, 1], with its continuation in models of halves of the data and of another
            observer; nan where unknown.
    """

    order: int
    frequency: float
    damping_ratio: float
    overlap: float
    emac: float
    repeatability: float = math.nan


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class OrderEvidence:
    """What the model order was decided on.

    Attributes:
        singular_values: of the scaled block Hankel matrix, relative order kept.
        order: the order chosen.
        gap_order: where the largest ratio of neighbouring singular values stands.
        candidate_orders: (n_candidates,) model orders that were tried with the chosen observer and ridge.
        candidate_fits: (n_candidates,) their cross-validated fits, mean over outputs; nan where unstable.
        stabilisation: poles of all orders.
    """

    singular_values: FloatArray
    order: int
    gap_order: int
    candidate_orders: FloatArray
    candidate_fits: FloatArray
    stabilisation: tuple[StabilisationPoint, ...]

    def __post_init__(self) -> None:
        for name in ("singular_values", "candidate_orders", "candidate_fits"):
            object.__setattr__(self, name, frozen_with_gaps(getattr(self, name), name=name, shape=(None,)))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Identification:
    """The result of `modal.identify`.

    Attributes:
        records: as used: means removed, decimated to the band (see `choices`); the realisation has their time step.
        excitation: what the inputs allow to be identified, before the fit.
        observer: the observer fit.
        residuals: whiteness and input correlation of its residuals.
        markov: Markov parameters recovered from it.
        realisation: state-space model in the units of the records, refined by output error where that paid.
        modes: every mode with its indicators and its verdict.
        order_evidence: what the model order was decided on.
        choices: every automatic choice (and every one taken from an argument) with its reason.
        fit: free-run fits.
        simulated: free run of the model for each record, same shape and channels as `records`; without inputs its
            one-step prediction.
        predicted: one-step prediction for each record.
        warnings: sentences that the user must read; empty when all is well.
        uncertainty: standard deviations of the modes (in their order) and of the realisation's Markov parameters; None
            in a file that was saved before there were any.
        innovations: whiteness and input correlation of the realisation's one-step errors; None where it has no gain or
            the records are too short for the test.
        fitted_model: the model that observer, Markov parameters and modes belong to: the realisation without the states
            that stand for input delays and integrators.
        innovation_covariance: (n_outputs, n_outputs) of these errors, for `era.forecast`; None without refinement.
    """

    records: tuple[Record, ...]
    excitation: Excitation
    observer: ObserverFit
    residuals: ResidualCheck
    markov: MarkovParameters
    realisation: Realisation
    modes: ModalModel
    order_evidence: OrderEvidence
    choices: tuple[Choice, ...]
    fit: Fit
    simulated: tuple[Record, ...]
    predicted: tuple[Record, ...]
    warnings: tuple[str, ...]
    uncertainty: Uncertainty | None = None
    innovations: ResidualCheck | None = None
    innovation_covariance: FloatArray | None = None
    fitted_model: Realisation | None = None

    def save(self, path: str | Path, *, existing: Literal["refuse", "replace"] = "refuse") -> Path:
        """Write all of it into one file without pickle; `modal.load` reads it back bit for bit.

        Args:
            path: of the file; the usual ending is .npz.
            existing: "refuse" (an error when the file is there) or "replace".

        Returns:
            The path.

        Raises:
            InvalidDataError: the file exists and may not be replaced, or it cannot be written.
        """
        from modal.identification.storage import save  # it needs this type, so it cannot be imported above

        return save(self, path, existing=existing)
