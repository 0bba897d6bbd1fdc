"""Is a mode a line or an image of one? Samples that were measured in some rows only may not tell.

Rows m (0 or 1) turn what moves into m y, and every line of it stands once more wherever the spectrum of m has a line of
its own: at every second row at half the sampling rate from where it is. Whether two poles can be told apart is a
question to m alone; which of them is one, to what was measured, never to what filled the rest.

What always moves is asked in its spectrum: with r the correlation of the rows with themselves, a mode of decay rate c
and angular frequency w, of power a in an output, shows there as

    a F[ r(l) exp(-c |l| dt) cos(w l dt) ],        F over lags l,

and outputs that measure in other rows show other sums of the same lines. From the highest mode down, one that the rest
explains as well is an image of them, where with every row measured it would not be explained: by the likelihood of
exponentially distributed powers, by Schwarz, its misfit counted in that of all lines. What rings down is asked in its
samples, with an image in the place of its line.

Where nothing tells them apart the lowest stands, as in any record: it is taken for granted there that a sensor hears
nothing above half of the rate at which it is read (`told_below`).

References:
    Scargle, Astrophysical Journal 263, 1982, doi 10.1086/160554 (spectra of samples missing: the window's lines).
    Fevotte, Bertin, Durrieu, Neural Computation 21(3), 2009, doi 10.1162/neco.2008.04-08-771 (its updates).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from modal.modes.mode import ModalModel, Mode
from modal.verdict.judgement import doubted
from modal.wording.text import hertz
from okid.arrays import TINY, BoolArray, ComplexArray, FloatArray
from okid.record import Record
from okid.rows import spread_stretches

WHY_IMAGE = "images of other lines at the rows that were measured explain it as well"
ALIKE_ROWS = 0.5
"""Look for an image of a line where rows tell it from the line by half or less of what they tell of both."""
SEEN_AGAIN = 0.03
"""Ask nothing where rows show no line again with so much of its power: a gap is spread over all frequencies."""
HARDLY_READ = 0.1
"""Let no output tell rows apart that was read in less than this share of the rows of the one that was read most."""
MOST_IMAGES = 64
"""Look at so many images of a line at most."""
BESIDE = (4.0, 12.0)
"""Take what stands so many half-widths from a line for what it stands on."""
LINES_A_VALUE = 3.0
"""Count so many neighbouring lines of a padded Hann spectrum for one value: twice too many, and 1.5 lines wide."""
ROUNDS, FEW_ROUNDS, NOTHING = 100, 40, 1e-3
"""Take so many steps to the powers of the lines from equal ones, so many from those of one line more or less, which are
raised by so much of the largest: the likelihood has settled to a tenth."""
MOST_ROWS = 30_000
"""Take the spectrum of so many rows at most."""


def told_below(measured: Sequence[BoolArray], dt: float) -> float:
    """Frequency [Hz] above which no output tells a line from an image below.

    That is half the sampling rate where some output was measured in all rows, or in rows without an order.

    Example:
        >>> rows = np.arange(1000)[:, np.newaxis]
        >>> by_turns = np.hstack([rows % 2 == 0, rows % 2 == 1])
        >>> told_below([by_turns], 0.01), told_below([by_turns | (rows % 3 == 0)], 0.01)
        (25.0, 50.0)
    """
    turns = [_turns(np.square(np.abs(np.fft.rfft(own * 1.0, axis=0).T)), own.shape[0], apart=4.0) for own in measured]
    return min((0.5 * one for turn in turns for one in turn), default=0.5) / dt


def apart_in_spectra(modes: ModalModel, records: Sequence[Record], measured: Sequence[BoolArray]) -> ModalModel:
    """The modes, doubtful where images of others explain what stands there.

    Args:
        modes: judged, of records that move all the time.
        records: that they were identified from.
        measured: (n_samples, n_outputs) a record, False where a sample was filled.
    """
    seen = [
        replace(record, outputs=np.where(there, record.outputs, np.nan))
        for record, there in zip(records, measured, strict=True)
    ]
    spectra = _spectra(spread_stretches(seen, MOST_ROWS, count=len(records)))
    told, lines = list(modes.modes), _lines(modes.modes, spectra)
    if not lines:
        return modes
    fit = _Bands.of(lines, spectra)
    price, alive = np.log(spectra.grid.size), np.ones(fit.makes.shape[2], dtype=np.bool_)
    frequencies = np.array([one.frequency for one in lines])
    twins = np.abs(np.subtract.outer(frequencies, frequencies)) <= BESIDE[0] * fit.half[:, np.newaxis]
    twins &= np.array([one.index is None for one in lines])  # for which a line of the model stands nearby
    whole = np.broadcast_to(fit.whole, fit.makes.shape)
    exact = 2.0 * (fit.count * (np.log(fit.seen) + 1.0)).sum(axis=1)
    for k in np.argsort(-frequencies, kind="stable").tolist():
        index = lines[k].index
        rivals = alive.copy()
        if index is not None:
            rivals[: len(lines)] &= ~twins[k]
        without = rivals & (np.arange(alive.size) != k)
        rivals[k] = True
        least, sizes = _fitted(fit.makes, fit.seen, fit.count, rivals)
        spread = np.maximum(1.0, (least - exact) / max(1, fit.count.size - int(rivals.sum())))
        lost, _ = _fitted(fit.makes, fit.seen, fit.count, without, sizes)
        if ((lost - least) / spread > price).any():
            continue
        alone = sizes.copy()
        alone[:, k] = fit.seen[:, fit.place[k]] / max(float(fit.whole[fit.place[k], k]), TINY)
        wanted = np.maximum(np.einsum("ec,oc->oe", fit.whole, alone), TINY)
        told_apart = _fitted(whole, wanted, fit.count, without)[0] - _fitted(whole, wanted, fit.count, rivals)[0]
        if index is None or (told_apart > price).any():
            alive[k] = False
            told = _told(told, lines, twins, k)
    return replace(modes, modes=tuple(told))


def _told(modes: Sequence[Mode], lines: Sequence["_Line"], twins: BoolArray, k: int) -> list[Mode]:
    """The modes with line k told as an image; the certain ones whose images stand there say that it fits as well."""
    told, index = list(modes), lines[k].index
    if index is None:
        return told
    if told[index].verdict == "system":
        told[index] = doubted(told[index], WHY_IMAGE)
    owners = {lines[j].of for j in np.flatnonzero(twins[k]).tolist()}
    for i in range(len(told)):
        if i in owners and told[i].verdict == "system" and told[i].frequency < lines[k].frequency:
            text = (
                f"{told[i].reason}; at these rows {hertz(lines[k].frequency)} Hz fits as well, and the lower is taken"
            )
            told[i] = replace(told[i], reason=text)
    return told


def poles_of_images(pole: complex, answers: Sequence[ComplexArray], there: Sequence[BoolArray]) -> list[complex]:
    """Discrete poles that may fit what rings down as well as the one that is given, in the rows of every output.

    Args:
        pole: of a pair.
        answers: (n_samples,) of it to the inputs, a record.
        there: (n_samples, n_outputs) True where an output was measured.

    Example:
        >>> rows = np.arange(400)
        >>> there = np.stack([rows % 2 == 0, rows % 2 == 1], axis=1)
        >>> pole = 0.99 * np.exp(0.2j * np.pi)  # a tenth of the sampling rate
        >>> [round(float(np.angle(one)) / np.pi, 2) for one in poles_of_images(pole, [pole**rows], [there])]
        [0.8]
    """
    n = 2 ** int(np.ceil(np.log2(4 * max(len(answer) for answer in answers))))
    seen = np.zeros((there[0].shape[1], n // 2 + 1))
    for answer, rows in zip(answers, there, strict=True):
        seen += np.abs(np.fft.rfft(np.square(np.abs(answer))[:, np.newaxis] * rows, n, axis=0)).T
    width = max(-np.log(max(abs(pole), TINY)) / np.pi, 1.0 / max(len(answer) for answer in answers))
    turns = _turns(np.square(seen), n, apart=BESIDE[0] * width * n)
    frequency = float(np.angle(pole)) / (2.0 * np.pi)
    images = sorted({image for turn in turns for image in _images(frequency, turn)})
    return [abs(pole) * np.exp(2j * np.pi * image) for image in images]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Spectra:
    """Of what was measured alone, through a Hann window.

    Attributes:
        grid: (n_lines,) [Hz].
        power: (n_outputs, n_lines) squares.
        rows: (n_outputs, n_lines) squares of the window where the output was measured, through it.
        window: (n_lines,) squares of the whole window.
        finest: [Hz] that it resolves.
    """

    grid: FloatArray
    power: FloatArray
    rows: FloatArray
    window: FloatArray
    finest: float


def _spectra(records: Sequence[Record]) -> _Spectra:
    longest, n_outputs, dt = max(record.n_samples for record in records), records[0].n_outputs, records[0].dt
    n = 2 ** int(np.ceil(np.log2(2 * longest)))
    power, rows, whole = (np.zeros((count, n // 2 + 1)) for count in (n_outputs, n_outputs, 1))
    for record in records:
        there = np.isfinite(record.outputs)
        values = np.nan_to_num(record.outputs)
        values = np.where(there, values - values.sum(axis=0) / np.maximum(1, there.sum(axis=0)), 0.0)
        window = np.hanning(record.n_samples + 2)[1:-1, np.newaxis]
        power += np.square(np.abs(np.fft.rfft(values * window, n, axis=0).T))
        rows += np.square(np.abs(np.fft.rfft(there * window, n, axis=0).T))
        whole += np.square(np.abs(np.fft.rfft(window, n, axis=0).T))
    told = power.any(axis=1)
    return _Spectra(
        grid=np.fft.rfftfreq(n, dt).astype(np.float64),
        power=power[told],
        rows=rows[told],
        window=whole[0],
        finest=1.0 / (longest * dt),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Line:
    """A mode of the model, or an image of the mode `of`: no mode."""

    frequency: float
    decay: float
    index: int | None
    of: int | None = None


def _lines(modes: Sequence[Mode], spectra: _Spectra) -> list[_Line]:
    """The modes that may be seen and images that they may be of; none where rows show no line again."""
    lines = [
        _Line(frequency=one.frequency, decay=max(0.0, -one.pole.real), index=i)
        for i, one in enumerate(modes)
        if one.verdict != "noise" and one.kind == "oscillatory" and one.frequency < spectra.grid[-1]
    ]
    n, rate = 2 * (spectra.grid.size - 1), 2.0 * spectra.grid[-1]
    lags = np.minimum(np.arange(n), n - np.arange(n)) / rate
    rows = np.fft.irfft(np.vstack([spectra.rows, spectra.window]), n, axis=1)
    again = False
    for one in list(lines) if len(spectra.rows) else ():
        if one.index is None or modes[one.index].verdict != "system":
            continue
        *seen, alone = np.fft.rfft(rows * np.exp(-one.decay * lags), axis=1).real
        shares = np.array([own / own[0] for own in seen])
        width = max(one.decay / (2.0 * np.pi), spectra.finest)
        far = spectra.grid > BESIDE[0] * width
        again = again or bool((shares - alone / alone[0])[:, far].max(initial=0.0) > SEEN_AGAIN)
        for turn in _turns(np.array(seen), n, apart=BESIDE[0] * width * n / rate):
            lines += [
                _Line(frequency=rate * f, decay=one.decay, index=None, of=one.index)
                for f in _images(one.frequency / rate, turn)
            ]
    return lines if again else []


def _images(frequency: float, turn: float) -> list[float]:
    """A line moved up and down by a turn, folded back to 0 ... 0.5 [1 / sample]."""
    return sorted({min(image % 1.0, 1.0 - image % 1.0) for image in (frequency + turn, frequency - turn)})


def _turns(seen: FloatArray, n: int, *, apart: float) -> list[float]:
    """Where rows show a line again in every output that was read often, from `apart` lines on [1 / sample].

    The clearest ones, at most `MOST_IMAGES`.

    Args:
        seen: (n_outputs, n // 2 + 1) power at each distance from a line, at first of the line itself.
        n: samples of the padded transform.
        apart: lines of it within which it is the same line.
    """
    heard = seen[seen[:, 0] >= HARDLY_READ**2 * max(TINY, seen[:, 0].max(initial=0.0))]
    share = (heard / heard[:, :1]).min(axis=0, initial=1.0) if len(heard) else np.zeros(seen.shape[1])
    padded = np.pad(share, 1, constant_values=-1.0)
    peaks = (padded[1:-1] >= padded[:-2]) & (padded[1:-1] > padded[2:]) & (share > ALIKE_ROWS)
    found = np.flatnonzero(peaks & (np.arange(share.size) > apart))
    return (found[np.argsort(-share[found], kind="stable")][:MOST_IMAGES] / n).tolist()


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Bands:
    """What stands at each line and on either side of it, and what a line of power 1 makes of that.

    Attributes:
        half: (n,) half widths of the lines [Hz].
        count: (n_bands,) how many values each band's mean is of.
        place: (n,) which band is that of a line itself.
        seen: (n_outputs, n_bands) mean power, over that of all.
        makes: (n_outputs, n_bands, 2 n) of the lines, then of a level at each of them.
        whole: (n_bands, 2 n) the same if all rows were measured.
    """

    half: FloatArray
    count: FloatArray
    place: NDArray[np.intp]
    seen: FloatArray
    makes: FloatArray
    whole: FloatArray

    @classmethod
    def of(cls, lines: Sequence[_Line], spectra: _Spectra) -> "_Bands":
        n, grid = 2 * (spectra.grid.size - 1), spectra.grid
        lags = np.minimum(np.arange(n), n - np.arange(n)) / (2.0 * grid[-1])
        half = np.maximum([one.decay / (2.0 * np.pi) for one in lines], spectra.finest)
        bands = []
        for one, width in zip(lines, half.tolist(), strict=True):
            away = (grid - one.frequency) / width
            sides = [(sign * away >= BESIDE[0]) & (sign * away <= BESIDE[1]) for sign in (-1.0, 1.0)]
            bands += [np.abs(away) <= 1.0, *sides]
        inside = np.array(bands)
        there = inside.any(axis=1)
        first, n_inside = inside[there].argmax(axis=1), inside[there].sum(axis=1)  # each is of one piece

        def means(values: FloatArray) -> FloatArray:
            sums = np.concatenate([np.zeros((*values.shape[:-1], 1)), np.cumsum(values, axis=-1)], axis=-1)
            return (sums[..., first + n_inside] - sums[..., first]) / n_inside

        levels = np.repeat(np.eye(len(lines)), 3, axis=0)[there]
        waves = [np.exp(-one.decay * lags) * np.cos(2.0 * np.pi * one.frequency * lags) for one in lines]

        def made(rows: FloatArray) -> FloatArray:
            """Of each line, its largest part 1; rows by their correlation."""
            shown = np.array([means(np.fft.rfft(rows * wave).real) for wave in waves]).T
            return np.hstack([np.maximum(shown, 0.0) / np.maximum(shown.max(axis=0), TINY), levels])

        seen = means(spectra.power)
        patterns, which = np.unique(spectra.rows, axis=0, return_inverse=True)
        return cls(
            half=half,
            count=n_inside / LINES_A_VALUE,
            place=np.cumsum(there)[::3] - 1,
            seen=np.maximum(seen / np.maximum(seen.mean(axis=1, keepdims=True), TINY), TINY),
            makes=np.array([made(own) for own in np.fft.irfft(patterns, n, axis=1)])[which.ravel()],
            whole=made(np.fft.irfft(spectra.window, n)),
        )


def _fitted(
    makes: FloatArray, seen: FloatArray, count: FloatArray, free: BoolArray, start: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """(n_outputs,) -2 log likelihood of exponentially distributed powers, and the sizes of those that are free.

    By multiplicative updates, which leave no size negative, from equal sizes or from near those given.
    """
    own = makes[:, :, free]
    sizes = np.full((len(own), own.shape[2]), 1.0 / own.shape[2])
    if start is not None:
        sizes = start[:, free] + NOTHING * start.max(axis=1, keepdims=True)  # what is zero would stay so
    turned = np.ascontiguousarray(own.transpose(0, 2, 1))
    for _ in range(ROUNDS if start is None else FEW_ROUNDS):
        mean = np.maximum((own @ sizes[:, :, np.newaxis])[:, :, 0], TINY)
        weights = np.stack([count * seen / mean**2, count / mean], axis=2)
        up, down = np.moveaxis(turned @ weights, 2, 0)
        sizes = sizes * up / np.maximum(down, TINY)
    mean = np.maximum((own @ sizes[:, :, np.newaxis])[:, :, 0], TINY)
    every = np.zeros((len(own), free.size))
    every[:, free] = sizes
    return 2.0 * (count * (np.log(mean) + seen / mean)).sum(axis=1), every
