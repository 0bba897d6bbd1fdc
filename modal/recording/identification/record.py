"""The page "Record": what was measured, over time and over frequency, and what there is to say against it.

It opens with a result, and before any fit in the live view; its words give the verdict on the data, what was found, and
a row a channel.
"""

from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np

from modal.plots.chart import grid_of
from modal.plots.panels import IN_TURN, STYLE
from modal.plots.responses import density_label
from modal.preparation.channel import Finding
from modal.quality.check import DataQuality
from modal.recording.figure import (
    COLOURS,
    Colour,
    Palette,
    Pane,
    RecordingStream,
    document_view,
    log_chart,
    plot_view,
    rr,
    rrb,
    series_view,
)
from modal.recording.identification.fit import inputs_view
from modal.recording.plan import (
    DataPlan,
    Views,
    WordLimits,
    bullets,
    cell,
    known,
    label,
    log_table,
    log_text,
    name_with_unit,
    table,
    unit_cell,
)
from modal.recording.series import TIMELINE, Interpolation, Line, log_lines, time_axis
from okid.record import Record


class RecordLimits:
    """How much of a record is shown."""

    MOST_MARKS: Final = 10
    """Mark so many findings on the time axis, a row each."""
    SHOWN_SPECTRA: Final = 6
    """Draw the spectra of so many inputs and of so many outputs."""


def quality_text(quality: DataQuality, records: Sequence[Record]) -> str:
    """What the data are good for, before any model."""
    first = records[0]
    n_samples = sum(record.n_samples for record in records)
    seconds = sum(record.n_samples * record.dt for record in records)
    of = f"{len(records)} records, " if len(records) > 1 else ""
    extent = (
        f"{of}{n_samples} samples at {first.sampling_frequency:.6g} Hz, {seconds:.4g} s in all; "
        f"{_count(first.n_inputs, 'input')}, {_count(first.n_outputs, 'output')}."
    )
    parts = [f"### {cell(quality.verdict)}", extent]
    found = quality.findings[:20]
    lines = [
        f"{k}. **{one.level}**, {cell(one.where, 80)}: {cell(one.sentence)}" for k, one in enumerate(found, start=1)
    ]
    parts.append("\n".join(lines))
    left = len(quality.findings) - len(found)
    if left:
        parts += bullets([f"{_count(left, 'finding')} more; all are stored."])
    head = ["channel", "unit", "deviation", "largest", "over noise", "explained", "data"]
    rows = [
        [
            cell(one.name, 24),
            unit_cell(one.unit),
            known(one.statistics.std, ".3g"),
            known(max(abs(one.statistics.smallest), abs(one.statistics.largest)), ".3g"),
            known(one.statistics.signal_to_noise, ".0f", " dB"),
            known(100 * one.statistics.explained, ".1f", " %"),
            one.level if one.level == "good" else f"**{one.level}**",
        ]
        for one in quality.channels[: WordLimits.LISTED]
    ]
    parts.append(table(head, rows))
    if first.n_inputs:
        parts.append(
            "Over noise: power of the channel over that of broadband noise, at least. Explained: share of an output's "
            "power that the inputs explain by a linear law (coherence)."
        )
    return "\n\n".join(part for part in parts if part)


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'s' * (number != 1)}"


LEVEL_COLOURS: Final[dict[str, Colour]] = {"bad": Palette.RED, "doubtful": Palette.GOLD, "note": (140, 165, 210)}

INPUT_ROLES: Final = (*IN_TURN[4:], *IN_TURN[:4])
"""Draw inputs in these colours, in turn, gold first."""


def quality_path(plan: DataPlan) -> str:
    """Where the quality of the data stands in words."""
    return f"{plan.root}/quality/text"


def marks_path(plan: DataPlan) -> str:
    """The entity above the marks of findings on the time axis."""
    return f"{plan.root}/quality/mark"


def spectra_pane(plan: DataPlan) -> Pane:
    """Where spectra and coherence are drawn."""
    return Pane(f"{plan.root}/spectra/plot", 560.0, 570.0)


def marked(quality: DataQuality) -> list[tuple[int, Finding]]:
    """The findings that lie somewhere in time and are marked there, with their numbers in the words."""
    placed = [(number, finding) for number, finding in enumerate(quality.findings, start=1) if finding.spans]
    return placed[: RecordLimits.MOST_MARKS]


def log_record_page(
    records: Sequence[Record], recording: RecordingStream, plan: DataPlan, quality: DataQuality
) -> None:
    """Every measured channel over time, where each record stands, spectra and coherence, the quality in words."""
    _log_channels(records, recording, plan)
    _log_places(records, recording, plan)
    log_text(recording, quality_path(plan), quality_text(quality, records))
    _log_numbers(quality, recording, plan)
    _log_marks(records, quality, recording, plan)
    _draw_spectra(quality, recording, plan)


def _log_channels(records: Sequence[Record], recording: RecordingStream, plan: DataPlan) -> None:
    times = time_axis(records, plan)
    first = records[0]
    for i, path in enumerate(plan.input_paths):
        line = Line(
            channels=[record.inputs[:, i] for record in records],
            name=name_with_unit(first.input_names[i], first.input_units[i]),
            colour=COLOURS[INPUT_ROLES[i % len(INPUT_ROLES)]],
        )
        between: Interpolation = "StepAfter" if first.input_hold == "zero_order" else "Linear"
        log_lines(recording, path, times, [line], plan=plan, interpolation=between)
    for i, path in enumerate(plan.output_paths):
        channels = [record.outputs[:, i] for record in records]
        line = Line(channels=channels, name="measured", colour=Palette.BLUE, width=3.0)
        log_lines(recording, path, times, [line], plan=plan)


def _log_places(records: Sequence[Record], recording: RecordingStream, plan: DataPlan) -> None:
    columns: dict[str, Iterable[object]] = {
        "name": [record.name for record in records],
        "n_samples": [record.n_samples for record in records],
        "dt": [record.dt for record in records],
        "start_time": [record.start_time for record in records],
        "shown_from": plan.starts,
        "samples_per_bucket": [max(part.bucket for part in kept) for kept in plan.levels],
    }
    log_table(recording, f"{plan.root}/records", "record", np.arange(1, len(records) + 1), columns)


def _log_numbers(quality: DataQuality, recording: RecordingStream, plan: DataPlan) -> None:
    found = quality.findings
    findings: dict[str, Iterable[object]] = {
        name: [getattr(finding, name) for finding in found] for name in ("what", "where", "sentence", "share")
    }
    # not "level": a name of a column has one type in the whole of Rerun, and levels of excitation are numbers
    findings["severity"] = [one.level for one in found]
    findings["channels"] = [", ".join(one.channels) for one in found]
    for k, name in enumerate(("span_record", "span_from", "span_to")):
        findings[name] = [[span[k] + (k == 0) for span in one.spans] for one in found]
    log_table(recording, f"{plan.root}/quality/findings", "finding", np.arange(1, len(found) + 1), findings)
    fields = ("mean", "std", "smallest", "largest", "noise_floor", "signal_to_noise", "explained", "n_missing")
    channels: dict[str, Iterable[object]] = {
        name: [getattr(one, name) for one in quality.channels] for name in ("name", "role", "unit")
    }
    channels["severity"] = [one.level for one in quality.channels]
    channels |= {name: [getattr(one.statistics, name) for one in quality.channels] for name in fields}
    index = np.arange(1, len(quality.channels) + 1)
    log_table(recording, f"{plan.root}/quality/channels", "channel", index, channels)
    lines = np.arange(1, quality.frequencies.size + 1)
    spectra: dict[str, Iterable[object]] = {"frequency": quality.frequencies, "density": quality.densities}
    log_table(recording, f"{plan.root}/spectra/numbers", "frequency_line", lines, spectra)
    if quality.coherence is not None:
        one = quality.coherence
        lines = np.arange(1, one.frequencies.size + 1)
        coherence: dict[str, Iterable[object]] = {
            "frequency": one.frequencies,
            "multiple_coherence": one.multiple_coherence,
        }
        log_table(recording, f"{plan.root}/coherence/numbers", "frequency_line", lines, coherence)


def _log_marks(records: Sequence[Record], quality: DataQuality, recording: RecordingStream, plan: DataPlan) -> None:
    """A bar over every time of a finding, findings one below the other in the order of the words.

    A bar is at least so long that it is seen; the table "quality/findings" has the times themselves.
    """
    shortest = 0.004 * (plan.stop - plan.start)  # so that it is seen

    for row, (number, finding) in enumerate(marked(quality), start=1):
        times: list[float] = []
        for record, begin, end in sorted(finding.spans):
            dt = records[record].dt
            start = begin + plan.shifts[record]
            if times:  # bars that touch are one bar, and time never goes back
                start = max(start, times[-1] + 0.25 * dt)
            stop = max(end + plan.shifts[record], start + shortest, start + dt)
            times += [start, stop, stop + 0.25 * dt]
        path = f"{marks_path(plan)}/{row:02d}"
        # an empty row after each bar breaks the line there
        columns = rr.Scalars.columns(scalars=[-float(row)] * (len(times) // 3 * 2)).partition(
            [1, 1, 0] * (len(times) // 3)
        )
        recording.send_columns(path, [rr.TimeColumn(TIMELINE, duration=times)], columns, strict=True)
        names = ", ".join(finding.channels) or "all channels"
        style = rr.SeriesLines(
            names=label(f"{number}. {finding.what}: {names}", 40),
            colors=LEVEL_COLOURS[finding.level],
            widths=6.0,
            aggregation_policy="MinMax",
        )
        recording.log(path, style, static=True, strict=True)


def _draw_spectra(quality: DataQuality, recording: RecordingStream, plan: DataPlan) -> None:
    """Inputs over outputs over coherence, all over one axis of frequency."""
    if not quality.frequencies.size:
        return
    coherence = quality.coherence
    n_inputs = sum(channel.role == "input" for channel in quality.channels)  # as read: a decay's release is none
    n_outputs = len(quality.channels) - n_inputs
    bands = [("output", n_inputs, n_outputs, IN_TURN)]
    if n_inputs:
        bands = [("input", 0, n_inputs, INPUT_ROLES), *bands]
    chart = grid_of(len(bands) + (coherence is not None), 1, size=(STYLE.page, STYLE.page))
    for panel, (role, start, count, roles) in zip(chart.panels, bands, strict=False):
        shown = range(start, start + min(count, RecordLimits.SHOWN_SPECTRA))
        for i, channel in enumerate(shown):
            name, density = label(quality.channels[channel].name, 14), quality.densities[:, channel]
            panel.line(quality.frequencies, density, roles[i % len(roles)], width=STYLE.thin, label=name)
        high = float(np.nanmax(quality.densities[:, shown], initial=0.0))
        seen = quality.densities[:, shown].ravel()
        panel.y.log = True
        panel.y.limits = panel.y.fitted(seen[seen >= high * 1e-8])  # decades below the peak
        panel.y.label, panel.key = f"{role}s [{_density_unit(quality, role)}]", "best"
    if coherence is not None:
        panel = chart.panels[-1]
        for i in range(min(n_outputs, RecordLimits.SHOWN_SPECTRA)):
            values = coherence.multiple_coherence[:, i]
            panel.line(coherence.frequencies, values, IN_TURN[i % len(IN_TURN)], width=STYLE.thin)
        panel.y.label, panel.y.limits = "coherence", (0.0, 1.04)
    for panel in chart.panels:
        panel.x.limits, panel.x.labelled = (0.0, float(quality.frequencies[-1])), panel is chart.panels[-1]
    chart.panels[-1].x.label = "frequency [Hz]"
    log_chart(recording, spectra_pane(plan), chart)


def _density_unit(quality: DataQuality, role: str) -> str:
    """Of the channels of a role: their own where they have one unit."""
    units = {one.unit for one in quality.channels if one.role == role}
    unit = units.pop() if len(units) == 1 else ""
    return density_label(unit) if unit else "unit²/Hz"


def record_page(records: Sequence[Record], plan: DataPlan, quality: DataQuality) -> Any:
    """Inputs, findings on the time axis, outputs; to the right the quality in words over spectra and coherence."""
    rows = inputs_view(plan)
    shares = [1.0] * len(rows)
    marks = marked(quality)
    if marks:
        rows.append(_marks_view(plan, len(marks)))
        shares.append(0.5 + 0.09 * len(marks))
    rows += [_outputs(records, plan)]
    shares.append(0.9 * -(-len(plan.shown_outputs) // _columns(plan)))
    left = rrb.Vertical(*rows, row_shares=shares, name="Channels")
    words = [document_view(quality_path(plan), "Data quality")]
    if quality.frequencies.size:
        pane = spectra_pane(plan)
        words.append(plot_view(pane, "Spectra" if quality.coherence is None else "Spectra and coherence"))
    right = rrb.Vertical(*words, row_shares=[1.0, 1.9][: len(words)], name="Quality")
    return rrb.Horizontal(left, right, column_shares=[1.7, 1.0], name="Record")


def _columns(plan: DataPlan) -> int:
    return 1 if len(plan.shown_outputs) <= 4 else 2


def _outputs(records: Sequence[Record], plan: DataPlan) -> Any:
    first = records[0]
    views = []
    for i in plan.shown_outputs:
        title = name_with_unit(first.output_names[i], first.output_units[i])
        view = series_view(plan.output_paths[i], title, ["$origin"], legend=False)
        view.visualizer_overrides[plan.output_paths[i]] = _thin(i)
        views.append(view)
    n_outputs = first.n_outputs
    name = "Outputs" if n_outputs <= Views.OUTPUTS else f"Outputs, the first {Views.OUTPUTS} of {n_outputs}"
    return rrb.Grid(*views, grid_columns=_columns(plan), name=name)


def _thin(output: int) -> Any:
    """The style on this page: the colour that the output has in the spectra, and a thin line."""
    colour = COLOURS[IN_TURN[output % len(IN_TURN)]]
    return rr.SeriesLines.from_fields(colors=colour, widths=1.0, aggregation_policy="MinMax")


def _marks_view(plan: DataPlan, n_marks: int) -> Any:
    view = series_view(marks_path(plan), "What was found, and when", ["$origin/**"])
    view.properties["ScalarAxis"] = rrb.ScalarAxis(range=(-n_marks - 0.7, -0.3), zoom_lock=True)
    return view
