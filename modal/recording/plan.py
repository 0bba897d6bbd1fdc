"""What a recording of one identification will hold, settled before anything is written.

Pages and blueprint must agree on paths, on what is shown and on the time axis; they all read it here. Measured series
lie below `data`, what a model makes of them below `fit`: lines are painted in the order of their paths, and the
measured line belongs below the others. What the records show without any model is looked at once, for all pages.

Names from files are not to be trusted: a channel may be called `<script>`, nothing at all, a thousand letters, or text
that runs from right to left and carries what follows along. Here are their paths and their short forms.

Tables are of numbers, on a timeline that counts rows (modes, orders, outputs, records), or of words, as Markdown. A
value that is not known is left out of its row rather than stored as nan: it shows as empty, and two recordings of one
result compare equal (nan never equals nan).
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from era.realisation import Realisation
from modal.geometry.sensors import Geometry
from modal.identification.result import Identification
from modal.modes.mode import Mode, numbered
from modal.modes.response_synthesis import MeasuredFrf, frf, measured_frf
from modal.quality.check import DataQuality, check_quality
from modal.recording.figure import RecordingStream, drawable, rr
from modal.recording.series import StoredRecords, laid_out, row_budget, stored_levels
from modal.sections.words import data_sentences, modes_headline
from modal.wording.text import escape_markdown, shorten
from okid.arrays import ROUNDED, ComplexArray, FloatArray
from okid.errors import InsufficientDataError, visible
from okid.frequency_response import FEWEST_AVERAGES
from okid.record import Record


def label(text: str, longest: int = 28) -> str:
    r"""One line of visible text, at most `longest` characters; "unnamed" where nothing would be seen.

    Example:
        >>> label("tip\nmass"), label("  ")
        ('tip mass', 'unnamed')
    """
    return shorten(" ".join(drawable(visible(text)).split()), longest) or "unnamed"


def name_with_unit(name: str, unit: str, longest: int = 28) -> str:
    """A name and its unit in brackets, where there is one.

    Example:
        >>> name_with_unit("tip", "m/s^2")
        'tip [m/s^2]'
    """
    return f"{label(name, longest)} [{label(unit, 12)}]" if unit else label(name, longest)


def cell(text: str, longest: int = 400) -> str:
    r"""The same for a Markdown table or sentence: nothing in it acts as Markdown or HTML.

    Example:
        >>> cell("<b>|x|")
        '&lt;b&gt;\\|x\\|'
    """
    return escape_markdown(label(text, longest))


def path_parts(names: Sequence[str]) -> tuple[str, ...]:
    r"""One part of an entity path a name, escaped as Rerun asks and all different.

    Names that would fall together, because of what was left out or cut off, get their position as a suffix.

    Example:
        >>> path_parts(["tip", "", " ", "a/b", "__secret"])
        ('tip', 'unnamed', 'unnamed_2', 'a\\/b', 'name__secret')
    """
    parts: list[str] = []
    for index, name in enumerate(names):
        part = label(name, longest=len(name) + len("unnamed"))[:64]
        if part.startswith("__"):  # reserved by Rerun for its own entities
            part = "name" + part
        escaped = rr.escape_entity_path_part(part)
        while escaped in parts:
            escaped = f"{escaped}_{index}"
        parts.append(escaped)
    return tuple(parts)


DATA: Final = "data"
"""Above the measured series of an identification."""


class Views:
    """How much has a view of its own."""

    INPUTS: Final = 6
    OUTPUTS: Final = 12
    """Give so many of each a view, whatever comes; the numbers of all the others are stored as well."""


class Counted:
    """What a response may take."""

    MOST_NUMBERS: Final = 300_000
    """Store so many lines of the response times its pairs of channels, at most."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DataPlan(StoredRecords):
    """Where the measured channels are stored and when they play.

    Attributes:
        root: the entity above all of them.
        input_paths: entity of each input.
        output_paths: entity of each output.
        shown_outputs: outputs that have views of their own.
        shifts: seconds by which each record is moved on the timeline.
    """

    root: str
    input_paths: tuple[str, ...]
    output_paths: tuple[str, ...]
    shown_outputs: tuple[int, ...]
    shifts: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Plan:
    """What is shown of an identification, where it is stored and when it plays.

    Attributes:
        data: of the measured channels.
        fit_paths: entity above what the model makes of each output.
        modes: every mode in the order of its number (`modal.modes.mode`); their position from 1 is the number used on
            every page, in the report and on the timeline "mode".
        shapes: numbers (from 1) of the modes whose shapes are drawn.
        window: length of the window which follows the cursor [s].
        geometry: where the sensors are; None where nothing is known but their order.
    """

    data: DataPlan
    fit_paths: tuple[str, ...]
    modes: tuple[Mode, ...]
    shapes: tuple[int, ...]
    window: float
    geometry: Geometry | None = None

    @property
    def compared(self) -> bool:
        """Whether there are shapes to compare: several, of several outputs each."""
        return len(self.shapes) > 1 and len(self.fit_paths) > 1


def planned(identification: Identification, geometry: Geometry | None = None) -> Plan:
    """The plan for one identification.

    Raises:
        InvalidDataError: the records reach further than the time axis of a recording does.
    """
    records = identification.records or (_time_alone(identification),)
    first = records[0]
    n_entities = first.n_inputs + 3 * first.n_outputs  # measured; the model; its residuals
    # measured; predicted, simulated and the residuals of both
    budget = row_budget(n_entities, first.n_inputs + 5 * first.n_outputs)
    around = tuple(_worst_sample(*pair) for pair in zip(records, identification.simulated or records, strict=True))
    data = planned_data(records, budget=budget, around=around)
    modes = tuple(mode for _, mode in numbered(identification.modes.modes))
    return Plan(
        data=data,
        fit_paths=tuple(f"fit/output/{part}" for part in path_parts(first.output_names)),
        modes=modes,
        shapes=_drawn(modes),
        window=_window(modes, first.dt, data.stop - data.start),
        geometry=geometry,
    )


def _time_alone(identification: Identification) -> Record:
    """A record of nothing as long as the pulse response, for the time in which shapes and orders play."""
    names, n_rows = identification.channels.output_names, identification.markov.n_lags + 1
    nothing = np.zeros((max(n_rows, len(names)), len(names)))
    return Record(nothing[:, :0], nothing, identification.realisation.dt, output_names=names)


def planned_data(
    records: Sequence[Record], *, root: str = DATA, budget: int | None = None, around: Sequence[int] = ()
) -> DataPlan:
    """The plan for the measured channels alone.

    Args:
        records: with equal channels.
        root: the entity above them.
        budget: rows that a series may have; unless given, as many as the measured channels leave.
        around: for each record, the sample around which every sample is stored in a long one.

    Raises:
        InvalidDataError: the records reach further than the time axis of a recording does.
    """
    first = records[0]
    starts, stops = laid_out(records)
    n_channels = first.n_inputs + first.n_outputs
    return DataPlan(
        root=root,
        input_paths=tuple(f"{root}/input/{part}" for part in path_parts(first.input_names)),
        output_paths=tuple(f"{root}/output/{part}" for part in path_parts(first.output_names)),
        shown_outputs=tuple(range(min(first.n_outputs, Views.OUTPUTS))),
        shifts=tuple(start - record.start_time for start, record in zip(starts, records, strict=True)),
        starts=starts,
        stops=stops,
        levels=stored_levels(records, budget or row_budget(n_channels, n_channels), around=around),
    )


def _worst_sample(record: Record, simulated: Record) -> int:
    """Where the model is furthest from what was measured, each output by its own scale; the start if nowhere."""
    residual = np.abs(record.outputs - simulated.outputs)
    there = np.isfinite(residual)
    if not there.any():
        return 0
    residual[~there] = 0.0
    residual /= np.where(residual.any(axis=0), residual.mean(axis=0), 1.0)
    return int(residual.max(axis=1).argmax())


def _drawn(modes: tuple[Mode, ...]) -> tuple[int, ...]:
    """Modes of the system; where there are none, the doubtful ones, so that there is something to judge."""
    for verdict in ("system", "doubtful"):
        chosen = [number for number, mode in enumerate(modes, start=1) if mode.verdict == verdict]
        if chosen:
            return tuple(chosen[:9])
    return ()


def _window(modes: tuple[Mode, ...], dt: float, duration: float) -> float:
    """Eight periods of the lowest system mode, but at least 60 and at most 600 samples, and a tenth of the record."""
    system = [mode.frequency for mode in modes if mode.verdict == "system" and mode.frequency > 0]
    wanted = 8.0 / min(system) if system else 300 * dt
    return float(min(np.clip(wanted, 60 * dt, 600 * dt), max(duration / 10, 20 * dt)))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Gathered:
    """What speaks for or against a model, beside the model.

    Attributes:
        quality: of the data.
        measured: frequency response of the records as used; None without inputs, or where they are too short.
        synthesised: (n_frequencies, n_outputs, n_inputs) response of the model at the frequencies of `measured`, empty
            where that is None; nan at a pole on the unit circle.
        fine_frequencies: (n_fine,) [Hz] those of `measured` with others between where they are few: a short record has
            coarse lines, and resonances of the model may lie between them.
        fine: (n_fine, n_outputs, n_inputs) response of the model there.
        density_frequencies: (n_lines,) [Hz] of `model_density`: those of the densities in `quality`, up to the model's
            highest.
        model_density: (n_lines, n_outputs) power spectral density of the outputs that the model's one-step errors
            drive; empty with inputs, or where the model has no gain.
    """

    quality: DataQuality
    measured: MeasuredFrf | None
    synthesised: ComplexArray
    fine_frequencies: FloatArray
    fine: ComplexArray
    density_frequencies: FloatArray
    model_density: FloatArray


def gather(identification: Identification, quality: DataQuality | None = None) -> Gathered:
    """Look at the records of an identification."""
    fine_frequencies, step = np.zeros(0), 1
    fine: ComplexArray = np.zeros((0, 0, 0), dtype=np.complex128)
    # a pole on the unit circle and squares of 1e200 give what is no number, and is left out of every picture
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        measured = response_of(identification.records)
        if measured is not None:
            n_lines, n_pairs = measured.frequencies.size, measured.frf[0].size
            step = max(1, min(-(-800 // n_lines), Counted.MOST_NUMBERS // (n_lines * n_pairs)))
            fine_frequencies = np.linspace(0.0, measured.frequencies[-1], step * (n_lines - 1) + 1)
            fine = frf(identification.realisation, fine_frequencies)
            fine = np.where(np.isfinite(fine), fine, np.nan)
        quality = quality or check_quality(identification.records, choices=identification.choices)
    frequencies = quality.frequencies[quality.frequencies <= 0.5 / identification.realisation.dt * (1 + ROUNDED)]
    return Gathered(
        quality=quality,
        measured=measured,
        synthesised=fine[::step],
        fine_frequencies=fine_frequencies,
        fine=fine,
        density_frequencies=frequencies,
        model_density=_model_density(identification, frequencies),
    )


def _model_density(identification: Identification, frequencies: FloatArray) -> FloatArray:
    """One-sided spectrum 2 dt H R H* of the outputs, H from the one-step errors with covariance R to the outputs.

    References:
        Ljung, System Identification, 2nd edition, 1999, section 2.3 (spectra of innovations models).
    """
    model = identification.realisation
    if identification.channels.n_inputs or model.K is None or not frequencies.size:
        return np.zeros((0, 0))
    covariance = identification.innovation_covariance
    if covariance is None and identification.observer is not None:
        covariance = identification.observer.residual_covariance
    if covariance is None:
        return np.zeros((0, 0))
    noise = Realisation(model.A, model.K, model.C, np.eye(model.C.shape[0]), model.dt)
    with np.errstate(divide="ignore", invalid="ignore"):
        response = frf(noise, frequencies)
        power = np.einsum("fij,jk,fik->fi", response, covariance, response.conj()).real
    density: FloatArray = 2.0 * model.dt * np.where(np.isfinite(power), power, np.nan)
    return density


def response_of(records: Sequence[Record]) -> MeasuredFrf | None:
    """Frequency response of the records with segments that suit a picture; None where there can be none."""
    first = records[0]
    if not first.n_inputs:
        return None
    n_rows = sum(record.n_samples for record in records)
    longest = min(
        8192,  # 4096 lines are more than a screen shows
        2 * Counted.MOST_NUMBERS // (first.n_inputs * first.n_outputs),
        n_rows // FEWEST_AVERAGES,
    )
    length = 2 ** int(np.log2(max(16, longest)))
    while length >= 16:
        try:
            return measured_frf(records, n_per_segment=length)
        except InsufficientDataError:  # too few stretches without a gap
            length //= 2
    return None


MATRIX: Final = 2


def log_table(
    recording: RecordingStream,
    path: str,
    timeline: str,
    index: npt.ArrayLike,
    columns: Mapping[str, Iterable[object]],
) -> None:
    """Log one row an index.

    Args:
        recording: the stream.
        path: entity of the table.
        timeline: what the index counts.
        index: (n_rows,) whole numbers.
        columns: by name, n_rows values each: numbers, words, or sequences of numbers for a list in each cell; an array
            (n_rows, n) is the same, quick, and a row of it that is nan throughout is left out.
    """
    rows = np.asarray(index, dtype=np.int64)
    if not rows.size:
        return
    made: list[object] = []
    for name, values in columns.items():
        if isinstance(values, np.ndarray) and values.ndim <= MATRIX and values.dtype == np.float64:
            made += _lists(name, values.reshape(rows.size, -1))
            continue
        cells = [_known(value) for value in values]
        flat = [value for part in cells for value in part]
        # a column without any value has no type; Rerun would keep or drop it by what the process has logged before
        if flat:
            made += rr.AnyValues.columns(**{name: flat}).partition([len(part) for part in cells])
    if made:
        recording.send_columns(path, [rr.TimeColumn(timeline, sequence=rows)], made, strict=True)


def _lists(name: str, values: npt.NDArray[np.float64]) -> list[object]:
    """A list of numbers in each cell, none where nothing is known; in Arrow's form, so that Rerun need not look."""
    import pyarrow as pa

    there = ~np.isnan(values).all(axis=1)
    if not there.any() or not values.shape[1]:
        return []
    offsets = np.concatenate([[0], np.cumsum(there * values.shape[1])]).astype(np.int32)
    cells = pa.ListArray.from_arrays(offsets, pa.array(values[there].reshape(-1)))
    return list(rr.AnyValues.columns(**{name: cells}))


def _known(value: object) -> list[object]:
    if isinstance(value, np.ndarray | list | tuple):
        return [float(part) for part in value]  # cells of several numbers keep their places, so nan stays
    if isinstance(value, float | np.floating) and np.isnan(value):
        return []
    return [value.item() if isinstance(value, np.generic) else value]


class WordLimits:
    """How much is written out in words."""

    LISTED: Final = 40
    """List so many channels, outputs or parts in words; the tables of numbers hold all."""
    LONGEST_SENTENCE: Final = 2000
    """Cut a sentence at so many letters: ours are shown whole, one with hostile names in it still ends somewhere."""
    LISTED_STRETCHES: Final = 6
    """Name so many stretches of time in a sentence."""


UNKNOWN: Final = "–"


def fit_page_text(identification: Identification, plan: Plan) -> str:
    """What was found in one line, what must be read first, how well the outputs are repeated, and what is left over."""
    fit = identification.fit
    first = identification.channels
    parts = [f"### {modes_headline(identification)}"]
    parts += [f"**Read this:** {cell(warning)}" for warning in identification.warnings]
    seen = "the model sees the inputs alone" if first.n_inputs else "the model predicts one step ahead, without inputs,"
    parts.append(
        f"Cross-validated fit **{known(100 * fit.mean, '.1f', ' %')}**, mean over outputs: {seen} and is scored on "
        "rows that it was not fitted to."
    )
    listed = range(min(first.n_outputs, WordLimits.LISTED))
    rows = [
        [
            cell(first.output_names[i], 24),
            unit_cell(first.output_units[i]),
            f"**{known(100 * fit.cross_validated[i], '.1f', ' %')}**",
            known(100 * fit.whole[i], ".1f", " %"),
            known(100 * fit.one_step[i], ".1f", " %"),
        ]
        for i in listed
    ]
    parts.append(table(["output", "unit", "cross-validated", "all rows", "one step"], rows))
    if first.n_outputs > Views.OUTPUTS:
        parts.append(f"Plots are shown for the first {Views.OUTPUTS} of {first.n_outputs} outputs; all are stored.")
    parts.append(_observer_line(identification))
    residuals = identification.residuals
    parts += bullets(data_sentences(identification), () if residuals is None else residuals.messages)
    if len(identification.records) > 1:
        parts.append(_records_table(identification, plan))
    parts += _levels_lines(identification, plan)
    return "\n\n".join(parts)


def choices_text(identification: Identification) -> str:
    """Every automatic choice with its reason, and the warnings."""
    rows = [[cell(c.what), f"**{cell(c.value, 80)}**", cell(c.reason)] for c in identification.choices]
    parts = ["### Choices", table(["what", "chosen", "why"], rows) if rows else "No choice was left open."]
    parts += ["### Warnings", *bullets(identification.warnings or ("None.",))]
    return "\n\n".join(parts)


def _observer_line(identification: Identification) -> str:
    observer, residuals = identification.observer, identification.residuals
    if observer is None or residuals is None:
        return ""
    first = identification.records[0]
    n_samples = sum(record.n_samples for record in identification.records)
    correlation = f"; correlation with the input: {known(residuals.input_correlation_ratio, '.2f')}" * bool(
        first.n_inputs
    )
    return (
        f"Observer order **{observer.order}**, model order **{identification.realisation.order}**; {first.n_inputs} "
        f"input{'s' * (first.n_inputs != 1)}, {first.n_outputs} output{'s' * (first.n_outputs != 1)}, {n_samples} "
        f"samples at {first.sampling_frequency:.6g} Hz, {observer.n_rows} complete rows fitted. Whiteness of the "
        f"one-step residual: {known(residuals.whiteness_ratio, '.2f')} (1 is white, above 2 is not){correlation}."
    )


def _levels_lines(identification: Identification, plan: Plan) -> list[str]:
    """Where a long record is stored with every sample, and how coarsely elsewhere; nothing where all of it is."""
    data = plan.data
    coarsest = max(part.bucket for kept in data.levels for part in kept)
    if coarsest == 1:
        return []
    exact = [
        f"{start + part.start * record.dt:.6g} to {start + (part.stop - 1) * record.dt:.6g} s"
        for record, start, kept in zip(identification.records, data.starts, data.levels, strict=True)
        for part in kept
        if part.bucket == 1
    ]
    shown = ", ".join(exact[: WordLimits.LISTED_STRETCHES]) + (
        " and so on" if len(exact) > WordLimits.LISTED_STRETCHES else ""
    )
    sentence = (
        f"Long series are stored as the smallest and the largest of every {coarsest} samples; the results come from "
        f"all samples. Every sample is stored at the start and around the largest residual: {shown}."
    )
    return [sentence]


def _records_table(identification: Identification, plan: Plan) -> str:
    data = plan.data
    rows = [
        [cell(record.name, 40), f"{start:.6g} s", f"{stop:.6g} s", f"{shift:.6g} s" if shift else UNKNOWN]
        for record, start, stop, shift in zip(identification.records, data.starts, data.stops, data.shifts, strict=True)
    ]
    return table(["record", "shown from", "to", "moved by"], rows)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table of cells that are harmless already."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def bullets(*groups: Sequence[str]) -> list[str]:
    """The sentences as one Markdown list, made harmless; nothing where there is no sentence."""
    lines = [f"- {cell(message, WordLimits.LONGEST_SENTENCE)}" for group in groups for message in group]
    return ["\n".join(lines)] if lines else []


def known(value: float, form: str, unit: str = "") -> str:
    """The value in this form and unit, a dash where it is none."""
    return f"{value:{form}}{unit}" if np.isfinite(value) else UNKNOWN


def unit_cell(unit: str, longest: int = 12) -> str:
    """A unit for a table, a dash where there is none."""
    return cell(unit, longest) if unit else UNKNOWN


def log_text(recording: RecordingStream, path: str, text: str) -> None:
    """Words in Markdown that stand from beginning to end."""
    recording.log(path, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True, strict=True)
