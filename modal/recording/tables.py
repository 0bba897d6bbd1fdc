"""Tables: of numbers, on a timeline that counts rows (modes, orders, outputs, records), and of words, as Markdown.

A value that is not known is left out of its row rather than stored as nan: it shows as empty, and two recordings of
one result compare equal (nan never equals nan).
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from modal.identification.result import Identification
from modal.recording.figure import RecordingStream, rr
from modal.recording.plan import Plan, Views, cell
from modal.sections.words import data_sentences, modes_headline

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
