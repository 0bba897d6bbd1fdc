"""Which noise: output error, or the innovation form with so many states of the noise; the likelihood decides.

Candidates, each by maximum likelihood (`modal.estimation.prediction_error`): output error with white noise of any
covariance; the innovation form with as many states, of the noise too, as the canonical variates of the past ask for;
the same with the states of the model. Schwarz's criterion chooses among those that leave white errors. Output error is
consistent whatever the colour of the noise, as long as nothing feeds outputs back; a noise model that is too small is
not, so where no candidate leaves white errors none is taken.

The states of the noise alone are no modes of the system: they serve the estimate and are then left out.

Feedback (`with_feedback`): a direct method tells the system from what feeds it back where something else moves the
inputs too, the outputs follow that, and the loop takes a sample at least: then the innovation form is consistent. Where
nothing else shows, the joint motion of inputs and outputs is that of one loop under the noise, and any split of it into
system and controller that has the same loop explains the record as well.

References:
    Gustavsson, Ljung, Soderstrom, Automatica 13(1), 1977, 59-75, doi 10.1016/0005-1098(77)90009-5; Forssell, Ljung,
    Automatica 35(7), 1999, 1215-1241, doi 10.1016/S0005-1098(99)00022-9.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
import scipy

from era.realisation import Realisation
from era.state_recursion import PoleRecursion
from modal.estimation.cross_validation import scaled_model, scaled_record
from modal.estimation.fits import model_runs
from modal.estimation.free_run import begins_at_rest, can_be_foretold, n_at_rest
from modal.estimation.modal_parameters import errors_of, in_data_states, starting_parameters
from modal.estimation.modal_states import Block, blocks_of
from modal.estimation.output_error import OutputError, PolesAndParticipations, RefinementStep, step_at
from modal.estimation.prediction_error import (
    ROWS_A_NUMBER,
    CanonicalVariates,
    LikeliestFit,
    Sections,
    innovation_form,
    leaves_rounding,
    likeliest,
    n_rows_of,
    predictor_data,
    predictor_start,
    promised_criterion,
    share_of,
)
from modal.identification.covariance import NOT_UNDERSTOOD, chance_of_leaving
from modal.identification.order_search import MODEL_ORDERS
from modal.identification.result import Identification
from modal.modes.extraction import extract_modes
from modal.modes.modal_form import ModalBasis, modal_basis
from modal.modes.mode import Choice, Mode
from modal.preparation.band import FOLLOWS, chance_at_modes
from modal.verdict.constancy import NO_INTERVAL, drifting_modes
from modal.verdict.judgement import DOUBTED, doubted
from modal.verdict.linearity import NOT_LINEAR
from modal.wording.text import hertz, listed
from okid.arrays import ROUNDED, TINY, BoolArray, FloatArray
from okid.errors import NumericalError
from okid.record import Record
from okid.residuals import NOT_WHITE, WHITENESS_LAGS, Whiteness, centred, input_correlation, whiteness
from okid.scaling import ChannelScaling, channel_scaling

ROUND_OFF = 1e-12
"""Add this to the correlations of answers to inputs: two that are one are told apart no further."""
WHITE_AT = 1e-3
"""Call errors white where the portmanteau test of white ones gives more as often: one record in a thousand is lost."""
LONG_BLOCKS = 10
"""Tell how far noise moves a model from so many blocks of a record: they are long against what structures remember."""
ACTS = 0.5
"""Ask that only where inputs act in more than this share of all rows."""
FOUND = "the past of the outputs tells more about the inputs than their own does"
WHY_TOLD = "something feeds them back, or the inputs move between their samples as only the outputs show"
MOVED = "the inputs follow the outputs as in a loop, which may move it by several of its deviations"
ALONE = "nothing that moves the inputs from outside the loop shows in it: may be a mode of the loop, not of the system"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class NoiseModel:
    """The model with its noise.

    Attributes:
        fit: the likeliest predictor, scaled channels.
        whole: A, B, C, D, K of scaled channels, states of the noise included.
        realisation: the states of the system, in the units of the records; K where it has all states.
        scaling: of the channels.
        n_noise: states of the noise alone.
        whiteness_ratio: of the innovations.
        gained: by how much the criterion is below that of output error.
        past: samples of the outputs' past whose canonical variates were its start; 0 for the model given.
    """

    fit: LikeliestFit
    whole: Realisation
    realisation: Realisation
    scaling: ChannelScaling
    n_noise: int
    whiteness_ratio: float
    gained: float
    past: int = 0

    @property
    def covariance(self) -> FloatArray:
        """(n_outputs, n_outputs) of the innovations, in the units of the records."""
        size = self.scaling.output_scale
        covariance: FloatArray = self.fit.covariance * np.outer(size, size)
        return covariance


def noise_model(
    records: Sequence[Record],
    start: Realisation,
    *,
    evidence: Realisation,
    feedback: bool = False,
    order_given: bool = False,
    progress: Callable[[float], None] = lambda _share: None,
) -> tuple[NoiseModel | None, str]:
    """The innovation form where it is the likelier one, and in words why, or why not.

    Args:
        records: as identified from; those with fewer rows than a predictor has channels are left out.
        start: the model with a gain, in their units.
        evidence: whose Hankel factors the result keeps.
        feedback: the outputs are fed back into the inputs, so that output error is not offered.
        order_given: without inputs too, keep the number of states.
        progress: called with the share that is behind at most, before each step.
    """
    why_not = _why_not_foretold(records)
    records = [record for record in records if can_be_foretold(record)]
    why_not = why_not or ("" if feedback else _why_not_steady(start, records))
    if why_not:
        return None, why_not
    scaling = channel_scaling(records)
    scaled, rows = zip(*(_about_rest(scaled_record(record, scaling), start.order) for record in records), strict=True)
    first = scaled_model(start, scaling)
    reference = _output_error(first, scaled, rows, progress)
    data = predictor_data(scaled, rows)
    found = predictor_start(first, data) if reference is None else reference.step
    if (found is None and not start.n_inputs) or (found is not None and leaves_rounding(found, n_rows_of(data))):
        return None, "the model explains the outputs to rounding, or cannot run"
    least = -np.inf if reference is None or feedback else _least_criterion(reference, first, data)
    hopeless = reference is not None and reference.criterion <= least
    fit, ratio, past = None, np.nan, 0
    below = np.inf if reference is None or feedback else reference.criterion
    if not hopeless:
        fit, ratio, past = _likeliest(first, scaled, data, order_given=order_given, below=below, progress=progress)
    if fit is None and not hopeless:
        likelier = "" if below == np.inf else "is likelier and "
        return None, f"no model of the noise that was tried {likelier}leaves white errors"
    gained = np.inf if reference is None else reference.criterion - (least if fit is None else fit.criterion)
    if fit is None or (gained <= 0.0 and not feedback):
        return None, f"what is left is as likely to be white noise (criterion {-gained:.3g} in favour)"
    if start.n_inputs:
        fit, ratio = _apart(fit, ratio, start.order, data, start.dt)
    whole = innovation_form(fit.step, start.dt)
    system = _system_part(whole, start.order, data) if start.n_inputs else whole
    why_not = "" if system.order else "keeps no state of the system"
    if np.abs(np.linalg.eigvals(system.A)).max(initial=0.0) >= 1.0 or _follows_inputs(fit.step, data):
        why_not = "is not stable, or its errors still follow the inputs"
    elif reference is not None and not feedback and _strays(system, reference, scaled, rows):
        why_not = "takes for noise what is of the system: it leaves more in a free run than noise makes it"
    if why_not:
        return None, f"the likeliest predictor {why_not}"
    model = NoiseModel(
        fit=fit,
        whole=whole,
        realisation=in_data_states(system, evidence, scaling),
        scaling=scaling,
        n_noise=whole.order - system.order,
        whiteness_ratio=ratio,
        gained=gained,
        past=0 if start.n_inputs else past,
    )
    reason = f"criterion {gained:.3g} below that of output error" if start.n_inputs else "no input was measured"
    reason = "output error has no model that runs" if start.n_inputs and reference is None else reason
    reason = "the outputs seem to be fed back into the inputs" if feedback else reason
    return model, f"maximum likelihood, {reason}; its errors are white (ratio {ratio:.2f})"


def _about_rest(record: Record, n_states: int) -> tuple[Record, BoolArray]:
    """The record and which of its rows count; where it begins at rest, the outputs are zero there, and none of these.

    Rows of rest were not measured and hold no noise: all they say is that the state is zero, a predictor's too.
    """
    rows = record.complete_rows()
    if not begins_at_rest(record, n_states):
        return record, rows
    rows[: n_at_rest(record)] = False
    return replace(record, outputs=record.outputs - record.outputs[0]), rows


def _why_not_foretold(records: Sequence[Record]) -> str:
    """In words, why no predictor of the outputs can be fitted; nothing where one can."""
    if not all(record.complete_rows().all() for record in records):
        return "outputs are missing, and a predictor needs every one of them"
    return "" if any(map(can_be_foretold, records)) else "no record has as many rows as a predictor has channels"


def _why_not_steady(model: Realisation, records: Sequence[Record]) -> str:
    """In words, that a mode changes during the records; nothing where none does, or nothing drives it that is known.

    What a drift leaves is as likely as noise, and states of the noise make two modes of one that drifts, or move it.
    """
    if not model.n_inputs:
        return ""
    try:
        runs = model_runs(replace(model, K=None), records)
    except NumericalError:
        return ""
    scale = channel_scaling(records).output_scale
    drifting = drifting_modes(extract_modes(model).modes, runs.records, runs.left, output_scale=scale)
    where = ", ".join(hertz(mode.frequency) for mode in drifting)
    return f"what is at {where} Hz changes during the record, and what that leaves is no noise" if drifting else ""


def _least_criterion(reference: LikeliestFit, model: Realisation, data: OutputError) -> float:
    """What the model as a predictor may reach, from its score, where output error leaves white errors; else no bound.

    With twenty outputs a fit of it costs more than all else, and what white errors promise is far below its price.
    """
    step = predictor_start(model, data) if _whiteness(reference.step, reference.data).p_value > WHITE_AT else None
    return -np.inf if step is None else promised_criterion(step, data, Sections())


def _follows_inputs(step: RefinementStep, data: OutputError) -> bool:
    """Whether errors follow the inputs of their sample or of those before it: what makes the noise does not.

    How much a free run explains says less: where forces that nobody measured ring on from block to block, held-out rows
    promise more than the true system explains, and states of the noise that follow a drift keep what they promise.
    """
    errors = centred(errors_of(step, data))
    root = whiteness(errors, n_lags=WHITENESS_LAGS, n_fitted=0).inverse_root
    inputs = [record.inputs[:, : step.layout.n_direct] for record in data.records]
    return root is not None and (
        input_correlation(errors, root, inputs, first_lag=0, last_lag=WHITENESS_LAGS) > NOT_WHITE
    )


def _likeliest(
    model: Realisation,
    scaled: Sequence[Record],
    data: OutputError,
    *,
    order_given: bool,
    below: float,
    progress: Callable[[float], None],
) -> tuple[LikeliestFit | None, float, int]:
    """The first candidate that leaves white errors, its whiteness ratio, and the past that it came from.

    With inputs the model stands in where none does, and where its states are more and it is the likelier one; without
    them a candidate takes more states as long as they make it likelier. One that promises a criterion of no less than
    `below`, or than the best so far, is not fitted.
    """
    best: tuple[LikeliestFit | None, float, int] = None, np.nan, 0
    left = 8 / 9  # after output error; a candidate that fails leaves as much again at most
    variates = CanonicalVariates.of(scaled)
    for candidate, past in _candidates(model, variates, order_given=order_given):
        step = None if candidate is None else predictor_start(candidate, data)
        fit, ratio = _white(step, data, Sections(), below, share_of(progress, 1.0 - left, 1.0 - 0.5 * left))
        left *= 0.5
        if fit is not None:
            best = fit, ratio, past
            break
    if not model.n_inputs:
        if order_given or variates is None or best[0] is None:
            return best
        return *_with_more_states(best[0], best[1], variates, data, share_of(progress, 1.0 - left, 1.0)), best[2]
    if best[0] is not None and model.order <= best[0].step.order:
        return best
    below = below if best[0] is None else best[0].criterion
    fit, ratio = _white(predictor_start(model, data), data, Sections(), below, share_of(progress, 1.0 - left, 1.0))
    return best if fit is None or fit.criterion >= below else (fit, ratio, 0)


def _with_more_states(
    best: LikeliestFit,
    ratio: float,
    variates: CanonicalVariates,
    data: OutputError,
    progress: Callable[[float], None],
) -> tuple[LikeliestFit, float]:
    """The same with one state or a pair more each time, as long as its criterion falls; and its whiteness ratio.

    The errors of many outputs may seem white where one of two close modes is missing, and the other is then far off.
    What a start with more states promises, less half of what that of the best promised and did not keep, tells
    beforehand, at the price of a step each, that nearly none are missing.
    """
    start = _start_of(variates, best.step.order, data)
    promised = np.inf if start is None else promised_criterion(start, data, Sections())
    while True:
        broken = 0.5 * max(0.0, best.criterion - promised)
        starts = [_start_of(variates, best.step.order + more, data) for more in (1, 2)]
        each = [np.inf if one is None else promised_criterion(one, data, Sections()) for one in starts]
        promised, start = min(zip(each, starts, strict=True), key=lambda one: one[0])
        if promised + broken >= best.criterion:
            return best, ratio
        fit, white = _white(start, data, Sections(), np.inf, progress)
        if fit is None or fit.criterion >= best.criterion:
            return best, ratio
        best, ratio = fit, white


def _start_of(variates: CanonicalVariates, order: int, data: OutputError) -> RefinementStep | None:
    candidate = variates.predictor(order)
    return None if candidate is None else predictor_start(candidate, data)


def _white(
    step: RefinementStep | None,
    data: OutputError,
    coordinates: Sections,
    below: float,
    progress: Callable[[float], None],
) -> tuple[LikeliestFit | None, float]:
    """The likeliest predictor from this start and the whiteness ratio of its errors.

    None where they are not white, or where the start promises a criterion of no less than `below`.
    """
    n_values = n_rows_of(data) * data.records[0].n_outputs
    if step is None or step.layout.n_sensitivities * ROWS_A_NUMBER > n_values:
        return None, np.nan
    if below < np.inf and promised_criterion(step, data, coordinates) >= below:
        return None, np.nan
    fit = likeliest(step, data, coordinates, excess=partial(_excess, data=data), progress=progress)
    white = _whiteness(fit.step, data)
    return (fit, white.ratio) if white.p_value > WHITE_AT else (None, np.nan)


def _whiteness(step: RefinementStep, data: OutputError) -> Whiteness:
    return whiteness(centred(errors_of(step, data)), n_lags=WHITENESS_LAGS, n_fitted=0)


def _excess(step: RefinementStep, data: OutputError) -> float:
    """By which the statistic is above that of white errors.

    It is about what -2 ln L would fall by if lagged errors entered the model (a score statistic), and falls by no more.
    """
    freedom = step.layout.n_outputs**2 * WHITENESS_LAGS
    return freedom * _whiteness(step, data).ratio - 2.0 * float(scipy.special.gammainccinv(0.5 * freedom, WHITE_AT))


def _output_error(
    model: Realisation, scaled: Sequence[Record], rows: Sequence[BoolArray], progress: Callable[[float], None]
) -> LikeliestFit | None:
    if not model.n_inputs:
        return None
    data = OutputError(records=tuple(scaled), rows=tuple(rows), blocks=blocks_of(scaled, [[[] for _ in scaled]]))
    start = starting_parameters(model, data)
    if start is None:
        return None
    return likeliest(start, data, PolesAndParticipations(), progress=share_of(progress, 0.0, 1 / 9))


def _strays(system: Realisation, reference: LikeliestFit, scaled: Sequence[Record], rows: Sequence[BoolArray]) -> bool:
    """Whether the system of a predictor leaves more in a free run than noise makes of the one that leaves least.

    Then what it takes for noise is none: not linear, or changing, which a free run follows no less for that. Of inputs
    that act in few rows it cannot be told: what follows lies within the memory of noise that rings as the system does.
    """
    acts = [(record.inputs != np.median(record.inputs, axis=0)).any(axis=1) for record in scaled]
    if not np.concatenate(acts).mean() > ACTS:
        return False
    shares = np.linspace(0.0, 1.0, LONG_BLOCKS + 1)
    blocks = [
        Block(record=i, first=first, last=last, label=-1)
        for i, record in enumerate(scaled)
        for first, last in pairwise((shares * record.n_samples).round().astype(int).tolist())
    ]
    data = OutputError(records=tuple(scaled), rows=tuple(rows), blocks=tuple(blocks))
    try:
        runs = model_runs(replace(system, K=None), scaled)
    except NumericalError:
        return True
    least = np.vstack([error[there] for error, there in zip(errors_of(reference.step, data), rows, strict=True)])
    left = np.vstack([error[there] for error, there in zip(runs.left, rows, strict=True)])
    squares = np.nansum(np.square(least), axis=0)
    weights = len(least) / np.maximum(squares, TINY)
    more = float(weights @ (np.nansum(np.square(left), axis=0) - squares))
    return chance_of_leaving(reference.step, data, weights, more) < NOT_LINEAR


def _candidates(
    model: Realisation, variates: CanonicalVariates | None, *, order_given: bool
) -> Iterator[tuple[Realisation | None, int]]:
    """Of canonical variates, with their past; without them and without inputs, the model.

    Their own criterion gives the order, states of the noise among them; where that leaves errors that are not white the
    order grows, by a pair, then by half or to Akaike's, with inputs within the grid; without them to that of the model.
    What held-out rows choose for a free run is no order of the noise, and where forces that nobody measured drive most,
    none of the system.
    A realisation of what an observer recovers loses much of what its outputs' covariance tells: with 28 modes in 8
    outputs 96 steps from there ended below where the variates start.
    """
    made = False
    if variates is not None:
        own, largest = variates.order, max(variates.order, MODEL_ORDERS[-1])
        more = own + 2, max(own + own // 2, variates.largest_order)
        orders = [own, *(min(n, largest) for n in more)] if model.n_inputs else _growing(own, model.order)
        for order in [model.order] if order_given and not model.n_inputs else dict.fromkeys(orders):
            predictor = variates.predictor(order)
            made = made or predictor is not None
            yield predictor, variates.past
    if not made and not model.n_inputs:
        yield model, 0


def _growing(own: int, most: int) -> list[int]:
    """Orders from the first to the last: a pair more, then each by about half as large again, whole pairs more.

    The smallest that leaves white errors is asked for: a long observer gives a model of many states, and what too many
    states make of the noise may look like modes.

    Example:
        >>> _growing(6, 56), _growing(6, 4)
        ([6, 8, 12, 18, 26, 38, 56], [6])
    """
    orders = [own] if own >= most else [own, min(most, own + 2)]
    while orders[-1] < most:
        orders.append(min(most, orders[-1] + 2 * max(1, round(orders[-1] / 4))))
    return orders


def _apart(fit: LikeliestFit, ratio: float, order: int, data: OutputError, dt: float) -> tuple[LikeliestFit, float]:
    """The same with the noise on the outputs alone, where that is the likelier one for its fewer numbers.

    The gain of a mode that no noise drives fits by chance what noise there is in its band, which makes the mode seem
    better known than it is.
    """
    whole = innovation_form(fit.step, dt)
    gain, m, q = whole.K, whole.n_inputs, whole.n_outputs
    if order >= whole.order or gain is None:
        return fit, ratio
    driven = replace(whole, B=np.hstack([whole.B, gain]), D=np.hstack([whole.D, np.zeros((q, q))]), K=None)
    basis = modal_basis(driven)
    kept = _most_driven(basis, order, [record.inputs[:, :m] for record in data.records])
    rest = sorted(set(range(basis.poles.size)) - set(kept))
    system, noise = _states_of(basis, kept), _states_of(basis, rest)
    n = len(system[0])
    B, K = np.vstack([system[1][:, :m], 0.0 * noise[1][:, :m]]), np.vstack([0.0 * system[1][:, m:], noise[1][:, m:]])
    A, C = scipy.linalg.block_diag(system[0], noise[0]), np.hstack([system[2], noise[2]])
    step = predictor_start(Realisation(A, B, C, whole.D, dt, K=K), data) if n else None
    if step is None:
        return fit, ratio
    inputs = step.parameters.inputs.copy()
    inputs[:, m:][np.abs(inputs[:, m:]).max(axis=1) < ROUNDED] = 0.0
    start = step_at(replace(step.parameters, inputs=inputs), data)
    apart, white = _white(start, data, Sections(n_measured=m), fit.criterion, lambda _share: None)
    return (fit, ratio) if apart is None or apart.criterion >= fit.criterion else (apart, white)


def _most_driven(basis: ModalBasis, order: int, inputs: Sequence[FloatArray]) -> list[int]:
    """The poles of the `order` states that tell most of the answer to these first inputs; one less for a cut pair.

    Those that grow are kept, were they more.

    One after the other is left out whose loss the others, with any shapes, make up for best. Where no input moves,
    participations are not determined: poles there have large answers that cancel, and by size alone modes of the system
    would count as noise.
    """
    n_inputs, grows = inputs[0].shape[1], np.abs(basis.poles) >= 1.0
    n_states = np.where(basis.is_pair, 2, 1)
    owner = np.concatenate([np.repeat(np.arange(grows.size), n_states), np.full(n_inputs, -1)])
    told = np.column_stack([np.ones_like(basis.is_pair), basis.is_pair]).ravel()  # real parts, imaginary ones of pairs
    parts = np.zeros((owner.size, owner.size))
    poles = np.where(grows, 0.0, basis.poles)  # told by its pole, and kept
    for values in inputs:
        recursion = PoleRecursion.of(poles, len(values))
        drive = basis.inputs[:, :n_inputs] @ values.T
        states, _ = recursion.run(drive.astype(np.complex128), np.zeros(poles.size, dtype=np.complex128))
        both = np.stack([states.real, states.imag], axis=1).reshape(-1, len(values))
        signals = np.vstack([both[told], values.T])
        parts += signals @ signals.T
    size = np.sqrt(np.where(np.diag(parts) > 0.0, np.diag(parts), 1.0))
    parts = parts / np.outer(size, size) + ROUND_OFF * np.eye(owner.size)
    shapes = np.where(basis.is_pair, 2.0, 1.0) * basis.outputs
    wanted = np.vstack(
        [
            np.stack([shapes.real, -shapes.imag], axis=2).reshape(len(shapes), -1).T[told] * size[:-n_inputs, None],
            np.zeros((n_inputs, len(shapes))),
        ]
    )
    cross = parts @ wanted
    kept = list(range(grows.size))
    while sum(n_states[kept]) > order and not grows[kept].all():
        there = np.flatnonzero(np.isin(owner, [*kept, -1]))
        inverse = np.linalg.inv(parts[np.ix_(there, there)])
        fitted = inverse @ cross[there]
        losses = {}
        for pole in (one for one in kept if not grows[one]):
            own = np.flatnonzero(owner[there] == pole)
            losses[pole] = float((fitted[own] * np.linalg.solve(inverse[np.ix_(own, own)], fitted[own])).sum())
        kept.remove(min(losses, key=lambda pole: losses[pole]))
    return kept


def _states_of(basis: ModalBasis, chosen: Sequence[int]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A, B and C of these poles, one state for a real pole and two, real and imaginary part, for a pair."""
    order = int(np.where(basis.is_pair[list(chosen)], 2, 1).sum())
    A, B, C = np.zeros((order, order)), np.zeros((order, basis.inputs.shape[1])), np.zeros((len(basis.outputs), order))
    row = 0
    for i in chosen:
        pole, b, c = basis.poles[i], basis.inputs[i], basis.outputs[:, i]
        if basis.is_pair[i]:
            own = slice(row, row + 2)
            A[own, own] = [[pole.real, -pole.imag], [pole.imag, pole.real]]
            B[own] = [b.real, b.imag]
            C[:, own] = 2 * np.column_stack([c.real, -c.imag])
            row += 2
        else:
            A[row, row], B[row], C[:, row] = pole.real, b.real, c.real
            row += 1
    return A, B, C


def _system_part(whole: Realisation, order: int, data: OutputError) -> Realisation:
    """The `order` states that the inputs move most, one less where that would cut a pair; else all, and K."""
    if order >= whole.order:
        return whole
    basis = modal_basis(replace(whole, K=None))
    kept = _most_driven(basis, order, [record.inputs[:, : whole.n_inputs] for record in data.records])
    return Realisation(*_states_of(basis, kept), whole.D, whole.dt)


# --- feedback ---------------------------------------------------------------------------------------------------------


def with_feedback(result: Identification, moved: FloatArray | None, free: Sequence[Record] = ()) -> Identification:
    """The result with what feedback does to it: a mode that it may move far is not certain, harmless feedback a remark.

    Nor is a mode that only the noise moves: of all modes where a model of the noise should allow for feedback, else
    where that holds of each that was found.

    Args:
        result: of records with feedback.
        moved: (n_modes,) how many of its deviations feedback moves each mode by; None for a model with its noise.
        free: the records with what moves the inputs from outside a loop (`modal.estimation.feedback.from_outside`);
            none where that was not asked.
    """
    told = np.array([mode.kind == "oscillatory" and mode.verdict != "noise" for mode in result.modes], dtype=np.bool_)
    alone = told & (chance_at_modes(result.modes, free) > FOLLOWS) if free else np.zeros_like(told)
    if not alone.any() or (moved is not None and (told & ~alone).any()):
        return _allowed_for(result, told=bool(told.any())) if moved is None else _as_moved(result, moved)
    result = _in_a_loop(result, alone)
    return _allowed_for(result, rest=True) if (told & ~alone).any() else result


def _in_a_loop(result: Identification, alone: BoolArray) -> Identification:
    """These modes doubtful, which nothing from outside a loop moves, and a sentence about them."""
    where = listed([hertz(mode.frequency) for mode, own in zip(result.modes, alone, strict=True) if own])
    said = (
        f"{FOUND.capitalize()}: {WHY_TOLD}. At {where} Hz the outputs follow nothing that moves the inputs from "
        "outside such a loop: what is found there may belong to the closed loop or to what feeds back, and no model of "
        "the noise can tell. Move the inputs by a signal of their own that shows in the outputs, or identify the "
        "closed loop from the outputs alone."
    )
    modes = tuple(_alone(mode) if own else mode for mode, own in zip(result.modes, alone, strict=True))
    return replace(result, modes=replace(result.modes, modes=modes), warnings=(*result.warnings, said))


def _alone(mode: Mode) -> Mode:
    if mode.verdict == "system":
        return doubted(mode, ALONE)
    return replace(mode, probability=min(mode.probability, DOUBTED), reason=f"{ALONE}; {mode.reason}")


def _allowed_for(result: Identification, *, told: bool = True, rest: bool = False) -> Identification:
    """A sentence that the model of the noise allows for feedback, where any mode was told, or the rest of the modes."""
    allows = "which allows for that as long as what feeds back takes a sample or more"
    said = f"{FOUND.capitalize()}: {WHY_TOLD}; the model has its noise{f', {allows}' if told else ''}."
    if rest:
        said = f"The other modes follow what moves the inputs from outside, and the model has its noise, {allows}."
    return replace(result, warnings=(*result.warnings, said))


def _as_moved(result: Identification, moved: FloatArray) -> Identification:
    """A model without its noise: what feedback moves far is doubtful, and where it moves nothing that is a remark."""
    wider = np.hypot(1.0, moved)
    own = [(mode, by) for mode, by in zip(result.modes, wider.tolist(), strict=True) if mode.verdict == "system"]
    far = ", ".join(hertz(mode.frequency) for mode, by in own if by > NO_INTERVAL)
    most = max((by for mode, by in own if by <= NO_INTERVAL and not np.isnan(mode.frequency_std)), default=1.0)
    if not far and most <= NOT_UNDERSTOOD:
        why = f"{FOUND}, but that makes no interval of a mode of the system more than {most:.2g} times wider"
        return replace(result, choices=(*result.choices, Choice(what="feedback", value="harmless", reason=why)))
    said = f"{FOUND.capitalize()}: {WHY_TOLD}, and no model of the noise leaves white errors."
    if most > NOT_UNDERSTOOD:
        said += f" The intervals have the bias by that in them, which makes them up to {most:.1f} times wider."
    said += f" It may move what is found at {far} Hz by several deviations, so that is doubtful." if far else ""
    modes = tuple(
        doubted(mode, MOVED) if by > NO_INTERVAL else mode
        for mode, by in zip(result.modes, wider.tolist(), strict=True)
    )
    return replace(result, modes=replace(result.modes, modes=modes), warnings=(*result.warnings, said))
