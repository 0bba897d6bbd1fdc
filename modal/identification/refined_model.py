"""The chosen model refined on all rows, as a state-space model in the units of the records.

Where a refinement may run until it stands still and leaves white noise, its last steps weigh each output by the noise
that it has: then it is the maximum-likelihood estimate for noise on the outputs, and reaches the Cramer-Rao bound.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from era.realisation import Realisation
from modal.estimation.cross_validation import scaled_record
from modal.estimation.free_run import filled
from modal.estimation.growth import errors_of, with_weak_mode
from modal.estimation.modal_parameters import in_units, scaled_model
from modal.estimation.modal_states import blocks_of
from modal.estimation.output_error import SMALLEST_GAIN, OutputError, Step, refine
from modal.estimation.starting import starting_parameters
from modal.identification.refined_search import MOST_STEPS
from okid.arrays import FloatArray
from okid.record import Record
from okid.scaling import ChannelScaling, channel_scaling
from okid.whiteness import centred, whiteness

__all__ = ["RefinedModel", "refined_model"]

UNTIL_STILL = 30
"""Steps of a refinement that may run until it stands still."""
N_BLOCKS = 40
"""Blocks of rows whose sums are kept apart, for a covariance that holds for noise of any colour."""
WHITE = 1.3
"""Whiteness statistic over its degrees of freedom up to which what is left counts as white noise."""
WHITENESS_LAGS = 20
WEIGHTINGS = 4
"""Rounds in which outputs' weights and the model settle."""
SMALLEST_NOISE = 1e-3
"""Of the noisiest output's: an output with less noise is not weighted more."""
NOISE_FREE = 1e-7
"""Relative error of a free run that leaves nothing to be refined."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RefinedModel:
    """A refined model and what its covariance needs.

    Attributes:
        realisation: in the units of the records; its Hankel factors are those of the data before refinement.
        step: the last one, scaled channels.
        data: what it was fitted to.
        scaling: of the channels.
        weights: (n_outputs,) of the squared errors.
        whiteness_ratio: of what the free run leaves; nan where it leaves nothing.
    """

    realisation: Realisation
    step: Step
    data: OutputError
    scaling: ChannelScaling
    weights: FloatArray
    whiteness_ratio: float

    @property
    def leaves_white_noise(self) -> bool:
        """Whether what the free run leaves is white."""
        return self.whiteness_ratio <= WHITE


def refined_model(
    records: Sequence[Record],
    start: Realisation,
    n_steps: int,
    *,
    weak_modes: int = 0,
    evidence: Realisation | None = None,
    least_gain: float = SMALLEST_GAIN,
) -> RefinedModel | None:
    """Refine a model on all rows of the records; None where it is noise-free, unstable or without a state.

    Args:
        records: as identified from.
        start: from OKID and ERA, with Hankel factors.
        n_steps: as chosen on held-out rows; `MOST_STEPS` means until it stands still.
        weak_modes: modes to add from what the refined model leaves over.
        evidence: realisation of the order that includes them, whose Hankel factors the result keeps; `start` unless
            given.
        least_gain: relative decrease of the error by a step below which it is the last.
    """
    scaling = channel_scaling(records)
    scaled = tuple(scaled_record(record, scaling) for record in filled(records))
    rows = tuple(record.complete_rows() for record in records)
    data = OutputError(records=scaled, rows=rows, blocks=blocks_of(scaled, _even_blocks(scaled)))
    first = starting_parameters(scaled_model(start, scaling), data)
    if first is None or n_steps == 0:
        return None
    power = sum(float(np.square(record.outputs[there]).sum()) for record, there in zip(scaled, rows, strict=True))
    if first.error <= NOISE_FREE**2 * power:
        return None
    weights = np.ones(start.n_outputs)
    most = UNTIL_STILL if n_steps == MOST_STEPS else n_steps
    last = refine(first, data, n_steps=most, least_gain=least_gain)[-1]
    for _ in range(weak_modes):
        larger = with_weak_mode(last, data)
        last = last if larger is None else refine(larger, data, n_steps=most, least_gain=least_gain)[-1]
    ratio = _whiteness_ratio(last, data)
    if n_steps == MOST_STEPS and start.n_outputs > 1:
        likeliest, own = _weighted(last, data, least_gain)
        own_ratio = _whiteness_ratio(likeliest, data)
        if own_ratio <= WHITE:
            last, weights, ratio = likeliest, own, own_ratio
    realisation = in_units(last, start if evidence is None else evidence, scaling)
    return RefinedModel(
        realisation=realisation, step=last, data=data, scaling=scaling, weights=weights, whiteness_ratio=ratio
    )


def _even_blocks(records: Sequence[Record]) -> list[list[list[tuple[int, int]]]]:
    """Every second of the even blocks as runs of a fold of its own: what lies between is cut off as well."""
    total = sum(record.n_samples for record in records)
    fold = []
    for record in records:
        count = max(1, round(N_BLOCKS * record.n_samples / total))
        edges = np.linspace(0, record.n_samples, count + 1).round().astype(int).tolist()
        fold.append(list(zip(edges[1:-1:2], edges[2::2], strict=False)))
    return [fold]


def _weighted(step: Step, data: OutputError, least_gain: float) -> tuple[Step, FloatArray]:
    """Refined with each output weighted by the inverse of its own noise, and the weights, settled in a few rounds.

    An unweighted fit spreads the error of a noisy output over the quiet ones, where it looks like coloured noise, so
    the weights come before the test for whiteness.
    """
    weights = np.ones(step.layout.n_outputs)
    for _ in range(WEIGHTINGS):
        variance = step.linear.squared_errors
        largest = variance.max()
        if largest == 0.0:
            break
        weights = largest / np.maximum(variance, SMALLEST_NOISE**2 * largest)
        step = refine(step, data, n_steps=UNTIL_STILL, least_gain=least_gain, weights=weights)[-1]
    return step, weights


def _whiteness_ratio(step: Step, data: OutputError) -> float:
    return whiteness(centred(errors_of(step, data)), n_lags=WHITENESS_LAGS, n_fitted=0).ratio
