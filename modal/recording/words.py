"""The pages in words and tables, as Markdown: the fit, the modes, the choices."""

from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np

from modal.identification import Identification
from modal.mode import Mode
from modal.recording.names import cell
from modal.recording.plan import SHOWN_OUTPUTS, Plan
from modal.report.words import damping_text, data_sentences, headline

__all__ = ["UNKNOWN", "bullets", "choices_text", "fit_text", "modes_text", "table"]

LISTED_OUTPUTS: Final = 40
UNKNOWN: Final = "–"
REASON_LETTERS: Final = 110


def fit_text(identification: Identification, plan: Plan) -> str:
    """What was found in one line, what must be read first, how well the outputs are repeated, and what is left over."""
    fit = identification.fit
    first = identification.records[0]
    parts = [f"### {headline(identification)}"]
    parts += [f"**Read this:** {cell(warning)}" for warning in identification.warnings]
    seen = "the model sees the inputs alone" if first.n_inputs else "the model predicts one step ahead, without inputs,"
    parts.append(
        f"Cross-validated fit **{_share(fit.mean)}**, mean over outputs: {seen} and is scored on rows that it was not "
        "fitted to."
    )
    listed = range(min(first.n_outputs, LISTED_OUTPUTS))
    rows = [
        [
            cell(first.output_names[i], 24),
            cell(first.output_units[i], 12) if first.output_units[i] else UNKNOWN,
            f"**{_share(fit.cross_validated[i])}**",
            _share(fit.whole[i]),
            _share(fit.one_step[i]),
        ]
        for i in listed
    ]
    parts.append(table(["output", "unit", "cross-validated", "all rows", "one step"], rows))
    if first.n_outputs > SHOWN_OUTPUTS:
        parts.append(f"Plots are shown for the first {SHOWN_OUTPUTS} of {first.n_outputs} outputs; all are stored.")
    parts.append(_observer_line(identification))
    parts += bullets(data_sentences(identification), identification.residuals.messages)
    if len(identification.records) > 1:
        parts.append(_records_table(identification, plan))
    if max(plan.buckets) > 1:
        parts.append(
            f"Long series are stored as the smallest and the largest of every {max(plan.buckets)} samples; the results "
            "come from all samples."
        )
    return "\n\n".join(parts)


def modes_text(identification: Identification, plan: Plan) -> str:
    """The table of all modes, noise included, with every indicator, the verdict and its reason."""
    head = ["", "f [Hz]", "±", "ζ [%]", "± ", "verdict", "γ", "EMAC", "MPC", "CMI", "MSV", "MPD [°]", "repeats", "P"]
    rows = [_mode_row(number, mode) for number, mode in enumerate(plan.modes, start=1)]
    parts = [table(*_with_content([*head, "kind", "why"], rows)) if rows else "The model has no mode."]
    parts += bullets(
        [
            f"{number}, {mode.frequency:.5g} Hz, {mode.verdict}: {mode.reason}"
            for number, mode in enumerate(plan.modes, start=1)
            if _start(mode.reason) != mode.reason
        ]
    )
    if identification.modes.indicators_missing:
        parts.append(f"Indicators are missing: {cell(identification.modes.indicators_missing)}")
    caution = identification.modes.indicator_caution
    spread = "±: one standard deviation. " if np.isfinite([mode.frequency_std for mode in plan.modes]).any() else ""
    parts.append(
        f"γ: amplitude coherence. EMAC: extended modal amplitude coherence. MPC: phase collinearity. CMI = EMAC · MPC. "
        f"MSV: mode singular value over the largest. MPD: mean phase deviation. {spread}n/(pq) = "
        f"{_number(caution, 2)}" + (": the indicators test the observer more than the data." if caution > 0.3 else ".")
    )
    if len(set(identification.records[0].output_units)) > 1 and plan.shapes:
        parts.append(
            "The outputs have different units: each unit has a line of its own, scaled to its own largest. The "
            "assurance is that of the numbers as they are, so units with large numbers weigh more in it."
        )
    return "\n\n".join(parts)


def choices_text(identification: Identification) -> str:
    """Every automatic choice with its reason, and the warnings."""
    rows = [[cell(c.what), f"**{cell(c.value, 80)}**", cell(c.reason)] for c in identification.choices]
    parts = ["### Choices", table(["what", "chosen", "why"], rows) if rows else "No choice was left open."]
    parts += ["### Warnings", *bullets(identification.warnings or ("None.",))]
    return "\n\n".join(parts)


def _observer_line(identification: Identification) -> str:
    observer, residuals = identification.observer, identification.residuals
    first = identification.records[0]
    n_samples = sum(record.n_samples for record in identification.records)
    correlation = f"; correlation with the input: {_number(residuals.input_correlation_ratio, 2)}" * bool(
        first.n_inputs
    )
    return (
        f"Observer order **{observer.order}**, model order **{identification.realisation.order}**; {first.n_inputs} "
        f"input{'s' * (first.n_inputs != 1)}, {first.n_outputs} output{'s' * (first.n_outputs != 1)}, {n_samples} "
        f"samples at {first.sampling_frequency:.6g} Hz, {observer.n_rows} complete rows fitted. Whiteness of the "
        f"one-step residual: {_number(residuals.whiteness_ratio, 2)} (1 is white, above 2 is not){correlation}."
    )


def _records_table(identification: Identification, plan: Plan) -> str:
    rows = [
        [cell(record.name, 40), f"{start:.6g} s", f"{stop:.6g} s", f"{shift:.6g} s" if shift else UNKNOWN]
        for record, start, stop, shift in zip(identification.records, plan.starts, plan.stops, plan.shifts, strict=True)
    ]
    return table(["record", "shown from", "to", "moved by"], rows)


def _mode_row(number: int, mode: Mode) -> list[str]:
    strong = "**" if mode.verdict == "system" else ""
    known = mode.kind != "real" and mode.damping_resolved
    damping = f"{strong}{100 * mode.damping_ratio:#.3g}{strong}" if known else damping_text(mode)
    indicators = [mode.amplitude_coherence, mode.emac, mode.phase_collinearity, mode.cmi, mode.msv]
    return [
        str(number),
        f"{strong}{mode.frequency:#.5g}{strong}",
        _figures(mode.frequency_std),
        damping,
        _figures(100 * mode.damping_ratio_std) if known else UNKNOWN,
        f"{strong}{mode.verdict}{strong}",
        *[_number(value, 2) for value in indicators],
        _number(mode.mpd, 0),
        _number(mode.repeatability, 2),
        _number(mode.probability, 2),
        mode.kind,
        cell(_start(mode.reason)) if mode.reason else UNKNOWN,
    ]


def _start(reason: str) -> str:
    """What fits beside the numbers on a common screen; the whole of a longer reason stands below the table."""
    return reason if len(reason) <= REASON_LETTERS else reason[: REASON_LETTERS - 1].rstrip() + "…"


def _with_content(head: Sequence[str], rows: Sequence[Sequence[str]]) -> tuple[list[str], list[list[str]]]:
    """Leave out columns that say nothing: no value in any row, or every pole oscillatory."""
    said = [k for k in range(len(head)) if {row[k] for row in rows} - {UNKNOWN, "oscillatory"}]
    return [head[k] for k in said], [[row[k] for k in said] for row in rows]


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table of cells that are harmless already."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def bullets(*groups: Sequence[str]) -> list[str]:
    """The sentences as one Markdown list, made harmless; nothing where there is no sentence."""
    lines = [f"- {cell(message)}" for group in groups for message in group]
    return ["\n".join(lines)] if lines else []


def _share(value: float) -> str:
    return f"{100 * value:.1f} %" if np.isfinite(value) else UNKNOWN


def _number(value: float, decimals: int) -> str:
    return f"{value:.{decimals}f}" if np.isfinite(value) else UNKNOWN


def _figures(value: float) -> str:
    return f"{value:.2g}" if np.isfinite(value) else UNKNOWN
