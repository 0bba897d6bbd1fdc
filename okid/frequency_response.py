"""Frequency responses: as a table, from records, and back to the pulse response that the realisation needs.

A response is output over input, Y(f) / U(f), with motion as exp(+2 pi j f t). What windowed blocks of n samples w(t)
give is not the response of the system but, for inputs that are white over a resonance,

    E[S_yu] / S_uu = sum over lags of h(tau) r_w(tau) exp(-2 pi j f tau dt),    r_w(tau) = sum w(t) w(t + tau) / sum w^2

so the inverse transform, divided by r_w, is the pulse response h. Blocks of whole periods have r_w = 1 (their pulse
response is wrapped round, which leaves a sum of the same exponentials); an exponential window makes every mode decay
by 1 / tau faster, which is taken back.

References:
    Bendat, Piersol, Random Data, 4th edition, 2010, chapters 7 and 9, doi 10.1002/9781118032428.
    Rocklin, Crowley, Vold, "A comparison of H1, H2, and Hv frequency response functions", IMAC 3, 1985, 272-278.
"""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from okid.arrays import ComplexArray, FloatArray, frozen, real_number, require, time_step, whole_number
from okid.display import Displayed, first_names, table_of_columns
from okid.errors import InsufficientDataError, InvalidDataError, encodable
from okid.least_squares import total_least_squares
from okid.markov import MarkovParameters
from okid.record import Record, check_names, labels
from okid.rows import as_records, runs_of

if TYPE_CHECKING:
    import pyarrow as pa

FEWEST_AVERAGES = 8
"""Leave so many independent segments, about, where nobody says how long one is: coherence needs several."""
LEAST_WINDOW = 0.25
"""Use lags up to which the window's autocorrelation stays above this: what is divided by less is mostly noise (of 12
systems with Hann blocks of 512 to 4096 samples, 1/4 gave damping within 0.2 % in the mean)."""
OFF_GRID = 0.01
"""Refuse lines that lie further off the uniform grid than this share of their spacing: more than rounding in a file."""
LEAST_MEASURED = 0.1
"""Fill no grid of which less than this share was measured: lines that fit one may be rounded numbers."""

ResponseWindow = Literal["hann", "hamming", "flattop", "uniform", "periodic", "exponential", "unknown"]
"""What weighted each block; "periodic": whole periods a block (or an answer that is over at its end), no window."""
Estimator = Literal["H1", "H2", "Hv"]

_COSINES: dict[str, tuple[float, ...]] = {
    "uniform": (1.0,),
    "hann": (0.5, -0.5),
    "hamming": (0.54, -0.46),
    "flattop": (0.21557895, -0.41663158, 0.277263158, -0.083578947, 0.006947368),
}
OVERLAP = {"hann": 0.5, "hamming": 0.5, "flattop": 0.75}
"""Let blocks share so much of their samples unless told, as analysers do; others none."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class FrequencyResponse(Displayed):
    """Response of each output to each input at some frequencies, with what is known about how it was made.

    Attributes:
        response: (n_lines, n_outputs, n_inputs) complex, output unit per input unit, motion as exp(+2 pi j f t); NaN
            where it was not measured. One axis is one output and one input, two axes are outputs of one input.
        frequencies: (n_lines,) increasing [Hz].
        coherence: (n_lines, n_outputs) multiple, or (n_lines, n_outputs, n_inputs) one reference at a time; None where
            it is not known.
        n_averages: number of blocks that were averaged, None where it is not known.
        window: of the blocks. A table of n_lines from 0 Hz comes from blocks of 2 (n_lines - 1) samples.
        window_time_constant: [s], of an exponential window exp(-t / tau) from the start of the block.
        overlap: share of a block that the next one has as well, in [0, 1); None where it is not known.
        input_names: one an input, "input_0", ... unless given.
        output_names: one an output, "output_0", ... unless given.
        input_units: one an input, "" where unknown.
        output_units: one an output; they state the motion: m is displacement, m/s velocity, m/s^2 acceleration.
        name: for messages and reports.

    Raises:
        InvalidDataError: arrays that do not fit together, infinite values, frequencies that do not increase, coherence
            outside [0, 1], or a window that is none.

    Example:
        >>> FrequencyResponse([1.0, 0.5j, -0.1], [0.0, 1.0, 2.0], output_units=["m"], input_units=["N"])
        FrequencyResponse(3 lines from 0 to 2 Hz, inputs ['input_0'], outputs ['output_0'], window unknown)
    """

    response: ComplexArray
    frequencies: FloatArray
    _: KW_ONLY
    coherence: FloatArray | None = None
    n_averages: int | None = None
    window: ResponseWindow = "unknown"
    window_time_constant: float | None = None
    overlap: float | None = None
    input_names: tuple[str, ...] = ()
    output_names: tuple[str, ...] = ()
    input_units: tuple[str, ...] = ()
    output_units: tuple[str, ...] = ()
    name: str = ""

    def __post_init__(self) -> None:
        response = _complex_with_gaps(self.response)
        frequencies = frozen(self.frequencies, name="frequencies", shape=(len(response),))
        if (frequencies < 0).any() or (np.diff(frequencies) <= 0).any():
            raise InvalidDataError("frequencies must be at least 0 and increase from line to line; sort the lines.")
        _, n_outputs, n_inputs = response.shape
        set_ = object.__setattr__
        set_(self, "response", response)
        set_(self, "frequencies", frequencies)
        set_(self, "name", encodable(str(self.name)))
        if self.coherence is not None:
            set_(self, "coherence", _coherence(self.coherence, response.shape))
        if self.n_averages is not None:
            set_(self, "n_averages", whole_number(self.n_averages, name="n_averages", least=1))
        if self.window not in get_args(ResponseWindow):
            raise InvalidDataError(
                f"window must be one of {', '.join(get_args(ResponseWindow))}, but is {self.window!r}."
            )
        constant = None if self.window_time_constant is None else real_number(self.window_time_constant)
        if self.window == "exponential" and constant is None:
            raise InvalidDataError("an exponential window needs its window_time_constant in seconds.")
        if constant is not None and not (np.isfinite(constant) and constant > 0):
            raise InvalidDataError(f"window_time_constant must be positive, but is {self.window_time_constant!r} s.")
        set_(self, "window_time_constant", constant)
        if self.overlap is not None:
            set_(self, "overlap", _share(self.overlap))
        for kind, count in (("input", n_inputs), ("output", n_outputs)):
            set_(self, f"{kind}_names", labels(getattr(self, f"{kind}_names"), count, kind, named=True))
            set_(self, f"{kind}_units", labels(getattr(self, f"{kind}_units"), count, kind, named=False))
        check_names(self.input_names + self.output_names)

    def __repr__(self) -> str:
        first, last = self.frequencies[[0, -1]]
        name = f"{self.name!r}: " if self.name else ""
        return (
            f"FrequencyResponse({name}{self.n_lines} lines from {first:.6g} to {last:.6g} Hz, inputs "
            f"{first_names(self.input_names)}, outputs {first_names(self.output_names)}, window {self.window})"
        )

    @property
    def n_lines(self) -> int:
        """Number of frequencies."""
        return len(self.frequencies)

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        return len(self.output_names)

    @property
    def n_inputs(self) -> int:
        """Number of inputs (references)."""
        return len(self.input_names)

    def to_table(self) -> "pa.Table":
        """A line a row, for pandas, polars or a file: `.to_pandas()`, `polars.from_arrow(table)`.

        Returns:
            Columns frequency [Hz], `tip/hammer re` and `tip/hammer im` of each pair (by numbers where names would not
            stay apart), `tip/hammer coherence` (`tip coherence` where it is multiple); units in the metadata of each.
        """
        columns: dict[str, tuple[Any, str]] = {"frequency": (self.frequencies, "Hz")}
        pairs, parts = np.ndindex(self.n_outputs, self.n_inputs), (self.response.real, self.response.imag)
        names = {(o, i): f"{self.output_names[o]}/{self.input_names[i]}" for o, i in pairs}
        if len(set(names.values())) < len(names):
            names = {(o, i): f"output_{o}/input_{i}" for o, i in names}
        for (o, i), name in names.items():
            out, into = self.output_units[o], self.input_units[i]
            unit = f"{out or 1}/{into if into.isalnum() else f'({into})'}" if into else out
            columns[f"{name} re"], columns[f"{name} im"] = ((part[:, o, i], unit) for part in parts)
        if self.coherence is not None:
            shares = self.coherence.reshape(self.n_lines, -1).T  # of outputs, or one reference at a time
            labelled = names.values() if self.coherence.ndim == 3 else self.output_names
            columns |= {f"{name} coherence": (share, "") for name, share in zip(labelled, shares, strict=True)}
        return table_of_columns(columns)

    def mode_indicator(self) -> FloatArray:
        """Complex mode indicator function (CMIF): singular values of the response at each line, greatest first.

        A peak of the first is a mode; where the second peaks too, two modes lie close together.

        Returns:
            (n_lines, min(n_outputs, n_inputs)) in the units of the response; NaN at a line where one was not measured.

        References:
            Shih, Tsuei, Allemang, Brown, Complex mode indication function and its application to spatial domain
            parameter estimation, Mechanical Systems and Signal Processing 2, 1988.

        Example:
            >>> FrequencyResponse([[[3.0, 0.0], [0.0, 4.0]]] * 2, [1.0, 2.0]).mode_indicator().tolist()
            [[4.0, 3.0], [4.0, 3.0]]
        """
        known = np.isfinite(self.response).all(axis=(1, 2))
        values = np.full((self.n_lines, min(self.n_outputs, self.n_inputs)), np.nan)
        values[known] = np.linalg.svd(self.response[known], compute_uv=False)
        return values


def _share(overlap: float) -> float:
    share = real_number(overlap)
    if not 0 <= share < 1:
        raise InvalidDataError(f"overlap must be a share in [0, 1), 0.5 for 50 %, but is {overlap!r}.")
    return share


def _complex_with_gaps(values: npt.ArrayLike) -> ComplexArray:
    try:
        array = np.array(values, dtype=np.complex128)
    except (TypeError, ValueError) as error:
        raise InvalidDataError(f"response must be an array of complex numbers ({error}).") from error
    if array.ndim in {1, 2}:
        array = array.reshape(len(array), -1, 1)
    if array.ndim != 3 or 0 in array.shape or len(array) < 2:
        raise InvalidDataError(
            f"response must have shape (n_lines, n_outputs, n_inputs) with at least 2 lines, but has {array.shape}."
        )
    if np.isinf(array).any():
        raise InvalidDataError("response must not hold infinite values; mark lines that were not measured as NaN.")
    empty = np.isnan(array).all(axis=0)
    if empty.any():
        output, input_ = (int(index) for index in np.argwhere(empty)[0])
        raise InvalidDataError(
            f"the response of output {output} to input {input_} holds no number at any of its {len(array)} lines; "
            "leave that output or input out."
        )
    array.flags.writeable = False
    return array


def _coherence(values: npt.ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    array = np.array(values, dtype=np.float64)
    if array.shape not in {shape, shape[:2]}:
        raise InvalidDataError(f"coherence must have shape {shape[:2]} or {shape}, but has {array.shape}.")
    if (array < -OFF_GRID).any() or (array > 1 + OFF_GRID).any():
        raise InvalidDataError(
            f"coherence must lie between 0 and 1, but runs from {np.nanmin(array):.3g} to {np.nanmax(array):.3g}; give "
            "it as a share, not in percent."
        )
    array = np.clip(array, 0.0, 1.0)
    array.flags.writeable = False
    return array


def window_samples(window: str, n_samples: int, time_constant: float | None, dt: float) -> FloatArray:
    """(n_samples,) the window of a block, periodic in it."""
    if window == "exponential" and time_constant is not None:
        return np.exp(-dt / time_constant * np.arange(n_samples))
    angle = 2 * np.pi / n_samples * np.arange(n_samples)
    terms = _COSINES.get(window, (1.0,))
    return np.asarray(sum(term * np.cos(k * angle) for k, term in enumerate(terms)), dtype=np.float64)


def window_autocorrelation(response: FrequencyResponse, n_samples: int, *, window: ResponseWindow) -> FloatArray:
    """(n_samples,) what a block's window leaves of the pulse response at each lag: r_w, or its decay."""
    if window == "exponential":
        dt = 1.0 / (n_samples * line_spacing(response))
        return window_samples(window, n_samples, response.window_time_constant, dt)
    if window not in _COSINES:
        return np.ones(n_samples)
    spectrum = np.fft.rfft(window_samples(window, n_samples, None, 1.0), 2 * n_samples)
    lags = np.fft.irfft(spectrum.real**2 + spectrum.imag**2, 2 * n_samples)[:n_samples]
    return np.asarray(lags / lags[0], dtype=np.float64)


def line_spacing(response: FrequencyResponse) -> float:
    """Spacing of the lines [Hz] of a uniform table whose grid holds 0 Hz.

    Raises:
        InvalidDataError: the lines are not uniform, or 0 Hz is no line of their grid.
    """
    f = response.frequencies
    mean = float(f[-1] - f[0]) / (f.size - 1)
    numbers = np.round(f / mean)
    spacing = float(f[-1] / numbers[-1])  # the last line has the most digits
    off = np.abs(f / spacing - numbers[0] - np.arange(f.size))
    worst = int(off.argmax())
    if off[worst] > OFF_GRID:
        raise InvalidDataError(
            f"a pulse response needs lines at whole multiples of one spacing, but with {spacing:.6g} Hz line {worst} "
            f"({f[worst]:.6g} Hz) lies {off[worst]:.2g} spacings off; export or resample the table on such a grid."
        )
    return spacing


def with_missing_lines(response: FrequencyResponse) -> FrequencyResponse:
    """The table on the uniform grid that its lines are part of, NaN at those it leaves out; else unchanged.

    Lines that somebody deleted leave the blocks, and so the window, what they were.

    Example:
        >>> with_missing_lines(FrequencyResponse([1.0, 2.0, 3.0], [1.0, 2.0, 4.0])).response.ravel().real
        array([ 1.,  2., nan,  3.])
    """
    f = response.frequencies
    steps = np.diff(f)
    spacing = float(f[-1] - f[0]) / float(np.round(steps / steps.min()).sum())
    spacing = float(f[-1] / max(1.0, np.round(f[-1] / spacing)))
    numbers = np.round(f / spacing).astype(int)
    size = int(numbers[-1] - numbers[0]) + 1
    if np.abs(f / spacing - numbers).max() > OFF_GRID or not f.size < size <= f.size / LEAST_MEASURED:
        return response

    def filled(values: np.ndarray) -> np.ndarray:
        lines = np.full((size, *values.shape[1:]), np.nan, dtype=values.dtype)
        lines[numbers - numbers[0]] = values
        return lines

    return replace(
        response,
        response=filled(response.response),
        frequencies=np.arange(numbers[0], numbers[-1] + 1) * spacing,
        coherence=None if response.coherence is None else filled(response.coherence),
    )


def block_length(response: FrequencyResponse, dt: float | None) -> tuple[int, int]:
    """Samples of a block, and the number of its first line in the table.

    Raises:
        InvalidDataError: no uniform grid, no dt where the table begins above 0, or one that does not fit the grid.
    """
    spacing = line_spacing(response)
    first = round(float(response.frequencies[0]) / spacing)
    last = first + response.n_lines - 1
    if dt is None:
        if first:
            raise InvalidDataError(
                f"the table begins at {response.frequencies[0]:.6g} Hz, so the time step of the blocks cannot be told "
                "from it; pass dt in seconds."
            )
        return 2 * last, 0
    n_samples = 1.0 / (time_step(dt) * spacing)
    if abs(n_samples - round(n_samples)) > OFF_GRID * n_samples or round(n_samples) < 2 * last:
        raise InvalidDataError(
            f"dt = {dt:.6g} s and lines every {spacing:.6g} Hz up to {response.frequencies[-1]:.6g} Hz do not belong "
            f"together: dt may be {0.5 / response.frequencies[-1]:.6g} s at most, and 1 / (dt spacing) is a whole "
            "number."
        )
    return round(n_samples), first


def pulse_response(
    response: FrequencyResponse, *, window: ResponseWindow | Literal["as stated"] = "as stated", dt: float | None = None
) -> MarkovParameters:
    """The pulse response that a table of frequency responses stands for, its window divided out.

    Args:
        response: on a uniform grid, known at every line.
        window: of the blocks that it was made of, "as stated" in the response. Hann, Hamming, flat-top and uniform are
            divided out where their autocorrelation is above 1/4, which bounds the lags; "periodic" gives the wrapped
            response of whole periods as it is; "exponential" takes 1 / tau off every decay rate.
        dt: time step [s]; 1 / (2 f_max) unless given. Lines outside the table count as zero.

    Returns:
        Markov parameters h(0), h(1), ...: a realisation of them has the poles of the system.

    Raises:
        InvalidDataError: an unknown window, lines off a uniform grid, a line that was not measured, or no dt for a
            table that begins above 0 Hz.

    Example:
        >>> lines = np.arange(65)
        >>> table = FrequencyResponse(1 / (np.exp(2j * np.pi * lines / 128) - 0.5), lines * 1.0, window="periodic")
        >>> pulse_response(table).system[1:4].ravel().round(9)
        array([1.  , 0.5 , 0.25])
    """
    require(response, FrequencyResponse, where="pulse_response", made_by="okid.estimate_response")
    stated = response.window if window == "as stated" else window
    if stated not in get_args(ResponseWindow) or stated == "unknown":
        raise InvalidDataError(
            'the window of these responses is unknown, and it decides the damping: pass window= ("hann", "uniform", '
            '"periodic" ...), or let modal.identify try them.'
        )
    n_samples, first = block_length(response, dt)
    if np.isnan(response.response).any():
        n_missing = int(np.isnan(response.response).any(axis=(1, 2)).sum())
        raise InvalidDataError(
            f"a pulse response needs every line, but {n_missing} of {response.n_lines} hold a NaN; leave out the "
            "outputs concerned, or fill the lines."
        )
    lines = np.zeros((n_samples // 2 + 1, *response.response.shape[1:]), dtype=np.complex128)
    lines[first : first + response.n_lines] = response.response
    lags = np.fft.irfft(lines, n_samples, axis=0)
    share = window_autocorrelation(
        replace(response, window_time_constant=_constant(response, stated)), n_samples, window=stated
    )
    n_kept = int(np.argmin(share > LEAST_WINDOW)) or n_samples
    system = lags[:n_kept] / share[:n_kept, np.newaxis, np.newaxis]
    return MarkovParameters(system=system, dt=1.0 / (n_samples * line_spacing(response)))


def _constant(response: FrequencyResponse, window: str) -> float | None:
    if window == "exponential" and response.window_time_constant is None:
        raise InvalidDataError("an exponential window needs the response's window_time_constant in seconds.")
    return response.window_time_constant


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class AveragedSpectra:
    """Sums over windowed segments; the spectra of inputs with everything, of outputs with themselves.

    Attributes:
        frequencies: (n_frequencies,) [Hz].
        inputs: (n_frequencies, n_inputs, n_inputs).
        cross: (n_frequencies, n_outputs, n_inputs) of outputs with inputs.
        power: (n_frequencies, n_inputs + n_outputs) of each channel with itself.
        n_averages: number of segments.
        to_density: factor that makes a power spectral density [unit^2/Hz] of `power`.
    """

    frequencies: FloatArray
    inputs: ComplexArray
    cross: ComplexArray
    power: FloatArray
    n_averages: int
    to_density: float


def averaged_spectra(
    records: Record | Sequence[Record],
    *,
    n_per_segment: int,
    window: FloatArray | None = None,
    step: int | None = None,
    level: Literal["segment", "kept"] = "segment",
) -> AveragedSpectra:
    """Welch's sums, one segment in memory at a time; a segment never spans two records or a missing sample.

    Args:
        records: of one system.
        n_per_segment: samples a segment.
        window: (n_per_segment,), Hann unless given.
        step: samples from one segment to the next, half a segment unless given.
        level: "segment": each segment's mean is taken off; "kept": it is left as it is.
    """
    several = as_records(records)
    length, n_inputs, dt = n_per_segment, several[0].n_inputs, several[0].dt
    weight = window_samples("hann", length, None, dt) if window is None else window
    n_lines = length // 2 + 1
    inputs = np.zeros((n_inputs, n_inputs, n_lines), dtype=np.complex128)
    cross = np.zeros((several[0].n_outputs, n_inputs, n_lines), dtype=np.complex128)
    power = np.zeros((n_inputs + several[0].n_outputs, n_lines))
    n_averages = 0
    for record, start, stop in _complete_runs(several):
        for first in range(start, stop - length + 1, step or max(1, length // 2)):
            rows = slice(first, first + length)
            segment = np.concatenate([record.inputs[rows].T, record.outputs[rows].T])
            if level == "segment":
                segment = segment - segment.mean(axis=1, keepdims=True)
            spectrum: ComplexArray = np.fft.rfft(weight * segment)
            power += spectrum.real**2 + spectrum.imag**2
            for i in range(n_inputs):
                against = spectrum[i].conj()
                inputs[:, i] += spectrum[:n_inputs] * against
                cross[:, i] += spectrum[n_inputs:] * against
            n_averages += 1
    return AveragedSpectra(
        frequencies=np.arange(n_lines) / (length * dt),
        inputs=inputs.transpose(2, 0, 1),
        cross=cross.transpose(2, 0, 1),
        power=power.T,
        n_averages=n_averages,
        to_density=2.0 * dt / (float(np.square(weight).sum()) * max(1, n_averages)),
    )


def coherent_response(spectra: AveragedSpectra) -> tuple[ComplexArray, FloatArray, FloatArray]:
    """H1 response S_yu S_uu^-1 (n_lines, n_outputs, n_inputs), ordinary and multiple coherence.

    NaN where the inputs have no power or cannot be told apart.
    """
    n_inputs = spectra.inputs.shape[1]
    power = spectra.power
    input_power, output_power = power[:, :n_inputs], power[:, n_inputs:]
    # Unit diagonal first, so that a rank test does not depend on units; a line without power gives nan below.
    with np.errstate(divide="ignore", invalid="ignore"):
        unit = 1 / np.sqrt(input_power)
        uu = spectra.inputs * unit[:, :, np.newaxis] * unit[:, np.newaxis]
        yu = spectra.cross * unit[:, np.newaxis]
        ordinary = np.abs(yu) ** 2 / output_power[:, :, np.newaxis]
        response = np.full(yu.shape, np.nan + 0j)
        lines = np.flatnonzero(
            np.isfinite(uu).all(axis=(1, 2)) & (input_power > 1e-24 * power.max(axis=0)[:n_inputs]).all(1)
        )
        lines = lines[np.linalg.eigvalsh(uu[lines])[:, 0] > 1e-10] if lines.size else lines
        response[lines] = np.linalg.solve(uu[lines].transpose(0, 2, 1), yu[lines].transpose(0, 2, 1)).transpose(0, 2, 1)
        multiple = np.einsum("fqm,fqm->fq", response, yu.conj()).real / output_power
        response = response * unit[:, np.newaxis]
    return (np.asarray(response, dtype=np.complex128), np.clip(ordinary, 0.0, 1.0), np.clip(multiple, 0.0, 1.0))


def estimate_response(
    records: Record | Sequence[Record],
    *,
    estimator: Estimator = "H1",
    window: ResponseWindow = "hann",
    n_samples: int | None = None,
    overlap: float | None = None,
    window_time_constant: float | None = None,
) -> FrequencyResponse:
    """Frequency responses from records by averaged spectra, with coherence and number of averages.

    Args:
        records: of one system; a block never spans two records or a missing sample.
        estimator: "H1" (noise on the outputs), "H2" (noise on the input; one input) or "Hv" (noise on both, in shares
            of each channel's own power).
        window: "hann", "hamming", "flattop", "uniform"; "periodic" for whole periods of a repeated input;
            "exponential" for hits: exp(-t / tau) on input and output alike, so that what it does is known exactly.
        n_samples: of a block. A power of two that leaves some eight independent blocks unless given; for "exponential"
            the shortest record; for "periodic" the period must be given.
        overlap: share of a block that the next one repeats, in [0, 1): 1/2 for Hann and Hamming, 3/4 for flat-top, else
            0, unless given.
        window_time_constant: tau of the exponential window [s].

    Returns:
        With multiple coherence; without coherence where there are no more blocks than inputs. NaN at lines at which
        the inputs have no power or cannot be told apart.

    Raises:
        InvalidDataError: no input, an estimator or a window that is none, H2 with several inputs.
        InsufficientDataError: fewer blocks than inputs.

    Example:
        >>> force = np.random.default_rng(1).standard_normal(4096)
        >>> table = estimate_response(Record(force, np.r_[0.0, force[:-1]], 0.01), n_samples=64)
        >>> table.n_averages, bool(abs(abs(table.response[5, 0, 0]) - 1) < 0.05)
        (127, True)
    """
    several = as_records(records)
    first = several[0]
    if estimator not in get_args(Estimator):
        raise InvalidDataError(f"estimator must be one of {', '.join(get_args(Estimator))}, but is {estimator!r}.")
    if window not in get_args(ResponseWindow) or window == "unknown":
        raise InvalidDataError(f"window must be one of {', '.join(get_args(ResponseWindow)[:-1])}, but is {window!r}.")
    if not first.n_inputs:
        raise InvalidDataError(
            "a frequency response needs records with at least one input; name it among the channels."
        )
    if estimator == "H2" and first.n_inputs > 1:
        raise InvalidDataError(f"H2 is defined for one input, but there are {first.n_inputs}; use H1 or Hv.")
    length = _block_samples(several, window, n_samples)
    share = OVERLAP.get(window, 0.0) if overlap is None else _share(overlap)
    constant = None if window_time_constant is None else real_number(window_time_constant)
    if window == "exponential" and not (constant is not None and np.isfinite(constant) and constant > 0):
        raise InvalidDataError("an exponential window needs window_time_constant, a positive number of seconds.")
    hits = window == "exponential"
    spectra = averaged_spectra(
        several if hits else tuple(record.detrended() for record in several),
        n_per_segment=length,
        window=window_samples(window, length, constant, first.dt),
        step=max(1, round(length * (1 - share))),
        level="kept",
    )
    if spectra.n_averages < first.n_inputs:
        raise InsufficientDataError(
            f"responses to {first.n_inputs} inputs need at least {first.n_inputs} blocks; the records hold "
            f"{spectra.n_averages} of {length} complete samples. Use a smaller n_samples or longer records."
        )
    response, _, multiple = coherent_response(spectra)
    if estimator == "H2":
        with np.errstate(divide="ignore", invalid="ignore"):
            response = response / multiple[:, :, np.newaxis]
    elif estimator == "Hv":
        response = total_least_squares(spectra.inputs, spectra.cross, spectra.power, response)
    return FrequencyResponse(
        np.where(np.isfinite(response), response, np.nan),
        spectra.frequencies,
        coherence=multiple if spectra.n_averages > first.n_inputs else None,
        n_averages=spectra.n_averages,
        window=window,
        window_time_constant=constant if hits else None,
        overlap=share,
        input_names=first.input_names,
        output_names=first.output_names,
        input_units=first.input_units,
        output_units=first.output_units,
        name=first.name,
    )


def _block_samples(records: Sequence[Record], window: str, n_samples: int | None) -> int:
    if n_samples is not None:
        return whole_number(n_samples, name="n_samples", least=4)
    if window == "periodic":
        raise InvalidDataError("blocks of whole periods need n_samples, the period of the input in samples.")
    if window == "exponential":
        return min(record.n_samples for record in records)
    return segment_length(records)


def _complete_runs(records: Sequence[Record]) -> list[tuple[Record, int, int]]:
    return [(record, start, stop) for record in records for start, stop in runs_of(record.complete_rows())]


def segment_length(records: Sequence[Record], *, averages: int = FEWEST_AVERAGES) -> int:
    """Samples a segment: the power of two, 16 at least, that leaves so many segments without overlap, about."""
    lengths = [stop - start for _, start, stop in _complete_runs(records)]
    n_rows, longest = sum(lengths), max(lengths, default=0)
    return int(max(16, 2 ** int(np.log2(max(16, min(n_rows // averages, longest))))))
