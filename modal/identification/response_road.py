"""From a table of frequency responses to modes: the road of `modal.identify` where no record is left to ask.

Window (stated, else the most likely one) -> pulse response -> realisations of all orders as starts -> each fitted to
the table through the window -> order by evidence -> noise from coherence or scatter -> modes and deviations -> the same
again from halves of the averages, other lags and other orders -> verdict.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from era.balanced import HankelDecomposition, decompose, order_choice, realise_from
from modal.estimation.cross_validation import hankel_limits
from modal.estimation.responses.fit import (
    ResponseFit,
    ResponseLines,
    Start,
    lines_of,
    on_grid,
    realised,
    refined,
    start_of,
)
from modal.estimation.responses.force_dips import with_dips
from modal.estimation.responses.noise import (
    Noise,
    beneath_distortion,
    beyond_blocks,
    drawn_noise,
    lines_joined,
    noise_of,
    pole_deviations,
    residue_deviations,
    runs_on,
    with_powers,
)
from modal.estimation.responses.order import (
    LARGEST_ORDER,
    PASSES,
    QUICK,
    complete_order,
    evidence_of,
    first_weight,
    grown,
    likelihood_of,
    lines_fit,
    most_states,
    schwarz,
    settled_noise,
    weight_of,
    with_fewer,
    with_own_noise,
)
from modal.identification.order_search import COARSE_MODEL_ORDERS
from modal.identification.result import Identification, OrderEvidence
from modal.modes.extraction import extract_modes
from modal.modes.modal_mass import DERIVATIVES, FORCES
from modal.modes.mode import Choice, Fit, ModalModel
from modal.preparation.faults import forward_response, living_response
from modal.verdict.judgement import Rerun, Reruns, blurred, doubted, judge, scattered, told_by_dips
from modal.verdict.stabilisation import stabilisation
from modal.wording.text import LEAST_FIT, counted, hertz
from okid.arrays import TINY, BoolArray, ComplexArray, FloatArray, listener, one_blas_thread, whole_number
from okid.errors import InsufficientDataError
from okid.frequency_response import FrequencyResponse, ResponseWindow, pulse_response, with_missing_lines
from okid.markov import MarkovParameters

LONGEST = 2048
"""Realise at most so many lags: they only give the start, and more cost without moving it."""
BETWEEN = 4
"""Describe a table by so many steps a half period of its last line, unless one, as of a sampled system, is likelier: an
analyser sees the motion between samples, from which four differ by less than 1 % at the last line."""
LEAST_TRIED = 24
"""Try orders up to this one in any case: a table cut below half the sampling frequency takes some ten states for its
edge before the first mode is described (shaker-driven tables, seeds 100 to 102 of the benchmark)."""
OTHER_LAGS = 0.7
"""Realise again from this share of the lags: the share by which an observer is shortened for a rerun."""
TRIED: tuple[ResponseWindow, ...] = ("hann", "flattop", "uniform", "periodic")
"""Windows that are tried where none is stated. Hamming's is within 2 % of Hann's in what it leaves of a pulse."""
MORE_THAN_STATED = 2.0
"""Warn where the variance of the scatter exceeds what coherence and averages state by more: overlapping blocks give 1.1
to 1.5, and the number of averages alone can be off by no more than their share."""
WORDS = {
    "halves of the data": "halves of the averages",
    "another observer order and ridge give": "other lags give",
    "other observer order and ridge": "other lags",
    "the observer order and ridge": "the lags that the start is made of",
    "filters of sensors and amplifiers answer so": "filters and modes beyond the lines answer so",
}
"""Say what was changed for a rerun of responses."""
FORCE_DIPS = (
    "The force dips at the resonances, as that of a shaker does which the structure loads, and the lines are too far "
    "apart to show how: the modes are those that go with such a force, and deviations hold how far the ways to explain "
    "the table put them apart. Average over longer blocks."
)
SEED = 20
"""Draw the halves of the averages from one seed, so that equal tables give equal results."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Found:
    """The chosen model of a table with what it was chosen on."""

    response: FrequencyResponse
    table: ResponseLines
    grid: FloatArray
    markov: MarkovParameters
    decomposition: HankelDecomposition
    fit: ResponseFit
    noise: Noise
    under_white: ResponseFit
    moved: FloatArray
    order: int
    first: int
    fewer: tuple[Start, ...]
    evidence: dict[int, float]
    fits: dict[int, float]
    likelihood: float
    finer: int

    @property
    def weighed(self) -> float:
        """Logarithm of the likelihood less ln N / 2 a parameter: windows need not have as many poles (Schwarz)."""
        return self.likelihood - 0.5 * self.fit.n_parameters * float(np.log(2 * self.table.known.sum()))


def identify_response(
    response: FrequencyResponse,
    *,
    order: int | Literal["auto"] = "auto",
    progress: Callable[[str, float], None] | None = None,
) -> Identification:
    """Identify the modes of a system from its frequency responses; as `modal.identify`, which calls it.

    Args:
        response: a table of one test; its window, coherence and number of averages are used where it has them.
        order: number of states of the model.
        progress: called as `progress(what, share_done)` while it works.

    Raises:
        InvalidDataError: an order that is none.
        InsufficientDataError: too few lines for any model.
    """
    if order != "auto":
        order = whole_number(order, name="order", least=1, otherwise='or "auto"')
    tell = listener(progress)
    living, dead = living_response(response)
    given, backwards = forward_response(living)
    response = with_missing_lines(given)
    with one_blas_thread():
        tell("fitting the responses", 0.0)
        windows = (response.window,) if response.window != "unknown" else TRIED if on_grid(response) else ("periodic",)
        ways = [_search(response, windows[0], order, BETWEEN)]
        if _likelihood_between(ways[0]) > ways[0].likelihood:
            ways.append(_search(response, windows[0], order, 1))
        # with dips of the force if there are any: they pass for another window, and for motion between samples
        first = max(((_under_dips(one), one) for one in ways), key=lambda pair: pair[0].weighed)
        others = (_search(response, window, order, first[1].finer) for window in windows[1:])  # each with its own poles
        each = [first, *((_under_dips(one), one) for one in others)]
        tried = {dipped.table.window: dipped.weighed for dipped, _ in each}
        found = _once_more(*max(each, key=lambda pair: pair[0].weighed))
        tell("identifying again with halves of the averages, other lags and orders", 0.6)
        result = _judged(found, order, tried)
        result = replace(result, response=given, warnings=(*dead, *backwards, *result.warnings))
        tell("done", 1.0)
    return result


def _search(
    response: FrequencyResponse, window: ResponseWindow, order: int | Literal["auto"], finer: int = 1
) -> _Found:
    """Model of the order that the evidence favours, refined, with the noise of the table about it."""
    table, grid = lines_of(response, window, finer)
    markov, found = _realisations(table, response.frequencies, grid, response)
    largest = min(found.rank, found.max_order)
    if largest < 1:
        raise InsufficientDataError("the responses hold no motion that a model could describe: they do not change.")
    first = min(max(LEAST_TRIED, order_choice(found).order) if order == "auto" else order, largest)
    fit = _fitted(table, found, first, first_weight(table))
    if not fit.poles.size:
        raise InsufficientDataError(f"{table.z.size} lines hold no pole that rings; give more lines or a wider band.")
    table = with_powers(table, fit)
    best = with_own_noise(table, fit)
    if order == "auto":
        lower = [_fitted(table, found, n, first_weight(table)) for n in COARSE_MODEL_ORDERS if n < first]
        best = min([best, *(with_own_noise(table, one) for one in lower)], key=lambda one: one.criterion)
    weight = weight_of(table, best.noise)
    fit = refined(table, fit, weight, n_steps=QUICK)
    while order == "auto" and first < largest:  # more poles, as long as they tell more
        more = min(largest, first + first // 2)
        trial = _fitted(table, found, more, weight)
        if evidence_of(table, trial) >= evidence_of(table, fit):
            break
        first, fit = more, trial
    if order == "auto":
        chosen = complete_order(table, fit, best)
        fit, evidence, fits, fewer = chosen.best.fit, chosen.evidence, chosen.fits, chosen.fewer
    else:
        evidence, fits, fewer = {fit.order: 0.0}, {}, ()
    table = with_powers(table, fit)
    fit, noise, likelihood = settled_noise(table, fit, noise_of(table, fit))
    fits = fits or {fit.order: float(np.mean(lines_fit(fit.left, table, weight_of(table, noise))))}
    return _Found(
        response=response,
        table=table,
        grid=grid,
        markov=markov,
        decomposition=found,
        fit=fit,
        noise=noise,
        under_white=fit,
        moved=np.zeros((2, fit.poles.size)),
        order=fit.order,
        first=first,
        fewer=fewer,
        evidence=evidence,
        fits=fits,
        likelihood=likelihood,
        finer=finer,
    )


def _once_more(best: _Found, white: _Found) -> _Found:
    """The model under dips, looked for again from the one without them, under the noise that the dips leave."""
    for _ in range(PASSES if best is not white else 0):
        fit = refined(white.table, white.fit, weight_of(white.table, best.noise))
        again = _under_dips(replace(white, fit=fit, noise=best.noise))
        if again.order != best.order or not again.weighed > best.weighed:  # the order is chosen, here its optimum
            break
        best = again
    return best


def _under_dips(found: _Found) -> _Found:
    """The same, or the model that goes with a force that dips where such a one makes the table likelier."""
    table, weight = found.table, weight_of(found.table, found.noise)
    models = [found.fit, *(refined(table, start, weight, n_steps=QUICK) for start in found.fewer)]
    best = with_dips(
        table,
        models,
        lambda fit: weight_of(table, noise_of(table, fit)),
        lambda error, n_parameters: schwarz(table, error, n_parameters),
    )
    if best is None:
        return found
    number, fit, moved = best
    noise = noise_of(table, fit)
    return replace(
        found,
        fit=fit,
        noise=noise,
        under_white=models[number],
        moved=moved,
        order=fit.order,
        likelihood=likelihood_of(table, fit, noise),
    )


def _likelihood_between(found: _Found) -> float:
    """Of the table without steps between its lines' own, from the poles that were found."""
    table, _ = lines_of(found.response, found.table.window, 1)
    fit = found.fit
    poles = np.log(fit.poles) * (table.dt / found.table.dt)
    there = np.abs(poles.imag) < np.pi
    if not there.any():
        return -np.inf
    start = (np.exp(poles[there]), fit.is_pair[there], fit.inputs[there])
    fit = refined(table, start, weight_of(table, found.noise))
    return settled_noise(table, fit, noise_of(table, fit))[2]


def _realisations(
    table: ResponseLines, f: FloatArray, grid: FloatArray, response: FrequencyResponse, *, share: float = 1.0
) -> tuple[MarkovParameters, HankelDecomposition]:
    """The pulse response of a table in its own channels, and its realisations of all orders."""
    on_grid = FrequencyResponse(
        _resampled(table.values * table.trust, table.known, f, grid),
        grid,
        window=table.window,
        window_time_constant=response.window_time_constant,
    )
    dt, most = 0.5 / float(f[-1]), most_states(table)
    if most < 1:
        n_known, n_given = int(table.known.sum()), int(np.isfinite(response.response).sum())
        if n_known < n_given / 2:
            raise InsufficientDataError(
                f"coherence is no greater than chance gives at {n_given - n_known} of {n_given} values: they do not "
                "follow the inputs; give a table of inputs that move the outputs, or leave out a wrong coherence."
            )
        raise InsufficientDataError(f"the table holds {n_known} values, too few for any model; give more lines.")
    markov = pulse_response(on_grid, dt=None if grid[0] == 0 else dt)
    n_lags = min(LONGEST, round(share * markov.n_lags))
    markov = MarkovParameters(system=markov.system[: n_lags + 1], dt=dt)
    return markov, decompose(markov, max_order=min(LARGEST_ORDER, most, *hankel_limits(markov)))


def _resampled(values: ComplexArray, known: BoolArray, f: FloatArray, grid: FloatArray) -> ComplexArray:
    """Every response on a grid, straight lines between the lines that were measured."""
    result = np.empty((grid.size, *values.shape[1:]), dtype=np.complex128)
    for q, i in np.ndindex(values.shape[1:]):
        there = known[:, q, i]
        result[:, q, i] = np.interp(grid, f[there], values[there, q, i]) if there.any() else 0.0
    return result


def _fitted(table: ResponseLines, found: HankelDecomposition, order: int, weight: FloatArray) -> ResponseFit:
    """The model of an order, from its realisation, after a few steps."""
    order = min(order, found.rank, found.max_order)
    return refined(table, start_of(realise_from(found, order), table.dt), weight, n_steps=QUICK)


def _path_down(
    table: ResponseLines, found: HankelDecomposition, first: int, orders: list[int], weight: FloatArray
) -> list[ResponseFit]:
    """Models of falling orders, or the next lower ones, each left from one of order `first`, as the model was."""
    fit, models = grown(table, _fitted(table, found, first, weight), weight), []
    fewer = with_fewer(table, fit, weight)
    for order in orders:
        while fit.order > order and fit.poles.size > 1:
            fit = next(fewer)
        models.append(fit)
    return models


# --- what the result rests on ----------------------------------------------------------------------------------------


def _judged(found: _Found, order: int | Literal["auto"], tried: dict[ResponseWindow, float]) -> Identification:
    table, fit, noise, white = found.table, found.fit, found.noise, found.under_white
    model = realised(fit, table)
    of_poles = np.hypot(pole_deviations(table, fit, noise), found.moved)
    of_pairs = residue_deviations(table, fit, noise, np.flatnonzero(fit.is_pair).tolist()) if fit is white else []
    unjudged = _with_deviations(extract_modes(realised(white, table)), white, table, of_poles, of_pairs)
    reruns, folds, held_out = _again(found)
    ratios = np.ones(fit.poles.size)
    onward = beneath = np.zeros(fit.poles.size, dtype=np.bool_)
    if fit is white:  # else it is told how the force falls
        of_damping = of_poles[1] / np.maximum(-np.log(np.abs(fit.poles)) / np.abs(np.log(fit.poles)), TINY)
        ratios = beyond_blocks(table, fit, noise, of_damping, found.response.n_averages)
        onward, beneath = runs_on(table, fit, noise), beneath_distortion(table, fit, noise)
    weight = weight_of(table, noise)
    whole = lines_fit(fit.left, table, weight)
    measured = Fit(cross_validated=held_out, folds=folds, whole=whole, one_step=np.full(whole.size, np.nan))
    modes = judge(
        unjudged,
        reruns,
        gain=_gains(unjudged, white.left, weight, table),
        n_values=int(2 * table.known.sum() / lines_joined(table)),
        fit=measured.mean,
        is_table=True,
    )
    modes = _within(found.response, modes if fit is white else told_by_dips(_moved(modes, found)))
    of_mode = [int(np.abs(fit.poles - np.exp(mode.pole * table.dt)).argmin()) for mode in modes.modes]
    f, several = found.response.frequencies, found.response.n_inputs > 1
    modes, beyond = scattered(modes, ratios[of_mode], onward[of_mode], beneath[of_mode], f, several_forces=several)
    modes = _named(_in_these_words(modes), found.response)
    tried_orders = sorted(found.fits)
    highest = realise_from(found.decomposition, min(found.decomposition.rank, found.decomposition.max_order))
    scale = table.output_scale[:, np.newaxis] / table.input_scale
    return Identification(
        records=(),
        response=found.response,
        record_kind="response",
        excitation=None,
        observer=None,
        residuals=None,
        markov=MarkovParameters(system=found.markov.system * scale, dt=table.dt),
        realisation=model,
        fitted_model=model,
        modes=modes,
        order_evidence=OrderEvidence(
            singular_values=found.decomposition.singular_values,
            order=found.order,
            gap_order=order_choice(found.decomposition).order,
            candidate_orders=np.array(tried_orders, dtype=np.float64),
            candidate_fits=np.array([found.fits[n] for n in tried_orders]),
            stabilisation=stabilisation(highest),
        ),
        choices=_choices(found, order, tried),
        fit=measured,
        simulated=(),
        predicted=(),
        warnings=(*_warnings(found, modes, measured, tried), *beyond, *([FORCE_DIPS] if fit is not white else [])),
    )


def _with_deviations(
    model: ModalModel,
    fit: ResponseFit,
    table: ResponseLines,
    of_poles: FloatArray,
    of_pairs: Sequence[tuple[FloatArray, FloatArray]],
) -> ModalModel:
    """Deviations of the pole of the fit that each mode is; of shape and mass, where they are known of pairs."""
    poles, pairs = np.log(fit.poles) / table.dt, np.flatnonzero(fit.is_pair).tolist()
    modes = []
    for mode in model.modes:
        nearest = int(np.abs(poles - mode.pole).argmin())
        shape, mass = of_pairs[pairs.index(nearest)] if of_pairs and nearest in pairs else (None, None)
        f_std, d_std = map(float, of_poles[:, nearest] * [1.0, mode.kind == "oscillatory"])
        modes.append(replace(mode, frequency_std=f_std, damping_ratio_std=d_std, shape_std=shape, mass_std=mass))
    why = "the model is fitted to the responses themselves, and cut from no Hankel matrix"
    return replace(model, modes=tuple(modes), indicators_missing=why)


def _moved(modes: ModalModel, found: _Found) -> ModalModel:
    """What was judged, each mode where it is under a force with dips."""
    if found.fit is found.under_white:
        return modes
    own = extract_modes(realised(found.fit, found.table))
    (before, after), moved = (np.log(fit.poles) / found.table.dt for fit in (found.under_white, found.fit)), []
    for mode in modes.modes:
        pole = after[int(np.abs(before - mode.pole).argmin())]
        there = min(own.modes, key=lambda each: abs(each.pole - pole))
        names = ("pole", "kind", "frequency", "damping_ratio", "shape", "participation", "phase_collinearity", "mpd")
        moved.append(replace(mode, **{name: getattr(there, name) for name in names}))
    return replace(modes, modes=tuple(moved))


def _within(response: FrequencyResponse, modes: ModalModel) -> ModalModel:
    """Poles whose resonance lies outside the lines called noise: they stand for all that lies there.

    One whose half-power band reaches into the lines and whose peak does not is doubtful: half of it was not seen.
    Resonances that a window widened which could not be taken into account are doubtful: their damping is the window's,
    and what is left of its main lobe is described by a second pole.
    """
    first, last = response.frequencies[[0, -1]]
    ends = f"{hertz(first)} to {hertz(last)} Hz"
    judged = []
    for mode in modes.modes:
        half = mode.damping_ratio * mode.frequency  # of its half-power band
        inside = first - half <= mode.frequency <= last + half or mode.kind != "oscillatory"
        reason = f"outside the lines of the table ({ends}): it stands for what lies beyond them"
        outside = replace(mode, verdict="noise", probability=0.0, damping_resolved=False, reason=reason)
        peak = mode.frequency * np.sqrt(max(1.0 - 2.0 * mode.damping_ratio**2, 0.0))
        if inside and mode.kind == "oscillatory" and not first <= peak <= last:
            judged.append(doubted(mode, f"its peak lies outside the lines of the table ({ends})"))
        else:
            judged.append(mode if inside else outside)
    modes = replace(modes, modes=tuple(judged))
    if on_grid(response) or response.window in {"unknown", "periodic", "exponential"}:
        return modes
    return blurred(modes, response.frequencies, f"that of a {response.window} window at such lines")


def _in_these_words(modes: ModalModel) -> ModalModel:
    """The reasons of the verdict as they read where there are no records and no observer."""
    said = []
    for mode in modes:
        reason = mode.reason
        for words, instead in WORDS.items():
            reason = reason.replace(words, instead)
        reappears = tuple((WORDS.get(what, what), overlap) for what, overlap in mode.reappears)
        said.append(replace(mode, reason=reason, reappears=reappears))
    return replace(modes, modes=tuple(said))


def _named(modes: ModalModel, response: FrequencyResponse) -> ModalModel:
    """With the channels of the table; at its pole a mode answers as in the table, as to a band-limited input."""
    return replace(
        modes,
        output_names=response.output_names,
        output_units=response.output_units,
        input_names=response.input_names,
        input_units=response.input_units,
        input_hold="band_limited",
    )


def _seen(modes: ModalModel, table: ResponseLines) -> ComplexArray:
    """(n_modes, n_lines, n_outputs, n_inputs) response of each mode through the window, in the table's channels."""
    poles = np.exp(np.array([mode.pole for mode in modes]) * table.dt)
    plus, minus = table.basis(poles)[0]
    parts = []
    for i, mode in enumerate(modes):
        residue = np.outer(mode.shape, mode.participation) * table.input_scale / table.output_scale[:, np.newaxis]
        part = plus[:, i, np.newaxis, np.newaxis] * residue
        parts.append(part + minus[:, i, np.newaxis, np.newaxis] * residue.conj() if mode.pole.imag else part)
    return np.array(parts)


def _gains(modes: ModalModel, left: ComplexArray, weight: FloatArray, table: ResponseLines) -> FloatArray:
    """(n_modes,) share of the weighted squared error without a mode that the mode removes."""
    if not modes.modes:
        return np.zeros(0)
    with_it = float((np.abs(weight * left) ** 2).sum())
    without = [(np.abs(weight * (left + part)) ** 2).sum() for part in _seen(modes, table)]
    return np.array([1 - with_it / max(float(each), TINY) for each in without])


def _again(found: _Found) -> tuple[Reruns, FloatArray, FloatArray]:
    """The same identified from halves of the averages, other lags and other orders; fits of each half to the other."""
    table, noise = found.table, found.noise
    error = drawn_noise(table, found.under_white, noise, np.random.default_rng(SEED))
    weight = weight_of(table, noise) / np.sqrt(2)
    halves = [replace(table, values=table.values + sign * error) for sign in (1.0, -1.0)]
    runs: list[Rerun] = []
    errors = []
    for number, half in enumerate(halves):
        _, start = _realisations(half, found.response.frequencies, found.grid, found.response)
        (own,) = _path_down(half, start, found.first, [found.order], weight)
        from_model = refined(half, found.under_white, weight, n_steps=QUICK)
        again = min((own, from_model), key=lambda fit: fit.error)
        modes = extract_modes(realised(again, table))
        unseen = np.where(table.known, halves[1 - number].values - (half.values - again.left), 0.0)
        errors.append(unseen)
        gain = _gains(modes, unseen, weight, table)
        runs.append(Rerun(label=("first half", "second half")[number], change="data", modes=modes, gain=gain))
    shorter, other = _realisations(table, found.response.frequencies, found.grid, found.response, share=OTHER_LAGS)
    whole = weight_of(table, noise)
    (again,) = _path_down(table, other, found.first, [found.order], whole)
    runs.append(Rerun(label=f"{shorter.n_lags} lags", change="observer", modes=extract_modes(realised(again, table))))
    largest = min(found.decomposition.rank, found.decomposition.max_order)
    others = [n for n in (found.order + 4, found.order + 2, found.order - 2) if 0 < n <= largest > found.order]
    for fit in _path_down(table, found.decomposition, max(found.first, found.order) + 4, others, whole):
        change: Literal["lower order", "higher order"] = "lower order" if fit.order < found.order else "higher order"
        runs.append(Rerun(label=f"order {fit.order}", change=change, modes=extract_modes(realised(fit, table))))
    folds = np.array([np.mean(lines_fit(each, table, whole)) for each in errors])
    both = np.sqrt((np.abs(errors[0]) ** 2 + np.abs(errors[1]) ** 2) / 2)
    n_steps = found.finer * (found.decomposition.n_block_rows + found.decomposition.n_block_columns)
    scales = {"output_scale": table.output_scale, "input_scale": table.input_scale}
    return Reruns(runs=tuple(runs), n_steps=n_steps, **scales), folds, lines_fit(both, table, whole)


def _choices(found: _Found, order: int | Literal["auto"], tried: dict[ResponseWindow, float]) -> tuple[Choice, ...]:
    table, response = found.table, found.response
    if len(tried) == 1 and table.window == response.window:
        why = "as the responses state it"
    elif not on_grid(response) and response.window == "unknown":
        why = "the lines lie on no uniform grid, as those of a stepped sine, which has no window"
    elif not on_grid(response):
        why = f"the lines lie on no uniform grid, so the window that was stated ({response.window}) has no lags"
    else:
        most = max(tried.values())
        others = ", ".join(f"{name} {most - value:.3g}" for name, value in tried.items() if value < most)
        why = f"the most likely of those tried; below it in ln L less ln N / 2 a parameter: {others or 'none'}"
    kind = Choice(what="record kind", value="response", reason="a table of frequency responses was given")
    choices = [kind, Choice(what="window", value=table.window, reason=why)]
    if order != "auto":
        reason = "given as an argument"
    else:
        best = found.evidence.get(found.order, 0.0)
        near = sorted(found.evidence, key=lambda n: abs(n - found.order))[1:5]
        shown = ", ".join(f"{n}: {found.evidence[n] - best:+.3g}" for n in sorted(near))
        reason = f"least Schwarz criterion of {len(found.fits)} orders; others differ by {shown or 'nothing'}"
    choices.append(Choice(what="model order", value=str(found.order), reason=reason))
    value, reason = "scatter", "the responses come without coherence: from their scatter about the model alone"
    if table.noise is not None:
        value = "coherence and scatter"
        reason = "its course over the lines from the coherence, its level from the scatter about the model"
    if table.leaks and table.lags is not None:
        stated = "as is usual with this window" if response.overlap is None else "as stated"
        reason += f"; of blocks that share {100 * table.overlap:.3g} % of their samples, {stated}"
    return (*choices, Choice(what="noise", value=value, reason=reason))


def _warnings(found: _Found, modes: ModalModel, fit: Fit, tried: dict[ResponseWindow, float]) -> tuple[str, ...]:
    table, response = found.table, found.response
    words = []
    if fit.mean < LEAST_FIT:
        words.append(
            f"The model does not explain the responses: it repeats {max(0, int(100 * fit.mean))} % of those of the "
            "other half of the averages."
        )
    if set(response.output_units) & FORCES and set(response.input_units) & set(DERIVATIVES):
        words.append(
            "The table holds force over motion: its modes are those of the structure held where that motion is imposed "
            "(antiresonances of the free one). For the free structure invert it and give motion over force."
        )
    if not modes.system:
        words.append("No mode was found again often enough to be called a mode of the system.")
    if len(tried) > 1:
        words.append(
            f"The window of the blocks is not stated; {table.window} was the most likely of {counted(len(tried))} "
            "tried, and damping depends on it: state it if you know it (window= of okid.read_response)."
        )
    if table.window != response.window and len(tried) == 1:
        words.append(
            "The lines lie on no uniform grid, so the window of the blocks could not be taken into account: damping "
            "ratios may be too high. Export the lines as they were averaged."
            if response.window != "unknown"
            else "The lines lie on no uniform grid and no window is stated: they are taken for a stepped sine's. Where "
            "they were interpolated between averaged ones, damping is too high: export those."
        )
    if response.frequencies[0] > 2 * (response.frequencies[1] - response.frequencies[0]):
        words.append(
            f"The table begins at {response.frequencies[0]:.4g} Hz: what modes below it add is not told apart from the "
            "feedthrough."
        )
    scatter = float(found.noise.share.max()) * (response.n_averages or 0)
    alone = response.n_inputs == 1 or not table.together
    if table.noise is not None and response.n_averages and alone and scatter > MORE_THAN_STATED:
        words.append(
            f"The responses scatter about the model {np.sqrt(scatter):.2g} times as far as coherence and the number of "
            "averages say: the structure is not linear or changed during the test, or the number is not right."
        )
    return tuple(words)
