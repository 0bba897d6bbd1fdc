"""Input delays: found in the pulse response of a long observer, taken off the inputs, put back into the model.

An input that acts d samples late leaves the first d coefficients of its observer at zero, alpha_0 = ... = alpha_(d-1) =
0 (alpha_0 = D), whatever else the system does. A model without delays has to spend d states on it, and those states
are poles with a frequency and a damping ratio that no structure has. So the inputs are shifted before the fit, and the
shift comes back as states that only pass on their input: their poles are zero, deadbeat, and no modes.

An input that moves between its samples, a force limited to half of the sampling frequency, is at every instant a sum
over its samples, of those that are still to come as well. A causal model leaves what they add, as an error that follows
the input and rings in no mode; where modes lie above half of the sampling frequency it is many times the noise. With
inputs taken so many samples early that the sum has died out, a delay below zero, the model holds it without a state.

The first samples of a pulse response are also empty where a point far from the force is slow to move, and a blow of a
few samples hides a delay in its own shape. The modes tell the two apart. Residues of lightly damped modes, as
displacements, are real but for 1 / (2 j w); an input that acts tau late turns them by -w tau. So a delay is what makes
the residues of all modes real at once, and a wrong one would turn and stretch the scale of every mode at that input.

References:
    Sims, American Economic Review 62(4), 1972, 540-552 (leads in a regression as a test of what drives what); Bartlett,
    Proceedings of the Cambridge Philosophical Society 34(1), 1938, 33-40, doi 10.1017/S0305004100019880.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from era.realisation import Realisation
from modal.estimation.cross_validation import LONGEST_SCORED
from modal.estimation.feedback import FALSE_ALARMS, SEGMENT, feedback_p_value
from modal.modes.modal_mass import DERIVATIVES, HEARD, squared_residues
from modal.modes.mode import Choice, ModalModel
from modal.preparation.quick_model import observer_order
from okid.arrays import CHUNK_VALUES, ComplexArray, FloatArray, whole_number
from okid.errors import InsufficientDataError, InvalidDataError
from okid.frequency_response import averaged_spectra
from okid.gram import LagGram, lag_gram
from okid.least_squares import solve
from okid.markov import recover_system
from okid.record import Record
from okid.rows import spread_stretches
from okid.scaling import channel_scaling

LONGEST_SHARE = 0.1
"""Of the longest record: a delay beyond it is not looked for."""
RIDGE = 1e-8
"""Only keeps the covariance finite where inputs do not tell neighbouring lags apart."""
ROUNDING = 1e-14
"""Take no residual of an output of unit power for less: that is what the sums of squares round to."""
CHANCE = 1e-4
"""Probability that the leading lags of an input that acts at once look as empty as they may."""
LEAST_DELAY = 2
"""A single empty lag is what sampling does to any system without direct feedthrough."""
EXCITED = 0.5
"""Look for no delay where an input has less than this share of its power at one lag as at another: rows that hold a
hit at late lags only say nothing about early ones."""
REAL = 0.05
"""Take a residue for real within this angle [rad]: the scale of its mode is then right to a thousandth."""
EVEN_ODDS = 0.05
"""Take back a delay, or a part of it, where the phases fit what is left so much better: a delay is at most the lags
that are empty, and any number up to them is as likely."""
MOST_LEAD = 40
"""Look so many samples ahead of the outputs; a lead ends in the first half of them."""
OLDER = 3
"""Ask outputs that are so many leads old for a loop: a lead ends where noise covers the rest."""
EDGE, LIMITED = 0.05, 0.25
"""Call an input limited, as by a filter, that has less than this share of its mean density in this last part of the
band; of 72 smooth forces that outputs foretold all had less than 0.16, behind filters of the fourth order too."""
EMPTY = 0.05
"""Part of the largest pulse response that the empty lags cannot exceed (two standard deviations): noise hides none."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class InputDelay:
    """How late each input acts.

    Attributes:
        samples: one number an input, in samples of the records looked at; below zero where it acts early.
        choice: what was chosen and why.
    """

    samples: tuple[int, ...]
    choice: Choice


def choose_input_delay(records: Sequence[Record]) -> InputDelay:
    """Delays in which the pulse response is empty: not significant together, and small beside what follows.

    Nested Wald tests: with a the leading d coefficients of an input in all outputs, P their part of the inverse of the
    Gram matrix and S the residuals' covariance, tr(S^-1 a' P^-1 a) is chi-square with d n_outputs degrees of freedom
    while the input has not acted. Where no lag of an input is significant its delay may be longer than the observer:
    it is shifted by half of it and looked at again.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> force = rng.standard_normal(600)
        >>> record = Record(force, np.roll(force, 7) + 0.01 * rng.standard_normal(600), 0.01).samples(7)
        >>> choose_input_delay([record]).samples
        (7,)
    """
    n_inputs = records[0].n_inputs
    if n_inputs == 0:
        return _found((), records[0])
    limit = int(LONGEST_SHARE * max(record.n_samples for record in records))
    found = np.zeros(n_inputs, dtype=int)
    waiting = np.ones(n_inputs, dtype=bool)
    while waiting.any():
        try:
            empty, order = _empty_lags(late_inputs(records, found.tolist()))
        except InsufficientDataError:
            break
        silent = waiting & (empty > order)
        seen = waiting & ~silent & (empty >= LEAST_DELAY)
        found[seen] += empty[seen]
        gone = silent & (found + order // 2 > limit)
        found[gone] = 0  # it drives nothing that can be seen: no reason to shift it
        waiting = silent & ~gone
        found[waiting] += max(1, order // 2)
    return _found(tuple(int(d) for d in found), records[0])


def with_lead(
    delay: InputDelay, records: Sequence[Record], measured: Sequence[Record], *, before: int | None = None
) -> InputDelay:
    """The same, inputs that act at once taken early where outputs tell of what lies ahead of them.

    Nested regressions tell how far. With p outputs and inputs of the past in the model, S_L what the inputs up to L
    samples ahead leave of the outputs, and H samples at most,

        (N - numbers - (n_outputs + 1) / 2) ln(det S_L / det S_H)

    is chi-square with (H - L) n_inputs n_outputs degrees of freedom where the inputs beyond L tell nothing (Bartlett)
    and the noise does not grow with the inputs. Where it does, as in records of several levels, all inputs seem to
    tell, those H + 1 to 2 H samples ahead as well: the ratio to these is F-distributed.

    A controller, too, makes the inputs ahead tell of what is now, and a lead would hide it. So none is taken where the
    inputs as measured follow the outputs as in a loop (`loop_p_value`). That is not asked of blows: nothing is before
    them that they could answer.

    Args:
        delay: that the pulse response shows.
        records: that are to be fitted, with inputs as they came.
        measured: the same before they were decimated: a filter that looks ahead makes inputs follow outputs.
        before: rows before the first blow of any record; None where inputs act throughout.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> force, noise = rng.standard_normal((2, 4000))
        >>> record = Record(force[:-1], force[:-1] + 0.2 * force[1:] + 0.01 * noise[1:], 0.01)
        >>> with_lead(choose_input_delay([record]), [record], [record]).samples
        (-1,)
    """
    lead = 0 if all(delay.samples) else lead_of(late_inputs(records, delay.samples), before)
    if not lead:
        return delay
    early = tuple(d or -lead for d in delay.samples)
    try:
        late_inputs(records, early)
        p_value = 1.0 if before is not None else loop_p_value(measured)
    except InsufficientDataError:  # a record too short for it
        return delay
    if not p_value >= FALSE_ALARMS:  # nan where the inputs cannot be asked
        return delay
    reason = (
        "outputs also tell of inputs that lie ahead of them, as of a force that moves between its samples; the model "
        "looks ahead as far as that lasts, its modes answer at once"
    )
    choice = Choice(what=delay.choice.what, value=_in_words(early, records[0]), reason=reason)
    return InputDelay(samples=early, choice=choice)


def loop_p_value(records: Sequence[Record]) -> float:
    """How often records without feedback look as much like it, where forces may move between their samples.

    In open loop, too, outputs foretell a force that does so (`modal.estimation.feedback`). They tell of what lies ahead
    of them then, and that ends after a few samples, the lead; and the force has little left near half of the sampling
    frequency. Where both hold, outputs older than a few leads are asked as well: a loop answers those as long as its
    motions ring. Of a force with all of the band, which nothing lies between the samples of, a lead is a matter of two
    clocks, and what the outputs tell of the inputs beyond it is asked.

    Args:
        records: as measured: a lead that was taken hides a loop that answers within it.
    """
    p_value = feedback_p_value(records)
    lead = lead_of(records) if p_value < FALSE_ALARMS else 0
    if not lead:
        return p_value
    if _is_limited(records):
        beyond = feedback_p_value(records, older=OLDER * lead)
    else:
        beyond = feedback_p_value(late_inputs(records, [-lead] * records[0].n_inputs))
    return p_value if np.isnan(beyond) else max(p_value, beyond)


def _is_limited(records: Sequence[Record]) -> bool:
    """Whether some input leaves the last part of the band as empty as a filter does."""
    n_longest = max(record.n_samples for record in records)
    spectra = averaged_spectra(records, n_per_segment=min(SEGMENT, n_longest))
    density = spectra.power[1:-1, : records[0].n_inputs]
    last = density[-max(1, int(EDGE * len(density))) :]
    return bool(spectra.n_averages and (last.mean(axis=0) < LIMITED * density.mean(axis=0)).any())


def lead_of(records: Sequence[Record], before: int | None = None) -> int:
    """Samples ahead after which inputs tell nothing more; 0 where none do, or where that is not seen to end.

    Args:
        records: whose inputs are not late.
        before: rows before the first blow of any record, None where inputs act throughout. Only so many samples of the
            past are known of what blows make; a lead leaves half of them.
    """
    order, (m, q) = observer_order(records), (records[0].n_inputs, records[0].n_outputs)
    order = order if before is None else min(order, before)
    if not order:
        return 0
    some = spread_stretches(records, LONGEST_SCORED)
    gram = lag_gram(some, order + MOST_LEAD, scaling=channel_scaling(some))
    n_numbers = 1 + order * (m + q) + (1 + MOST_LEAD) * m
    if gram.n_rows < 2 * n_numbers:
        return 0
    # the row asked of is MOST_LEAD samples old, so that the inputs ahead of it are known
    lags = 1 + (m + q) * np.arange(order + MOST_LEAD + 1)[:, np.newaxis]
    inputs, outputs = lags + np.arange(m), lags + m + np.arange(q)
    past = [[0], outputs[MOST_LEAD + 1 :].ravel(), inputs[MOST_LEAD:].ravel()]
    places = np.concatenate([*past, inputs[:MOST_LEAD][::-1].ravel(), outputs[MOST_LEAD]])
    matrix = gram.matrix[np.ix_(places, places)] / gram.n_rows
    # one factor holds what is left with any number of them
    factor = scipy.linalg.cholesky(matrix + RIDGE * np.eye(len(places)))[:, -q:]
    ahead, left = factor[-q - MOST_LEAD * m : -q].reshape(MOST_LEAD, m, q), factor[-q:]
    told = np.cumsum(np.einsum("lmi,lmj->lij", ahead, ahead)[::-1], axis=0)[::-1]  # by those from each lag on
    least = left.T @ left + ROUNDING * np.eye(q)
    ratio = np.linalg.slogdet(least + told).logabsdet - np.linalg.slogdet(least).logabsdet
    half, statistic = MOST_LEAD // 2, (gram.n_rows - n_numbers - (q + 1) / 2) * ratio
    freedom, as_far = m * q * np.arange(half, 0, -1), m * q * half
    by_chance = max(1.0, statistic[half] / as_far)
    chance = scipy.special.fdtrc(freedom, as_far, (statistic[:half] - statistic[half]) / freedom / by_chance)
    lead = int(np.argmax(chance >= CHANCE))  # 0, too, where all of them tell
    return lead if before is None else min(lead, before // 2)


def check_delay_word(input_delay: int | Sequence[int] | str) -> None:
    """Raise InvalidDataError for another word than "auto"."""
    if isinstance(input_delay, str) and input_delay != "auto":
        raise InvalidDataError(f'input_delay must be "auto" or one number of samples or more, but is {input_delay!r}.')


def given_input_delay(delay: int | Sequence[int], record: Record, *, decimation: int = 1) -> InputDelay:
    """The caller's delay, one for all inputs or one an input, in samples of the record before decimation.

    What is not a whole number of decimated samples stays for the model to explain. Below zero an input acts early.

    Raises:
        InvalidDataError: a broken number, one below -40 decimated samples, or not one an input.

    Example:
        >>> given_input_delay(5, Record([0.0, 1.0], [0.0, 1.0], 0.1), decimation=2).samples
        (2,)
    """
    values = list(delay) if isinstance(delay, Iterable) else [delay] * record.n_inputs
    if len(values) != record.n_inputs:
        raise InvalidDataError(
            f"input_delay needs one number of samples for each of the {record.n_inputs} inputs, but has {len(values)}."
        )
    least = -MOST_LEAD * decimation
    samples = tuple(whole_number(value, name="an input delay", least=least) // decimation for value in values)
    return InputDelay(
        samples=samples,
        choice=Choice(what="input delay", value=_in_words(samples, record), reason="given as an argument"),
    )


def late_inputs(records: Sequence[Record], samples: Sequence[int]) -> tuple[Record, ...]:
    """The records with each input as it acts: so many samples later. Rows whose inputs lie outside the record go.

    Raises:
        InsufficientDataError: a record that is not longer than the longest delay and lead.

    Example:
        >>> record = Record([1.0, 2.0, 3.0, 4.0], [0.0, 0.0, 1.0, 2.0], 0.1)
        >>> [late.inputs.ravel().tolist() for late in late_inputs([record], [2])]
        [[1.0, 2.0]]
    """
    if not any(samples):
        return tuple(records)
    late, early = late_and_early(samples)
    shifted = []
    for record in records:
        last = record.n_samples - early
        if last <= late + max(record.n_inputs, record.n_outputs):
            raise InsufficientDataError(
                f"an input delay of {late or -early} samples leaves nothing of a record of "
                f"{record.n_samples}; leave that record out or give a shorter input_delay."
            )
        inputs = np.column_stack(
            [column[late - int(d) : last - int(d)] for column, d in zip(record.inputs.T, samples, strict=True)]
        )
        shifted.append(replace(record.samples(late, last), inputs=inputs))
    return tuple(shifted)


def late_and_early(samples: Sequence[int]) -> tuple[int, int]:
    """How many rows at the start and at the end of a record have no input of their own."""
    return max(0, *samples) if samples else 0, max(0, *(-d for d in samples)) if samples else 0


def with_input_delay(realisation: Realisation, samples: Sequence[int]) -> Realisation:
    """The model of late inputs, driven by the inputs as they are: one more state for each sample of delay.

    Where one acts early the model looks ahead by as much, and all others are late against that.

    The first states are those of the model that was given; Hankel factors belong to that model and are left behind. The
    delay states are known exactly, so the gain does not correct them.

    Args:
        realisation: whose inputs act at once.
        samples: (n_inputs,) delays.

    Raises:
        InvalidDataError: not one an input.

    Example:
        >>> from era.simulation import simulate
        >>> late = with_input_delay(Realisation([[0.5]], [[1.0]], [[2.0]], [[0.0]], 0.01), [2])
        >>> simulate(late, Record([1.0, 0.0, 0.0, 0.0, 0.0], [0.0] * 5, 0.01)).outputs.ravel().tolist()
        [0.0, 0.0, 0.0, 2.0, 1.0]
    """
    model = realisation
    if len(samples) != model.n_inputs:
        raise InvalidDataError(
            f"one delay for each of {model.n_inputs} inputs is needed, but {len(samples)} were given."
        )
    _, early = late_and_early(samples)
    lead, delays = model.lead + early, [d + early for d in samples]
    if not any(delays):
        return replace(model, lead=lead)
    order, n_late = model.order, sum(delays)
    A, B = np.zeros((order + n_late,) * 2), np.zeros((order + n_late, model.n_inputs))
    C, D = np.zeros((model.n_outputs, order + n_late)), np.array(model.D)
    A[:order, :order], B[:order], C[:, :order] = model.A, model.B, model.C
    first = order
    for j, d in enumerate(delays):
        if d == 0:
            continue
        # first ... first + d - 1 hold u(k-d) ... u(k-1), so that A stays upper triangular in blocks
        A[:order, first], C[:, first] = model.B[:, j], model.D[:, j]
        A[range(first, first + d - 1), range(first + 1, first + d)] = 1.0
        B[:, j], D[:, j] = 0.0, 0.0
        B[first + d - 1, j] = 1.0
        first += d
    gain = None if model.K is None else np.vstack([model.K, np.zeros((n_late, model.n_outputs))])
    return Realisation(A, B, C, D, model.dt, K=gain, singular_values=model.singular_values, lead=lead)


def acting_at_once(modes: ModalModel, samples: Sequence[int]) -> ModalModel:
    """Modes of a model of late inputs, as inputs drive them that act at once where they act early there.

    Ringing that began `lead` samples ago has turned and decayed by as many powers of the pole. What happens between the
    instant and the samples ahead is the motion of the input, and no mode's.

    Args:
        modes: of the model of late inputs.
        samples: (n_inputs,) delays, below zero where an input acts early.
    """
    if not samples or min(samples) >= 0:
        return modes
    lead = np.maximum(0, -np.asarray(samples))
    driven = tuple(
        replace(mode, participation=mode.participation * np.exp(mode.pole * modes.dt * lead)) for mode in modes.modes
    )
    return replace(modes, modes=driven)


def delay_of_phases(modes: ModalModel, samples: Sequence[int], *, longest: int) -> tuple[int, ...]:
    """The delays that make the residues of all modes real, or those that were taken where the modes do not say.

    Of an input that acts early nothing is asked: it moves between its samples, and that is not a whole delay.

    With e the angle to the real axis that k of n modes keep, chance gathers them so closely with a probability of at
    most n C(n, k) (2 e / pi)^k for each delay tried, whichever k above n / 2 is the best, as some poles may be noise;
    within tau there are 2 tau f_max delays that can be told apart. Of inputs with phases at random, 2 in 1000 are given
    a delay (4 modes, 60 samples; `tests/modal/preparation/test_delay.py`).

    Args:
        modes: of the model whose inputs are late by `samples`.
        samples: (n_inputs,) delays that were taken, in samples of that model.
        longest: delay that is looked for.

    Returns:
        (n_inputs,) delays.
    """
    system = [
        mode for mode in modes.system if mode.kind == "oscillatory" and mode.damping_resolved and mode.pole.imag > 0.0
    ]
    if not system or len(modes.output_units) != len(system[0].shape):
        return tuple(samples)
    powers = [DERIVATIVES.get(unit) for unit in modes.output_units]
    known = all(power is not None for power in powers)
    turns = (0.0,) if known else (0.0, 0.5 * np.pi)  # displacements or accelerations, or else velocities
    angular = np.array([mode.pole.imag for mode in system]) * modes.dt
    taken_off = np.array(powers if known else np.zeros(len(powers)), dtype=np.intp)
    squares = squared_residues(system, modes.dt, taken_off, hold=modes.input_hold)
    heard = np.ones(squares.shape, dtype=np.bool_)
    for r, mode in enumerate(system):
        if mode.mass_std is not None:  # at a node of the mode the phase is that of the noise
            heard[r] = mode.mass_std.min(axis=0) < HEARD
    found = []
    for i, taken in enumerate(samples):
        rows = np.flatnonzero(heard[:, i]) if taken >= 0 else np.zeros(0, dtype=np.intp)
        found.append(_real_delay(angular[rows], np.angle(squares[rows, i]), taken, turns, longest))
    return tuple(found)


def delay_between(
    quotient: ComplexArray, variance: FloatArray, angular: FloatArray, *, longest: int
) -> tuple[int, float, FloatArray, FloatArray]:
    """How much later an input acts in one set-up than in another, and with which gain, from residues of the same modes.

        quotient = gain exp(-j w delay)

    The smallest delay whose likelihood is as good as the best one's: few modes do not tell delays a period apart.

    Args:
        quotient: (n_modes, n_references) residues of the one over those of the other.
        variance: (n_modes, n_references) of their relative errors.
        angular: (n_modes,) frequencies [rad/sample].
        longest: delay that is looked for.

    Returns:
        The delay [samples], the sign of the gain, and of each reference the logarithm of its gain and the deviation,
        widened by what the modes disagree beyond their own deviations.
    """
    weight = 1.0 / np.maximum(variance, np.finfo(np.float64).tiny)
    turned = (weight * quotient / np.abs(quotient)).sum(axis=1)
    steps = np.array(sorted(range(-longest, longest + 1), key=abs))
    score = (np.exp(1j * np.outer(steps, angular)) @ turned).real
    best = float(np.abs(score).max())
    at = int(np.flatnonzero(np.abs(score) >= best - max(-2.0 * np.log(CHANCE), REAL**2 * best))[0])
    size = np.log(np.abs(quotient))
    level = (weight * size).sum(axis=0) / weight.sum(axis=0)
    n_modes = len(quotient)
    left = (weight * (size - level) ** 2).sum() / max(1, (n_modes - 1) * quotient.shape[1])
    spread = (max(1.0, left) / weight.sum(axis=0)) ** 0.5
    return int(steps[at]), float(np.sign(score[at])), level, spread


def _real_delay(angular: FloatArray, doubled: FloatArray, taken: int, turns: Sequence[float], longest: int) -> int:
    """The delay of one input [samples] from the doubled angles of its residues; `taken` where no other is clear."""
    if angular.size == 0:
        return taken
    step = min(0.5, REAL / angular.max())
    most = min((longest - taken) / step, CHUNK_VALUES / angular.size)
    steps = step * np.arange(-int((taken + 1) / step), int(max(1.0 / step, most)) + 1)
    chance = np.ones(steps.size)
    many = np.arange(1, angular.size + 1)
    least = angular.size // 2
    ways = angular.size * scipy.special.comb(angular.size, many)
    for turn in turns:
        angle = 0.5 * np.abs(np.angle(np.exp(1j * (doubled + 2.0 * turn + 2.0 * np.outer(steps, angular)))))
        width = np.minimum(np.maximum(np.sort(angle, axis=1), REAL) * 2.0 / np.pi, 1.0)
        chance = np.minimum(chance, len(turns) * (ways * width**many)[:, least:].min(axis=1))
    now = float(chance[np.abs(steps) <= 0.5].min())
    less = np.flatnonzero((steps < -0.5) & (steps >= -taken - 0.5))
    if less.size and (taken + 1) * chance[less].min() < EVEN_ODDS * now:
        return max(0, taken + round(float(steps[less][chance[less] <= 1.01 * chance[less].min()].mean())))
    tried = 1.0 + np.abs(steps) * angular.max() / np.pi
    best = int(np.argmin(chance * tried))
    late = taken + round(float(np.mean(steps[chance * tried <= 1.01 * chance[best] * tried[best]])))
    return max(0, late) if chance[best] * tried[best] < CHANCE * now else taken


def pulse_steps(records: Sequence[Record]) -> FloatArray:
    """(order + 1, n_outputs, n_inputs) how far the pulse responses of a long observer move from lag to lag."""
    order = observer_order(records)
    fit = solve(lag_gram(records, order, scaling=channel_scaling(records)), RIDGE)
    pulse = recover_system(fit.feedthrough, fit.input_coefficients, fit.output_coefficients, order)
    return np.abs(np.diff(pulse, axis=0, prepend=0.0))


def _empty_lags(records: Sequence[Record]) -> tuple[np.ndarray, int]:
    """(n_inputs,) leading lags that are empty, order + 1 where all are; and the order that was looked at."""
    order = observer_order(records)
    scaling = channel_scaling(records)
    gram = lag_gram(records, order, scaling=scaling)
    n_inputs, n_outputs = gram.n_inputs, gram.n_outputs
    width = 1 + n_inputs + order * (n_inputs + n_outputs)
    if gram.n_rows < 2 * width:
        raise InsufficientDataError(f"{gram.n_rows} complete rows are too few to look for a delay; leave out gaps.")
    fit = solve(gram, RIDGE)
    pulse = recover_system(fit.feedthrough, fit.input_coefficients, fit.output_coefficients, order)
    coefficients = np.concatenate([fit.feedthrough[np.newaxis], fit.input_coefficients])
    sizes = np.linalg.norm(pulse, axis=1)  # (order + 1, n_inputs)
    values, vectors = np.linalg.eigh(np.atleast_2d(fit.residual_covariance))
    weight = (vectors / np.maximum(values, ROUNDING)) @ vectors.T  # an exact fit leaves rounding, of either sign
    inverse = _inverse(gram)
    lags = np.arange(order + 1)
    bounds = scipy.special.chdtri(n_outputs * (lags + 1), CHANCE)
    empty = np.zeros(n_inputs, dtype=int)
    for j in range(n_inputs):
        places = _places(gram, j)
        power = np.diag(gram.matrix)[_with_outputs(gram, places)]
        if power.min() < EXCITED * power.max():
            continue  # a lag at which the input hardly moved looks empty whatever the system does
        own = inverse[np.ix_(places, places)]
        leading = coefficients[:, :, j]
        reduced = scipy.linalg.solve_triangular(np.linalg.cholesky(own), leading, lower=True)
        statistic = np.cumsum(np.einsum("ko,op,kp->k", reduced, weight, reduced))
        n_empty = int(np.argmax(statistic > bounds)) if (statistic > bounds).any() else order + 1
        left = max(0.0, float(np.trace(np.atleast_2d(fit.residual_covariance))))  # an exact fit leaves rounding
        noise = np.sqrt(np.diag(own) * left)
        upper = np.linalg.norm(leading, axis=1) + 2.0 * noise
        hidden = (upper > EMPTY * sizes[:, j].max())[:n_empty].any()
        empty[j] = 0 if hidden and n_empty <= order else n_empty
    return empty, order


def _places(gram: LagGram, channel: int) -> np.ndarray:
    """Of an input's lags 0, 1, ... among the regressors [1, u(k), u(k-1), y(k-1), ...]."""
    n_inputs, n_outputs = gram.n_inputs, gram.n_outputs
    later = 1 + n_inputs + (n_inputs + n_outputs) * np.arange(gram.order) + channel
    return np.concatenate([[1 + channel], later])


def _with_outputs(gram: LagGram, places: np.ndarray) -> np.ndarray:
    """The same regressors in the Gram matrix, which has the outputs at lag 0 after the inputs there."""
    return np.where(places > gram.n_inputs, places + gram.n_outputs, places)


def _inverse(gram: LagGram) -> FloatArray:
    """Of the Gram matrix of the regressors, without the outputs at lag 0."""
    now = slice(1 + gram.n_inputs, 1 + gram.n_inputs + gram.n_outputs)
    own = np.delete(np.delete(gram.matrix, now, axis=0), now, axis=1)
    own = own + RIDGE * gram.n_rows * np.eye(own.shape[0])
    inverse = np.linalg.inv(own)
    symmetric: FloatArray = np.asarray(0.5 * (inverse + inverse.T), dtype=np.float64)
    return symmetric


def _found(samples: tuple[int, ...], record: Record) -> InputDelay:
    reason = (
        "before it the pulse response of a long observer is empty: not significant together, and below "
        f"{100 * EMPTY:g} % of its largest value"
        if any(samples)
        else "each input acts at once or, within the noise, cannot be said to act late"
    )
    return InputDelay(
        samples=samples, choice=Choice(what="input delay", value=_in_words(samples, record), reason=reason)
    )


def _in_words(samples: Sequence[int], record: Record) -> str:
    late = [
        f"{name}: {abs(d)} sample{'s' * (abs(d) > 1)}{' early' if d < 0 else ''} ({abs(d) * record.dt:.4g} s)"
        for name, d in zip(record.input_names, samples, strict=True)
        if d
    ]
    return ", ".join(late) or "none"
