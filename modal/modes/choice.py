"""What a step of an identification decided and why, and how well a model repeats its records."""

from dataclasses import dataclass

from okid.arrays import FloatArray, frozen_with_gaps
from okid.display import Displayed

__all__ = ["Choice", "Fit"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Choice(Displayed):
    """One decision: what was chosen, and why, in words with numbers.

    Attributes:
        what: e.g. "observer order", "ridge", "model order", "frequency band".
        value: as it reads in a report, e.g. "40" or "0 to 25 Hz".
        reason: one sentence with its numbers.
    """

    what: str
    value: str
    reason: str


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Fit(Displayed):
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
