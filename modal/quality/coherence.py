"""How much of each output the inputs explain, in which bands little, and whether the segments are to blame.

Segments that are short beside the decay of a resonance leak: coherence is low and nothing is wrong. So two lengths are
tried, and where both leave much unexplained a pulse response in the time domain has the last word.

Multiple coherence from K segments is positive by chance: without any relation its mean is n_inputs / K_e with K_e the
number of independent segments (Carter, Knapp, Nuttall, IEEE Transactions on Audio and Electroacoustics 21(4), 1973,
337-344, doi 10.1109/TAU.1973.1162496); half-overlapped Hann segments count as K / 1.056 (Welch 1967, doi
10.1109/TAU.1967.1161901: variance 19/18 of that of as many independent ones).

That pulse response is the one of a long observer, without a model order: it costs hundredths of a second where a model
costs seconds, and is good enough to tell what the inputs explain from what they do not. It is never an answer.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from modal.modes.response_synthesis import MeasuredFrf
from modal.preparation.channel import FITTED_ROWS, HARDLY, MOSTLY, NEARLY_ALL, NOTABLE, Finding, Level, named, spoken
from modal.wording.text import percent
from okid.arrays import BoolArray, FloatArray
from okid.errors import IdentificationError
from okid.gram import lag_gram
from okid.least_squares import solve
from okid.markov import recover_system
from okid.record import Record
from okid.rows import runs_of
from okid.scaling import channel_scaling

OBSERVERS = ((512, 1e-6), (128, 1e-6), (128, 1e-3), (32, 1e-6))
"""Try observers of so many coefficients an output and such a ridge: a transient wants another one than noise."""

LARGEST_PULSE = 1e6
"""Refuse a pulse response that is larger, in standard deviations of the output for one of the input: it diverges."""

GROUP = 4
"""Let so many outputs share one observer; of more it would be too short for a resonance."""

FEW_EVENTS = 4.0
"""Blame no channel where the inputs have their energy in fewer blocks of the records: chance decides the coherence."""

N_BLOCKS = 16
"""Count the events of a record over so many blocks."""


def whole_rows(records: Sequence[Record]) -> Record | None:
    """The longest run of complete rows of the longest record, at most 6000, means removed; None where it is short."""
    longest = max(records, key=lambda record: record.n_samples)
    start, stop = max(runs_of(longest.complete_rows()), key=lambda run: run[1] - run[0], default=(0, 0))
    if stop - start < 20 * (longest.n_inputs + longest.n_outputs):
        return None
    return longest.samples(start, min(stop, start + FITTED_ROWS)).detrended(0)


def fitted_pulse_response(record: Record, *, n_unknowns: int, ridge: float) -> tuple[FloatArray, int] | None:
    """(n_samples, n_outputs, n_inputs) of outputs to a unit pulse, and how many numbers of an output were fitted.

    Args:
        record: means removed, nothing missing.
        n_unknowns: coefficients of an output's equation, at most.
        ridge: of the fit, for channels of unit size.

    Returns:
        None where the response diverges or a channel is constant.

    Example:
        >>> force = np.random.default_rng(0).standard_normal(900)
        >>> record = Record(force, np.convolve(force, [0.0, 1.0, 0.5])[:900], 0.01)
        >>> pulse, n_fitted = fitted_pulse_response(record, n_unknowns=64, ridge=1e-6)
        >>> pulse[:4].ravel().round(3) + 0.0
        array([0. , 1. , 0.5, 0. ])
    """
    n_channels = record.n_inputs + record.n_outputs
    order = max(1, min(n_unknowns, record.n_samples // 6) // n_channels)  # rows a coefficient, at least
    scaling = channel_scaling([record])
    if scaling.constant_inputs or scaling.constant_outputs:
        return None
    try:
        fit = solve(lag_gram([record], order, scaling=scaling), ridge)
    except (IdentificationError, np.linalg.LinAlgError):
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        pulse = recover_system(fit.feedthrough, fit.input_coefficients, fit.output_coefficients, record.n_samples - 1)
    if not np.abs(pulse).max() < LARGEST_PULSE:  # nan is not below either
        return None
    size = scaling.output_scale[:, np.newaxis] / scaling.input_scale
    return np.asarray(pulse * size, dtype=np.float64), record.n_inputs + order * n_channels


def best_pulse(record: Record) -> tuple[FloatArray, FloatArray] | None:
    """Of a few observers the pulse response that explains most, and the share of each output's power that it explains.

    What is left counts more by as much as the fitted numbers took of it.

    Returns:
        (n_samples, n_outputs, n_inputs) and (n_outputs,); None where every response diverges or a channel is constant.
    """
    power = np.maximum(record.outputs.var(axis=0), np.finfo(float).tiny)
    best: tuple[FloatArray, FloatArray] | None = None
    for n_unknowns, ridge in OBSERVERS:
        found = fitted_pulse_response(record, n_unknowns=n_unknowns, ridge=ridge)
        if found is None:
            continue
        pulse, n_fitted = found
        left = record.outputs - predicted_outputs(pulse, record.inputs)
        shares = 1.0 - left.var(axis=0) / (1.0 - n_fitted / record.n_samples) / power
        if best is None or shares.sum() > best[1].sum():
            best = pulse, shares
    return best


def predicted_outputs(pulse: FloatArray, inputs: FloatArray) -> FloatArray:
    """(n_samples, n_outputs) answer to the inputs from rest.

    Args:
        pulse: (n_lags, n_outputs, n_inputs).
        inputs: (n_samples, n_inputs).
    """
    n_samples = len(inputs)
    size = 1 << (len(pulse) + n_samples).bit_length()
    spectrum = np.einsum("fqm,fm->fq", np.fft.rfft(pulse, size, axis=0), np.fft.rfft(inputs, size, axis=0))
    return np.asarray(np.fft.irfft(spectrum, size, axis=0)[:n_samples], dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Shares:
    """How much of the outputs' power the inputs explain.

    Attributes:
        spectra: (n_outputs,) by multiple coherence in excess of chance, nan where not known.
        modelled: (n_outputs,) by a pulse response, nan where it was not asked or there is none.
    """

    spectra: FloatArray
    modelled: FloatArray

    @property
    def explained(self) -> FloatArray:
        """(n_outputs,) the larger of the two, nan where neither is known."""
        return np.asarray(np.fmax(self.spectra, self.modelled), dtype=np.float64)


def in_excess_of_chance(coherence: FloatArray, n_averages: int, n_inputs: int) -> FloatArray:
    """Multiple coherence less what chance gives: 0 without a relation (on average), 1 where all is explained.

    Example:
        >>> in_excess_of_chance(np.array([0.25, 1.0]), 8, 2).round(3).tolist()
        [-0.019, 1.0]
    """
    chance = min(0.999, n_inputs * 1.056 / n_averages)
    return np.asarray((coherence - chance) / (1.0 - chance), dtype=np.float64)


def explained_share(frf: MeasuredFrf, power: FloatArray) -> FloatArray:
    """(n_outputs,) power-weighted multiple coherence in excess of chance; nan where no line is known.

    Args:
        frf: with coherences.
        power: (n_frequencies, n_outputs) of the outputs.
    """
    excess = in_excess_of_chance(frf.multiple_coherence, frf.n_averages, frf.frf.shape[2])
    known = np.isfinite(excess)
    known[0] = False
    weight = np.where(known, power, 0.0)
    total = weight.sum(axis=0)
    with np.errstate(invalid="ignore"):
        share = (weight * np.where(known, excess, 0.0)).sum(axis=0) / total
    return np.where(total > 0.0, share, np.nan)


def modelled_share(records: Sequence[Record]) -> FloatArray:
    """(n_outputs,) share of the outputs' power that a pulse response explains from the inputs alone.

    The pulse response is that of a long observer fitted to at most 6000 whole rows of the longest record; what is left
    counts more by as much as the fitted numbers took of it.

    Returns:
        nan where too few rows are whole, the output or every input is constant, or the pulse response diverges.
    """
    n_outputs = records[0].n_outputs
    shares = np.full(n_outputs, np.nan)
    part = whole_rows(records)
    if part is None:
        return shares
    scaling = channel_scaling([part])
    inputs = [i for i in range(part.n_inputs) if i not in scaling.constant_inputs]
    moving = [i for i in range(n_outputs) if i not in scaling.constant_outputs]
    for start in range(0, len(moving) if inputs else 0, GROUP):
        outputs = moving[start : start + GROUP]
        found = best_pulse(part.select(inputs=inputs, outputs=outputs))
        if found is not None:
            shares[outputs] = found[1]
    return shares


def coherence_findings(
    records: Sequence[Record], frf: MeasuredFrf, power: FloatArray, shares: Shares, which: Sequence[int]
) -> list[Finding]:
    """Outputs of which the inputs explain little.

    Args:
        records: of one system.
        frf: with coherences.
        power: (n_frequencies, n_outputs).
        shares: what is explained.
        which: indices of the outputs to judge.
    """
    record = records[0]
    few_events = _n_events(records) < FEW_EVENTS
    unexplained: dict[Level, list[int]] = {"bad": [], "doubtful": [], "note": []}
    leaking: list[int] = []
    for i in which:
        if not shares.spectra[i] < NEARLY_ALL:
            continue
        if 1.0 - shares.modelled[i] < MOSTLY * (1.0 - shares.spectra[i]):
            leaking.append(i)
            continue
        share = shares.explained[i]
        if few_events:  # one transient tells too little of the system to blame the channel
            unexplained["note"].append(i)
            continue
        unexplained["bad" if share < HARDLY else "doubtful" if share < MOSTLY else "note"].append(i)
    found = [
        _unexplained(record, level, outputs, shares.explained, _low_bands(frf, power, outputs, shares.explained))
        for level, outputs in unexplained.items()
        if outputs
    ]
    if few_events:
        found = [replace(finding, sentence=_few_events_sentence(finding.sentence)) for finding in found]
    return [*found, *_leakage(record, frf, shares, leaking)]


def _unexplained(
    record: Record, level: Level, which: Sequence[int], explained: FloatArray, bands: Sequence[tuple[float, float]]
) -> Finding:
    """One sentence for all outputs of a level."""
    names = tuple(record.output_names[i] for i in which)
    least, most = (max(0.0, float(f(explained[list(which)]))) for f in (np.min, np.max))
    how_much = percent(least) if percent(least) == percent(most) else f"{percent(least)[:-2]} to {percent(most)}"
    where = f", least in {_band_words(bands)}" if bands else ""
    todo = {
        "bad": "expect nothing of a fit before what drives it is measured as well, or the wiring is put right.",
        "doubtful": "measure what else drives it, or expect little of a fit.",
        "note": "a longer record averages noise away, a test at another level shows a nonlinearity.",
    }[level]
    return Finding(
        level=level,
        what="low coherence",
        where=named(names),
        sentence=f"the inputs explain {how_much} of the power of output{'s' * (len(names) > 1)} "
        f"{named(names)}{where}: the rest is noise, forces that were not measured, or a nonlinearity; {todo}",
        channels=names,
        share=1.0 - least,
    )


def _few_events_sentence(sentence: str) -> str:
    """What coherence says of records whose inputs move in few places: next to nothing."""
    return (
        f"{sentence.partition(': the rest is')[0]}, but the inputs change in few places, so chance decides that share: "
        "judge by the fit, or measure with inputs that move all the time."
    )


def _n_events(records: Sequence[Record]) -> float:
    """In how many of sixteen blocks a record the inputs' steps from sample to sample have their energy, about."""
    energies = []
    for record in records:
        steps = np.nan_to_num(np.diff(record.inputs, axis=0))
        size = max(1, len(steps) // N_BLOCKS)
        energy = np.add.reduceat(np.square(steps), np.arange(0, max(1, len(steps)), size), axis=0)
        energies.append(energy[:N_BLOCKS] / np.maximum(energy.sum(axis=0), np.finfo(float).tiny))
    every = np.concatenate(energies)
    return float((every.sum(axis=0) ** 2 / np.maximum(np.square(every).sum(axis=0), np.finfo(float).tiny)).min())


def _leakage(record: Record, frf: MeasuredFrf, shares: Shares, leaking: Sequence[int]) -> list[Finding]:
    if not leaking:
        return []
    names = tuple(record.output_names[i] for i in leaking)
    worst = min(leaking, key=lambda i: float(shares.spectra[i]))
    before = max(0.0, float(shares.spectra[worst]))
    return [
        Finding(
            level="note",
            what="leakage",
            where=named(names),
            sentence=f"measured coherence explains {percent(before)} of {named(record.output_names[worst])}"
            f"{f', the least of {len(names)}' if len(names) > 1 else ''}, and a first model "
            f"{percent(float(shares.modelled[worst]))}: the answer to the input outlasts the segments of "
            f"{spoken(1.0 / float(frf.frequencies[1]))} s that the record allows, so measured frequency responses are "
            "smeared; the identification, which works on the time histories, is not affected.",
            channels=names,
            share=1.0 - before,
        )
    ]


def _low_bands(
    frf: MeasuredFrf, powers: FloatArray, outputs: Sequence[int], explained: FloatArray
) -> list[tuple[float, float]]:
    """The bands of the worst of some outputs with the most unexplained power among lines that matter."""
    worst = min(outputs, key=lambda i: float(explained[i]))
    coherence, power = frf.multiple_coherence[:, worst], powers[:, worst]
    low: BoolArray = np.asarray((power > NOTABLE * power[1:].max()) & ~(coherence >= MOSTLY), dtype=np.bool_)
    low[0] = False
    lost = np.where(low, power, 0.0)
    for start, stop in runs_of(~low)[1:-1]:
        if stop - start < 4:  # lines between two bands that are named as one
            low[start:stop] = True
    runs = sorted(runs_of(low), key=lambda run: -float(lost[run[0] : run[1]].sum()))[:3]
    step = float(frf.frequencies[1])
    return sorted((max(0.0, (a - 0.5) * step), (b - 0.5) * step) for a, b in runs)


def _band_words(bands: Sequence[tuple[float, float]]) -> str:
    return ", ".join(f"{spoken(low)} to {spoken(high)} Hz" for low, high in bands)
