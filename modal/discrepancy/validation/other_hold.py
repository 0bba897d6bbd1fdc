"""Half a sample: a wrongly declared hold of the inputs, and records cut into spans where no simulation can follow.

A delay that is off by about half a sample may be a wrong hold: then the records are taken the other way too. With many
samples a period the two cannot be told apart, and what was declared stands. With few, or hardly any noise, a wrong hold
leaves a gap that no delay closes: further effects are found that only stand in for it, or none is enough. Where it is
too small for any effect, the test of what is left still sees it: then the holds are compared by that. Between a
held and a straight input lies half a sample, pi f dt in phase at the frequency f: that share of the motion at most.

Hard springs under a strong drive, and stops, part neighbouring motions exponentially: from the initial state to the end
of a long record no simulation, of the true model either, stays with the measurement. Over a few dozen periods it does.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import get_args

import numpy as np

from modal.discrepancy.results import Diagnosis
from modal.effects.catalogue import effects_at
from modal.effects.effect import Effect
from modal.simulation import AT_FLOOR, FOLLOWED, UNLIKELY, explained
from modal.wording.text import number
from okid.arrays import FloatArray
from okid.record import InputHold, Record

HALF_A_SAMPLE = (0.25, 0.75)
"""Suspect a wrong hold behind a delay that lies between these beyond whole samples."""

Diagnose = Callable[[Sequence[Record], Sequence[Record], Mapping[str, Effect]], Diagnosis]
"""Records to fit, held-out records and the effects to try in, the diagnosis out."""


def other_hold(declared: InputHold) -> InputHold:
    """What an input may be instead: held by its source, or measured.

    Example:
        >>> other_hold("zero_order"), other_hold("linear")
        ('band_limited', 'zero_order')
    """
    return "band_limited" if declared == "zero_order" else "zero_order"


def half_a_sample(delay: float, dt: float) -> bool:
    """Whether a delay of either sign is about half a sample off whole ones.

    Args:
        delay: [s].
        dt: Time step of the record [s].

    Example:
        >>> half_a_sample(0.006, 0.01), half_a_sample(-0.005, 0.01), half_a_sample(0.01, 0.01)
        (True, True, False)
    """
    return HALF_A_SAMPLE[0] <= delay / dt % 1.0 <= HALF_A_SAMPLE[1]


def has_half_a_sample(diagnosis: Diagnosis) -> bool:
    """Whether a delay was found that is about half a sample off whole ones."""
    delays = [one.parameters[0].value for one in diagnosis.findings if one.effect == "input_delay"]
    return any(half_a_sample(delay, diagnosis.fit[0].dt) for delay in delays)


def by_the_better_hold(found: Diagnosis, diagnose: Diagnose, catalogue: Mapping[str, Effect]) -> Diagnosis:
    """The diagnosis by the declared hold, or by the other one where that needs less to explain the records.

    Where the declared one explains them too, the other must do so with fewer of the same effects, or with as many and
    come nearer to what was held out by more than noise floors are known.

    One of the two, the other hold's with a warning that says so.
    """
    declared = found.fit[0].input_hold
    hold = other_hold(declared)

    def diagnosed(tried: Mapping[str, Effect], hold: InputHold = hold) -> Diagnosis:
        fit, held_out = ([replace(one, input_hold=hold) for one in some] for some in (found.fit, found.held_out))
        return diagnose(fit, held_out, tried)

    if _leaves_an_input(found):
        others = [one for one in get_args(InputHold) if one != declared]
        better = next((one for one in others if diagnosed({}, one).status == "none"), None)
        if better is None:
            return found
        words = (
            f"the inputs are declared {declared}, and then the model leaves something that depends on them; as "
            f"{better} it leaves noise, so that is what was taken; {_declare(better)}"
        )
        other = diagnosed(catalogue, better)
        return replace(other, warnings=(words, *other.warnings)) if other.status == "none" else found
    if not has_half_a_sample(found):
        return found
    if _explains(found):
        keys = {one.effect for one in found.findings}
        if not _better(diagnosed({key: effect for key, effect in catalogue.items() if key in keys}), found):
            return found
    other = diagnosed(catalogue)
    if not _better(other, found):
        return found
    words = (
        f"the inputs are declared {declared}, but as {hold} the records need {_named(other)} instead of "
        f"{_named(found)}, so that is what was taken; {_declare(hold)}"
    )
    return replace(other, warnings=(words, *other.warnings))


def _declare(hold: InputHold) -> str:
    return f'declare input_hold="{hold}" (in the command --hold {hold})'


def _leaves_an_input(found: Diagnosis) -> bool:
    """Whether nothing is found, and what the calibrated model leaves at the floor is made by an input."""
    return not found.findings and found.status == "unresolved" and _explains(found) and _made_by_input(found)


def _made_by_input(found: Diagnosis) -> bool:
    """Whether what is left is no noise, and most likely depends on an input."""
    worst = found.lack_of_fit[:1]
    return any(one.kind == "input" and one.p_value < UNLIKELY and one.size > FOLLOWED for one in worst)


def _better(other: Diagnosis, found: Diagnosis) -> bool:
    if not (_explains(other) and _explains(found)):
        return _explains(other)
    if _n_besides(other) != _n_besides(found):
        return _n_besides(other) < _n_besides(found)
    if _made_by_input(other) != _made_by_input(found):
        return _made_by_input(found)
    return AT_FLOOR * other.steps[-1].held_out_level < found.steps[-1].held_out_level


def _explains(found: Diagnosis) -> bool:
    return explained(found.steps[-1].held_out_level)


def _n_besides(found: Diagnosis) -> int:
    """How many effects were found beside delays."""
    return sum(one.effect != "input_delay" for one in found.findings)


def _named(found: Diagnosis) -> str:
    return effects_at([(one.effect, one.where) for one in found.findings]) or "no effect"


MOST_OF_IT = 0.95
"""Call that frequency the highest that matters below which this share of an output's power above the noise lies."""


def _highest_above_noise(records: tuple[Record, ...], floor: FloatArray) -> float:
    """Frequency [Hz] below which nearly all of the outputs' power above the noise lies; 0 where there is none.

    Args:
        records: Measured.
        floor: (n_records, n_outputs) variance of the noise.
    """
    highest = 0.0
    for record, noise in zip(records, floor, strict=True):
        centred = np.nan_to_num(record.outputs - np.nanmean(record.outputs, axis=0))
        power = np.square(np.abs(np.fft.rfft(centred * np.hanning(len(centred))[:, np.newaxis], axis=0)))
        above = power / power.sum(axis=0).clip(min=np.finfo(float).tiny) * centred.var(axis=0) - noise / len(power)
        total = above.sum(axis=0)
        reached = np.cumsum(above, axis=0) >= MOST_OF_IT * total
        lines = np.argmax(reached, axis=0)[total > 0.0]
        highest = max(highest, float(lines.max(initial=0)) / (record.n_samples * record.dt))
    return highest


def hold_words(diagnosis: Diagnosis) -> str:
    """What to check of the declared hold; "" where it cannot matter or nothing is left that it could explain."""
    first = diagnosis.fit[0]
    if not first.n_inputs:
        return ""
    frequency = _highest_above_noise(diagnosis.fit, np.asarray(diagnosis.noise_floor.variance)[: len(diagnosis.fit)])
    shift = np.pi * frequency * first.dt
    unexplained = (not _explains(diagnosis) or _made_by_input(diagnosis)) and not _left_over(diagnosis) > shift
    if shift == 0.0 or not (unexplained or has_half_a_sample(diagnosis)):
        return ""
    other = other_hold(first.input_hold)
    why = "was held by its source" if other == "zero_order" else "was measured rather than set"
    return (
        f"Check the hold: the motion reaches up to {number(frequency)} Hz, {number(1.0 / (frequency * first.dt), 2)} "
        f"samples a period, and the input is declared {first.input_hold}. If it {why}, {_declare(other)}: "
        "a wrong hold looks like half a sample of delay, or like damping."
    )


def _left_over(diagnosis: Diagnosis) -> float:
    """Size of the held-out gap above the noise, as a share of the motion's."""
    noise = np.asarray(diagnosis.noise_floor.variance)[len(diagnosis.fit) :]
    above = np.maximum(np.square(diagnosis.gap_after) - noise, 0.0)
    motion = np.array([np.nanvar(record.outputs, axis=0) for record in diagnosis.held_out])
    return float(np.sqrt(above.sum() / motion.sum()))


PERIODS = 20.0
"""Make a span so many periods of the highest frequency that matters long."""
FEWEST_SAMPLES = 200
"""Make no span shorter than so many samples."""


def cut_into_spans(
    records: Sequence[Record], floor: FloatArray, *, fewest: int = 1
) -> tuple[tuple[Record, ...], tuple[int, ...]]:
    """Each record in spans of about equal length, in each of which every output is measured somewhere.

    Args:
        records: Whole ones.
        floor: (n_records, n_outputs) variance of their noise.
        fewest: Samples that a span must have.

    Returns:
        The spans, in order, and of each the position of its record.

    References:
        Bock, Recent advances in parameter identification techniques for ODE, 1983 (multiple shooting),
        https://doi.org/10.1007/978-1-4684-7324-7_7

    Example:
        >>> time = 0.01 * np.arange(2000)
        >>> record = Record(np.ones(2000), np.sin(2 * np.pi * 4.0 * time), 0.01, name="run")
        >>> spans, origin = cut_into_spans([record], np.array([[1e-9]]))
        >>> [(one.name, one.n_samples) for one in spans], origin
        ([('run, span 1', 500), ('run, span 2', 500), ('run, span 3', 500), ('run, span 4', 500)], (0, 0, 0, 0))
    """
    frequency = max(_highest_above_noise(tuple(records), floor), 1e-12)
    wanted = max(PERIODS / (frequency * records[0].dt), fewest, FEWEST_SAMPLES)
    spans: list[Record] = []
    origin: list[int] = []
    for position, record in enumerate(records):
        edges = _edges(record, max(int(record.n_samples / wanted), 1))
        own = [record.samples(first, last) for first, last in pairwise(edges)]
        if len(own) > 1:
            name = f"{record.name}, span" if record.name else "span"
            own = [replace(span, name=f"{name} {i + 1}") for i, span in enumerate(own)]
        spans += own
        origin += [position] * len(own)
    return tuple(spans), tuple(origin)


def _edges(record: Record, count: int) -> list[int]:
    """Where spans begin and end; fewer of them where one would lack an output throughout."""
    for fewer in range(count, 1, -1):
        edges = [int(edge) for edge in np.linspace(0, record.n_samples, fewer + 1)]
        if not any(np.isnan(record.outputs[first:last]).all(axis=0).any() for first, last in pairwise(edges)):
            return edges
    return [0, record.n_samples]


def span_words(spans: Sequence[Record]) -> str:
    """What the reader must know of spans."""
    longest = max(span.n_samples for span in spans)
    return (
        "no simulation can follow this motion along a whole record, because it parts from its neighbours too fast "
        f"(chaos, or many impacts): the records were cut into spans of up to {longest} samples "
        f"({number(longest * spans[0].dt, 2)} s), each with an initial state of its own"
    )
