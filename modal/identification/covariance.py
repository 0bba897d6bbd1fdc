"""How far a refined model can be trusted: standard deviations from the curvature of its output error.

All parameters move together, so every uncertainty is carried by `Loadings`: columns of changes of poles,
participations, shapes and feedthrough, each for one independent disturbance of unit variance. The variance of anything
that follows from the model is the sum of the squares of its changes. Two ways give the loadings:

white noise:  from (J'WJ)^-1 (J'W S W J) (J'WJ)^-1, S the variance of each output's noise; the Cramer-Rao bound where
              W = S^-1
any colour:   from the score J'W e of each of the blocks of rows, which are nearly independent of each other when they
              are long against the memory of noise and modes (batch means; known to sqrt(1 / (2 n_blocks)), about 11 %)
of inputs:    from scores J'W e of noise e that is drawn: what the model answers to white noise of the inputs, with the
              powers that explain, beside white noise on the outputs, the spectrum of what is left

References:
    Whittle, Arkiv for Matematik 2, 1953, 423-434, doi 10.1007/BF02590998 (likelihood of a spectrum); Fevotte, Bertin,
    Durrieu, Neural Computation 21(3), 2009, 793-830, doi 10.1162/neco.2008.04-08-771 (its multiplicative steps).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from era.state_recursion import PoleRecursion
from modal.estimation.feedback import inputs_made_by
from modal.estimation.free_run import powers_of
from modal.estimation.modal_parameters import errors_of
from modal.estimation.modal_states import CHUNK, signals_of
from modal.estimation.output_error import (
    LinearPart,
    OutputError,
    PolesAndParticipations,
    RefinementStep,
    Span,
    inverse_root,
    scores_of,
    sizes_of,
    slopes_of,
    step_equations,
)
from modal.estimation.signal_sums import signal_grams
from modal.identification.refined_search import RefinedModel
from modal.modes.modal_form import discrete_poles
from modal.modes.mode import Mode, Uncertainty
from modal.verdict.constancy import NO_INTERVAL
from okid.arrays import ComplexArray, FloatArray

NOT_UNDERSTOOD = 1.3
"""Say that the noise is not understood where it moves a deviation by more: thrice the scatter of the blocks."""
N_DRAWS = 100
"""Draw noise of the inputs so many times: a deviation is then known to 7 %."""
N_BLOCK_DRAWS = 10
"""Look at so many of them block by block, as many numbers as blocks each."""
N_RECORD_DRAWS = 200
"""Draw noise of records that differ in it so many times: a deviation is then known to 5 %."""
UNLIKE_AT = 1e-3
"""Let the noise of records differ where chance alone makes it differ as much more rarely."""
IN_A_BAND = 16
"""Ask in bands of so many lines of the spectrum whether noise explains it: about a resonance."""
EXPLAINED = 2.0
"""Take a spectrum for explained where its bands are off by no more than so many times the squares that chance makes:
noise of inputs leaves 1.3 to 1.6 of them, forces that were not measured leave 7 to 90."""
N_STEPS = 100
"""Take so many steps to the powers of the noises, from all alike."""
LONGEST_LOOK = 32_768
"""Look at the spectrum of so many rows of a record at most."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Loadings:
    """Changes for each of n_disturbances independent disturbances of unit variance.

    Attributes:
        log_decay: (n_disturbances, n_poles) of ln(-ln|lambda|).
        angle: (n_disturbances, n_poles) of arg lambda.
        inputs: (n_disturbances, n_poles, n_inputs) of b.
        coefficients: (n_disturbances, n_regressors, n_outputs) of what is linear in the outputs.
        own: (n_own, n_regressors, n_outputs) changes of an output's coefficients for unit noise on it alone.
        noise: (n_outputs,) standard deviation of that noise; zero where `coefficients` hold all.
        degrees_of_freedom: of what the noise was estimated from.
    """

    log_decay: FloatArray
    angle: FloatArray
    inputs: ComplexArray
    coefficients: FloatArray
    own: FloatArray
    noise: FloatArray
    degrees_of_freedom: float


def output_error_uncertainty(model: RefinedModel, modes: Sequence[Mode], *, n_lags: int) -> Uncertainty:
    """Standard deviations of the modes and Markov parameters of a refined model.

    Args:
        model: from `refined_model`.
        modes: of its realisation.
        n_lags: Markov parameters asked for.

    References:
        Ljung, System Identification: Theory for the User, 2nd edition, 1999, section 9.4 (asymptotic covariance);
        White, Econometrica 50(1), 1982, 1-25, doi 10.2307/1912526 (scores of what is left).
    """
    return _deviations(_white(model) if model.leaves_white_noise else _of_blocks(model), model, modes, n_lags)


def feedback_bias(model: RefinedModel, modes: Sequence[Mode], *, n_lags: int) -> Uncertainty:
    """How far feedback moves the modes and Markov parameters of a refined model, by first order: sizes, not deviations.

    At the optimum J'W e is zero, but the part of J that the noise made by way of the inputs, J_e, belongs to what the
    noise alone would leave, so the estimate is off by (J'WJ)^-1 J_e'W e.

    Args:
        model: from `refined_model`.
        modes: of its realisation.
        n_lags: Markov parameters asked for.

    References:
        Forssell, Ljung, Automatica 35(7), 1999, 1215-1241, doi 10.1016/S0005-1098(99)00022-9.
    """
    return _deviations(_of_feedback(model), model, modes, n_lags)


def _deviations(loadings: _Loadings, model: RefinedModel, modes: Sequence[Mode], n_lags: int) -> Uncertainty:
    parameters = model.step.parameters
    poles, _ = discrete_poles(tuple(modes), model.realisation.dt)
    owner = np.abs(poles[:, np.newaxis] - parameters.poles).argmin(axis=1) if poles.size else np.empty(0, dtype=np.intp)
    frequency, damping = _pole_deviations(loadings, parameters.poles, model.realisation.dt)
    shapes = _shape_deviations(loadings, model.step.linear, parameters.is_pair, model.scaling.output_scale)
    scale = model.scaling.output_scale[:, np.newaxis] / model.scaling.input_scale
    return Uncertainty(
        method="output error",
        frequency_std=frequency[owner],
        damping_ratio_std=np.where(np.angle(parameters.poles) != 0.0, damping, 0.0)[owner],
        shape_std=shapes[owner],
        markov_std=_markov_deviations(loadings, model, n_lags) * scale,
        degrees_of_freedom=loadings.degrees_of_freedom,
        mass_std=_mass_deviations(loadings, model)[owner],
    )


def _white(model: RefinedModel, own: FloatArray | None = None) -> _Loadings:
    """Of white noise with (n_records, n_outputs) variances; of what the model leaves unless given."""
    step, weights = model.step, model.weights
    normal = step_equations(step, weights=weights)
    rows = np.array([there.sum(axis=0) for there in model.data.counted])
    fitted = step.layout.n_regressors + normal.gradient.size / step.layout.n_outputs
    freedom = np.maximum(1.0, rows.sum(axis=0) - model.n_rest - fitted)
    if own is None:
        left = np.array([np.nansum(error**2, axis=0) for error in errors_of(step, model.data)])
        own = left / np.maximum(rows, 1) * rows.sum(axis=0) / freedom
    if _unlike(own, rows):
        return _of_records(model, own, float(freedom.mean()))
    variance = (rows * own).sum(axis=0) / np.maximum(rows.sum(axis=0), 1)
    meat = step_equations(step, weights=weights @ np.diag(variance) @ weights).matrix
    # the numbers differ by twenty powers of ten in what they do, so the root is taken at a unit diagonal too
    size = sizes_of(meat)
    values, vectors = np.linalg.eigh(meat / np.outer(size, size))
    root = size[:, np.newaxis] * vectors * np.sqrt(np.maximum(values, 0.0))
    inverse = inverse_root(normal.matrix)
    theta = (inverse @ (inverse.T @ root)).T
    coefficients = -np.einsum("st,tno->sno", theta, slopes_of(step))
    return _loadings(
        model,
        theta,
        coefficients,
        own=_own(step),
        noise=np.sqrt(variance),
        degrees_of_freedom=float(freedom.mean()),
    )


def _own(step: RefinementStep) -> FloatArray:
    """(n_own, n_regressors, n_outputs) the root of each output's own (Phi' Phi)^-1."""
    n = max(len(one.inverse_factor) for one in step.sums)
    own = np.zeros((n, step.layout.n_regressors, step.layout.n_outputs))
    for one in step.sums:
        own[: len(one.inverse_factor), :, list(one.outputs)] = one.inverse_factor[:, :, np.newaxis]
    return own


def _unlike(variances: FloatArray, rows: np.ndarray) -> bool:
    """Whether records differ in their noise beyond chance (Bartlett's test), with (n_records, n_outputs) variances."""
    counted = rows * (variances > 0.0)
    known = np.where(variances > 0.0, variances, 1.0)
    pooled = (counted * variances).sum(axis=0) / np.maximum(counted.sum(axis=0), 1)
    statistic = float((counted * np.log(np.where(counted > 0, pooled, 1.0) / known)).sum())
    freedom = int(((counted > 0).sum(axis=0) - 1).clip(0).sum())
    return bool(scipy.special.gammaincc(0.5 * freedom, 0.5 * statistic) < UNLIKE_AT)


def _of_records(model: RefinedModel, variances: FloatArray, degrees_of_freedom: float) -> _Loadings:
    """Of drawn white noise with (n_records, n_outputs) variances, by what it has in common with all signals."""
    step, data, layout = model.step, model.data, model.step.layout
    rng = np.random.default_rng(0)
    products = np.zeros((N_RECORD_DRAWS, layout.size, layout.n_outputs))
    for number, (record, share) in enumerate(zip(data.records, data.shares, strict=True)):
        places = layout.places(number)
        drawn = rng.standard_normal((N_RECORD_DRAWS, len(places), layout.n_outputs))
        together = [list(outputs) for outputs in data.together]
        grams = np.zeros((len(together), len(places), len(places)))
        for first, every in signals_of(layout, step.parameters, number, record):
            for k, outputs in enumerate(together):
                signals = every * np.sqrt(share[first : first + len(every), outputs[:1]])
                grams[k] += signals.T @ signals
        for gram, outputs in zip(grams, together, strict=True):
            size = sizes_of(gram)
            values, vectors = np.linalg.eigh(gram / np.outer(size, size))
            # the symmetric root: eigenvectors turn with rounding, and what is drawn along them with it
            root = size[:, np.newaxis] * ((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)
            made = np.einsum("st,kto->kso", root, drawn[..., outputs]) * np.sqrt(variances[number, outputs])
            products[:, places[:, np.newaxis], outputs] += made
    return _pulled(model, products / np.sqrt(N_RECORD_DRAWS), degrees_of_freedom)


def _of_blocks(model: RefinedModel) -> _Loadings:
    """Each block of rows by what all signals have in common with its errors."""
    n_blocks = len(model.data.blocks)
    products = np.sqrt(n_blocks / max(1, n_blocks - 1)) * _block_products(model.step, model.data)
    return _pulled(model, products, max(1.0, model.n_parts - 1.0))


def _block_products(step: RefinementStep, data: OutputError) -> FloatArray:
    """(n_blocks, size, n_outputs) of all signals with the errors of each block of rows."""
    layout, n_blocks = step.layout, len(data.blocks)
    products, phi = np.zeros((n_blocks, layout.size, layout.n_outputs)), layout.alone.regressors
    for number, (record, share) in enumerate(zip(data.records, data.shares, strict=True)):
        places = layout.places(number)
        own = [(i, block) for i, block in enumerate(data.blocks) if block.record == number]
        for first, signals in signals_of(layout, step.parameters, number, record):
            error = signals[:, layout.alone.outputs] - signals[:, phi] @ step.linear.coefficients[places[phi]]
            error *= share[first : first + len(error)]
            for i, block in own:
                there = slice(max(0, block.first - first), max(0, block.last - first))
                products[i, places] += signals[there].T @ error[there]
    return products


def chance_of_leaving(step: RefinementStep, data: OutputError, weights: FloatArray, more: float) -> float:
    """How often noise of the colour that is left moves the best model so far that the true one leaves so much more.

    Output error is consistent whatever the colour, so a better estimate of the same system leaves more than the best
    model, by (t - t0)' A (t - t0) for its curvature A, and no more than the true one: sum of s' A^-1 s of the scores s
    of nearly independent blocks in the mean (Hausman's test, in what is left; Satterthwaite's degrees of freedom).

    Args:
        step: the model that leaves least.
        data: with blocks that are long against the memory of the noise.
        weights: (n_outputs,) of the squared errors.
        more: weighted sum of squares that the other model leaves beyond that of this one.

    References:
        Hausman, Econometrica 46(6), 1978, 1251-1271, doi 10.2307/1913827; Satterthwaite, Biometrics Bulletin 2(6),
        1946, 110-114, doi 10.2307/3002019.
    """
    parts, n = Span.of(step, weights).coordinates(_block_products(step, data)), len(data.blocks)
    gram = parts @ parts.T * n / max(1, n - 1)
    mean, square = float(np.trace(gram)), float(np.square(gram).sum())
    if not square > 0.0:
        return 1.0
    return float(scipy.special.fdtrc(mean**2 / square, max(1, n - 1), max(0.0, more) / mean))


def _of_feedback(model: RefinedModel) -> _Loadings:
    """One disturbance: how far the part of the inputs that the errors made pulls the model."""
    step, data = model.step, model.data
    errors = errors_of(step, data)
    made = inputs_made_by(errors, data.records)
    records = [
        replace(record, inputs=own, outputs=np.nan_to_num(error))
        for record, own, error in zip(data.records, made, errors, strict=True)
    ]
    parameters = replace(step.parameters, states=np.zeros_like(step.parameters.states))
    layout, gram, _ = signal_grams(parameters, records, data.rows, data.blocks, n_direct=step.layout.n_direct)
    products = gram[:, layout.outputs].copy()
    own = layout.n_poles * layout.n_records
    for part, of_no_input in ((layout.regressors, layout.n_records), (layout.real, own), (layout.imaginary, own)):
        products[part.stop - of_no_input : part.stop] = 0.0  # no error makes a level or an initial state
    return _pulled(model, products[np.newaxis], float("inf"))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Powers:
    """White noises that make the spectrum of what is left likeliest; the model answers to that of its inputs.

    Attributes:
        of_inputs: (n_records, n_inputs) variances, of the channels that the model was fitted to.
        of_outputs: (n_records, n_outputs) variances.
        misfit: how many times as far as by chance means of `IN_A_BAND` neighbouring lines of the spectrum are from what
            they explain: squares, one by chance alone.
    """

    of_inputs: FloatArray
    of_outputs: FloatArray
    misfit: float


def _powers(model: RefinedModel) -> _Powers:
    """One power an input, in all records in which it moves, and one an output and record.

    Between blows an input shows its noise itself, and has that at least.
    """
    step, data = model.step, model.data
    poles, b, c = step.parameters.poles, step.parameters.inputs, step.linear.shapes
    n, m = poles.size, b.shape[1]
    D = step.linear.coefficients[2 * n : 2 * n + m]
    looks: list[tuple[FloatArray, FloatArray]] = []
    acting: list[FloatArray] = []
    for left, record, size in zip(errors_of(step, data), data.records, model.record_scale, strict=True):
        error = np.nan_to_num(left[:LONGEST_LOOK])
        rings = powers_of(poles, len(error) - 1)
        pulses = np.concatenate([D[np.newaxis], np.einsum("kn,nm,on->kmo", rings, b, c).real])
        measured, answers = (np.abs(np.fft.rfft(one, axis=0)[1:]) ** 2 for one in (error, pulses))
        moves = (record.inputs != record.inputs[:1]).any(axis=0) / size**2
        acting.append(moves)
        there = np.maximum(1, np.isfinite(left[:LONGEST_LOOK]).sum(axis=0))
        looks.append((measured / there, answers * moves[:, np.newaxis]))
    least = np.finfo(float).eps * max(measured.max() for measured, _ in looks)
    looks = [(measured + least, answers) for measured, answers in looks]
    alone = np.array([measured.mean(axis=0) for measured, _ in looks])
    made = sum(answers.sum(axis=(0, 2)) for _, answers in looks)
    total = sum(float(measured.sum()) for measured, _ in looks)
    of_inputs, of_outputs = np.divide(total, made, out=np.zeros(m), where=made > 0.0), alone
    for _ in range(N_STEPS):
        there, wanted, outputs = np.zeros(m), np.zeros(m), []
        for (measured, answers), own in zip(looks, of_outputs, strict=True):
            inverse = 1.0 / (np.einsum("kmo,m->ko", answers, of_inputs) + own)
            there += np.einsum("kmo,ko->m", answers, inverse)
            wanted += np.einsum("kmo,ko->m", answers, measured * inverse**2)
            outputs.append(own * np.sqrt((measured * inverse**2).sum(axis=0) / inverse.sum(axis=0)))
        of_inputs = of_inputs * np.sqrt(np.divide(wanted, there, out=np.zeros(m), where=there > 0.0))
        of_outputs = np.array(outputs)
    gained, squares = 0.0, []
    for (measured, answers), own, before in zip(looks, of_outputs, alone, strict=True):
        explained = np.einsum("kmo,m->ko", answers, of_inputs) + own
        lines = measured / explained
        gained += 2.0 * float((np.log(before / explained) + measured / before - lines).sum())
        whole = len(lines) // IN_A_BAND * IN_A_BAND
        squares.append(np.square(lines[:whole].reshape(-1, IN_A_BAND, lines.shape[1]).mean(axis=1) - 1.0))
    if not gained > 2.0 * m:  # Akaike's price of so many numbers
        of_inputs, of_outputs = np.zeros(m), alone
    return _Powers(
        of_inputs=np.maximum(of_inputs * np.array(acting), model.at_rest),
        of_outputs=of_outputs,
        misfit=float(IN_A_BAND * np.concatenate(squares).mean()) if any(map(len, squares)) else np.inf,
    )


def _of_inputs(model: RefinedModel, powers: FloatArray) -> tuple[_Loadings, _Loadings]:
    """Of drawn noise of the inputs with (n_records, n_inputs) powers: all rows, and block by block."""
    step, data = model.step, model.data
    parameters, layout = step.parameters, step.layout
    n, m = layout.n_poles, layout.n_inputs
    D = step.linear.coefficients[2 * n : 2 * n + m].T
    rng = np.random.default_rng(0)
    whole = np.zeros((N_DRAWS, layout.size, layout.n_outputs))
    parts = np.zeros((N_BLOCK_DRAWS, len(data.blocks), *whole.shape[1:]))
    likely = model.likely_forces(powers) if model.forces_erred else None
    drawn = [] if likely is None else likely.drawn(rng, N_DRAWS)
    for number, (record, counted) in enumerate(zip(data.records, data.counted, strict=True)):
        recursion = PoleRecursion.of(parameters.poles, min(record.n_samples, CHUNK))
        states = np.zeros((N_DRAWS, n), dtype=np.complex128)
        places = layout.places(number)
        own = [(i, block) for i, block in enumerate(data.blocks) if block.record == number]
        moves = record.inputs != np.median(record.inputs, axis=0)  # a force window leaves no noise
        sizes = np.sqrt(powers[number])[:, np.newaxis] * moves.T
        for first, signals in signals_of(layout, parameters, number, record):
            there = counted[first : first + len(signals)]
            for k in range(N_DRAWS):
                noise = sizes[:, first : first + len(signals)] * rng.standard_normal((m, len(signals)))
                if likely is not None:  # what follows tells of the rest
                    told = slice(*np.searchsorted(likely.row[number], [first, first + len(signals)]))
                    noise[likely.which[number][told], likely.row[number][told] - first] = drawn[number][told, k]
                state, states[k] = recursion.run(parameters.inputs @ noise, states[k])
                left = ((step.linear.shapes @ state).real + D @ noise).T * there
                whole[k, places] += signals.T @ left
                for i, block in own if k < N_BLOCK_DRAWS else ():
                    rows = slice(max(0, block.first - first), max(0, block.last - first))
                    parts[k, i, places] += signals[rows].T @ left[rows]
    each = parts.reshape(-1, *whole.shape[1:])
    return (
        _pulled(model, whole / np.sqrt(N_DRAWS), float(N_DRAWS)),
        _pulled(model, each / np.sqrt(N_BLOCK_DRAWS), float(N_BLOCK_DRAWS)),
    )


def _pulled(model: RefinedModel, products: FloatArray, degrees_of_freedom: float) -> _Loadings:
    """Changes of the model for each of some (size, n_outputs) products of all signals with errors."""
    step, layout = model.step, model.step.layout
    normal = step_equations(step, weights=model.weights)
    slopes = slopes_of(step)
    inverse = inverse_root(normal.matrix)
    theta = scores_of(step, slopes, products @ model.weights) @ inverse @ inverse.T
    coefficients = -np.einsum("st,tno->sno", theta, slopes)
    for one in step.sums:
        seen = list(one.outputs)
        coefficients[:, :, seen] += one.inverse_factor.T @ (one.inverse_factor @ products[:, layout.regressors, seen])
    return _loadings(
        model,
        theta,
        coefficients,
        own=np.zeros((0, layout.n_regressors, layout.n_outputs)),
        noise=np.zeros(layout.n_outputs),
        degrees_of_freedom=degrees_of_freedom,
    )


def _loadings(
    model: RefinedModel,
    theta: FloatArray,
    coefficients: FloatArray,
    *,
    own: FloatArray,
    noise: FloatArray,
    degrees_of_freedom: float,
) -> _Loadings:
    layout = model.step.layout
    whole = theta @ PolesAndParticipations().slopes(model.step.parameters).T
    decay = np.log(np.abs(model.step.parameters.poles))
    shape = (theta.shape[0], 2, 1 + layout.n_inputs + layout.n_records, layout.n_poles)
    real, imaginary = whole.reshape(shape).transpose(1, 0, 2, 3)
    inputs = real[:, 1 : 1 + layout.n_inputs] + 1j * imaginary[:, 1 : 1 + layout.n_inputs]
    return _Loadings(
        log_decay=real[:, 0] / decay,
        angle=imaginary[:, 0],
        inputs=inputs.transpose(0, 2, 1),
        coefficients=coefficients,
        own=own,
        noise=noise,
        degrees_of_freedom=degrees_of_freedom,
    )


def _pole_deviations(loadings: _Loadings, poles: ComplexArray, dt: float) -> tuple[FloatArray, FloatArray]:
    """Of frequency and damping ratio: with s dt = ln lambda = -d + j theta, f = |s| / 2 pi, zeta = d / |s dt|."""
    decay, angle = -np.log(np.abs(poles)), np.angle(poles)
    size = np.hypot(decay, angle)
    d_decay = loadings.log_decay * decay
    d_size = (decay * d_decay + angle * loadings.angle) / size
    d_damping = d_decay / size - decay * d_size / size**2
    return np.linalg.norm(d_size, axis=0) / (2 * np.pi * dt), np.linalg.norm(d_damping, axis=0)


def _shape_deviations(
    loadings: _Loadings, linear: LinearPart, is_pair: np.ndarray, output_scale: FloatArray
) -> FloatArray:
    """(n_poles, n_outputs) of shapes whose largest component, in the units of the records, is 1."""
    n = is_pair.size
    c = linear.shapes * output_scale[:, np.newaxis]
    moved = (loadings.coefficients[:, :n] - 1j * loadings.coefficients[:, n : 2 * n]) * output_scale
    first = np.abs(c).argmax(axis=0)
    largest = c[first, np.arange(n)]
    largest = np.where(largest == 0, 1.0, largest)
    shape = (c / largest).T
    reference = moved[:, np.arange(n), first]
    change = (moved - shape * reference[:, :, np.newaxis]) / largest[:, np.newaxis]
    own = np.linalg.norm(loadings.own[:, :n] - 1j * loadings.own[:, n : 2 * n], axis=0) / np.abs(largest)[:, np.newaxis]
    alone = own * (loadings.noise * output_scale)
    others = np.abs(shape) * alone[np.arange(n), first][:, np.newaxis]
    variance = (np.abs(change) ** 2).sum(axis=0) + alone**2 + others**2
    variance[np.arange(n), first] = 0.0
    return np.sqrt(variance)


def _mass_deviations(loadings: _Loadings, model: RefinedModel) -> FloatArray:
    """(n_poles, n_outputs, n_inputs) relative, of m ~ c_o / (c_l^2 b_i) with l the largest component of the shape.

    The frequency in it is known far better than shape and participation, and left out.
    """
    n = model.step.parameters.poles.size
    c, b = model.step.linear.shapes.T, model.step.parameters.inputs
    moved = loadings.coefficients[:, :n] - 1j * loadings.coefficients[:, n : 2 * n]
    own = loadings.own[:, :n] - 1j * loadings.own[:, n : 2 * n]
    largest = np.arange(n), np.abs(c * model.scaling.output_scale).argmax(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        seen, fed = moved / c, loadings.inputs / b
        change = (seen - 2.0 * seen[:, *largest][:, :, np.newaxis])[..., np.newaxis] - fed[:, :, np.newaxis]
        # noise of each output on its own coefficients alone
        alone = np.square((own / c).real).sum(axis=0) * loadings.noise**2
    reference = alone[largest]
    alone += 4.0 * reference[:, np.newaxis]
    alone[largest] = reference
    deviations: FloatArray = np.sqrt(np.square(change.real).sum(axis=0) + alone[:, :, np.newaxis])
    return deviations


def _markov_deviations(loadings: _Loadings, model: RefinedModel, n_lags: int) -> FloatArray:
    """(n_lags + 1, n_outputs, n_inputs) of D and of h_k = sum over poles of Re(c lambda^(k-1) b')."""
    step, layout = model.step, model.step.layout
    poles, b, c = step.parameters.poles, step.parameters.inputs, step.linear.shapes
    n, m = layout.n_poles, layout.n_inputs
    deviations = np.empty((n_lags + 1, layout.n_outputs, m))
    d_poles = poles * (np.log(np.abs(poles)) * loadings.log_decay + 1j * loadings.angle)
    d_c = loadings.coefficients[:, :n] - 1j * loadings.coefficients[:, n : 2 * n]
    at = slice(2 * n, 2 * n + m)
    own = np.linalg.norm(loadings.own[:, at], axis=0)
    deviations[0] = np.sqrt(((loadings.coefficients[:, at] ** 2).sum(axis=0) + (loadings.noise * own) ** 2).T)
    power, slope = np.ones(n, dtype=np.complex128), np.zeros(n, dtype=np.complex128)
    for k in range(1, n_lags + 1):
        z = power[:, np.newaxis] * b
        # change of lambda^(k-1) b for each disturbance
        d_z = (slope * d_poles)[:, :, np.newaxis] * b + power[:, np.newaxis] * loadings.inputs
        change = np.einsum("spo,pm->som", d_c, z).real + np.einsum("op,spm->som", c, d_z).real
        seen = np.tensordot(z.real, loadings.own[:, :n], axes=(0, 1)) + np.tensordot(
            z.imag, loadings.own[:, n : 2 * n], axes=(0, 1)
        )
        alone = np.linalg.norm(seen, axis=1).T  # (n_outputs, n_inputs)
        deviations[k] = np.sqrt((change**2).sum(axis=0) + (loadings.noise[:, np.newaxis] * alone) ** 2)
        power, slope = power * poles, slope * poles + power
    return deviations


def judged_deviations(
    model: RefinedModel, modes: Sequence[Mode], *, n_lags: int, fed_back: bool
) -> tuple[Uncertainty, FloatArray, FloatArray]:
    """What the colour that is left does to the deviations, nan where it does too much.

    Where it is not white, but white noise on the outputs and on the inputs explains its spectrum, the deviations are
    those under such noise, else those under white noise on the outputs. Then the scores of the blocks judge: as many
    times larger as they are than those that the noise makes, and never smaller, they are stated.

    Args:
        model: from `refined_model`.
        modes: of its realisation.
        n_lags: Markov parameters asked for.
        fed_back: the outputs seem to be fed back: the bias by that stands beside the deviations in quadrature.

    Returns:
        The deviations, (n_modes,) how many times larger they are than such noise makes them, and (n_modes,) how many of
        them feedback moves each mode by.
    """
    known = output_error_uncertainty(replace(model, whiteness_ratio=1.0), modes, n_lags=n_lags)
    inflation, moved = np.ones(len(modes)), np.zeros(len(modes))
    by_blocks, powers = known, _powers(model)
    white = model.leaves_white_noise
    if powers.of_inputs.any() and (white or powers.misfit <= EXPLAINED):
        loadings = _white(model, powers.of_outputs), *_of_inputs(model, powers.of_inputs)
        outputs, drawn, drawn_by_blocks = (_deviations(one, model, modes, n_lags) for one in loadings)
        known, by_blocks = (_together(np.hypot, one, outputs) for one in (drawn, drawn_by_blocks))
    if not white:
        times = _together(_at_least_once, _deviations(_of_blocks(model), model, modes, n_lags), by_blocks)
        inflation = np.fmax(times.frequency_std, times.damping_ratio_std)
        with np.errstate(invalid="ignore"):  # of exact data: none times more than can be told
            known = _together(np.multiply, times, known)
    if fed_back:
        pull = feedback_bias(model, modes, n_lags=n_lags)
        moved = _times(pull, known)
        known = _together(np.hypot, known, pull)
    lost = np.where(inflation > NO_INTERVAL, np.nan, 1.0)
    known = replace(known, frequency_std=known.frequency_std * lost, damping_ratio_std=known.damping_ratio_std * lost)
    return known, inflation, moved


def _at_least_once(one: FloatArray, other: FloatArray) -> FloatArray:
    """How many times the other one is, at least once."""
    with np.errstate(invalid="ignore", divide="ignore"):
        times: FloatArray = np.fmax(1.0, one / other)
    return times


def _together(
    both: Callable[[FloatArray, FloatArray], FloatArray], one: Uncertainty, other: Uncertainty
) -> Uncertainty:
    return replace(
        one,
        frequency_std=both(one.frequency_std, other.frequency_std),
        damping_ratio_std=both(one.damping_ratio_std, other.damping_ratio_std),
        shape_std=both(one.shape_std, other.shape_std),
        markov_std=both(one.markov_std, other.markov_std),
        mass_std=None if one.mass_std is None or other.mass_std is None else both(one.mass_std, other.mass_std),
    )


def _times(one: Uncertainty, other: Uncertainty) -> FloatArray:
    """(n_modes,) how many times the other's deviation of frequency or damping, whichever is more."""
    with np.errstate(invalid="ignore", divide="ignore"):
        times: FloatArray = np.fmax(
            one.frequency_std / other.frequency_std, one.damping_ratio_std / other.damping_ratio_std
        )
    return times
