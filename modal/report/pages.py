"""The pages for people: the same sections in HTML (with pictures) and in Markdown (without)."""

import platform
from collections.abc import Mapping

import numpy as np

from modal.identification.result import Identification
from modal.identification.trust import caution_sentence, trust_of
from modal.modes.numbering import numbered
from modal.report.moving_shapes import moving_shapes, placement_of
from modal.report.page_environment import environment, inline, page_script
from modal.report.picture import Picture
from modal.report.pictures import MOST_ASSURED, shape_assurance
from modal.report.setting import NOTHING_BESIDES, Setting
from modal.sections import words
from modal.sections.columns import INDICATORS
from modal.sections.limit_words import limits_sentence, limits_short
from modal.sections.provenance import Provenance, installed_version
from modal.sections.setup_values import about_lines, channel_rows, sensor_columns
from modal.sections.uncertainty_words import has_intervals, uncertainty_sentences
from modal.sections.validation import coherence_sentence, gap_command, gap_sentence, validation_sentences
from okid.record import InputHold

__all__ = ["environment", "hold_text", "html_text", "inline", "markdown_text"]

MOST_SUMMED_UP = 10
"""Modes of the system on the page of the verdict; the table of all poles has all of them."""

MOST_FINDINGS = 40
"""Findings on the data that are shown, the worst first."""

GIVEN = "given as an argument"
"""Reason of a choice that was none."""

VERDICTS = (
    ("system", "Modes of the system", "Found again in other data, with other observers and at other orders."),
    ("doubtful", "Doubtful", "May be modes of the system; the data do not settle it. Do not quote them."),
    ("noise", "Noise", "What the model needs to describe this record, but no property of the system."),
)


def html_text(
    result: Identification,
    provenance: Provenance,
    pictures: Mapping[str, Picture],
    setting: Setting = NOTHING_BESIDES,
    *,
    beside: str = "",
) -> str:
    """One page that needs nothing but itself.

    Args:
        result: of `modal.identify`.
        provenance: command and files.
        pictures: of `draw_pictures`.
        setting: what is known besides the result.
        beside: the other files of the report, in words.
    """
    drawn = {name: inline(picture) for name, picture in pictures.items()}
    script, script_hash = page_script()
    template = environment(html=True).get_template("report.html.j2")
    return (
        template.render(
            **_context(result, provenance, setting, beside),
            pictures=drawn,
            moving=moving_shapes(result, setting),
            script=script,
            script_hash=script_hash,
        )
        + "\n"
    )


def markdown_text(
    result: Identification, provenance: Provenance, setting: Setting = NOTHING_BESIDES, *, beside: str = ""
) -> str:
    """The same words and tables as Markdown."""
    template = environment(html=False).get_template("report.md.j2")
    return template.render(**_context(result, provenance, setting, beside)) + "\n"


def _context(result: Identification, provenance: Provenance, setting: Setting, beside: str) -> dict[str, object]:
    return {
        **_verdict_values(result),
        **_limit_values(setting),
        **_data_values(result, setting),
        **_mode_values(result, setting),
        "validation": validation_sentences(result),
        "coherence": coherence_sentence(setting.quality),
        "gap_sentence": gap_sentence(result),
        "gap_command": gap_command(result, provenance),
        "uncertainty": uncertainty_sentences(result),
        "folds": [float(fold) for fold in np.atleast_1d(result.fit.folds)],
        "provenance": provenance,
        "version": installed_version(),
        "python_version": platform.python_version(),
        "numpy_version": np.__version__,
        "snippet": _snippet(result, provenance),
        "beside": beside or "the other files of the report",
    }


def _verdict_values(result: Identification) -> dict[str, object]:
    record = result.records[0]
    return {
        "title": _title(result),
        "headline": words.modes_headline(result),
        "judgement": trust_of(result),
        "fit_word": words.fit_word(result.fit.mean),
        "result": result,
        "record": record,
        "n_samples": sum(each.n_samples for each in result.records),
        "n_missing": sum(int(each.n_samples - each.complete_rows().sum()) for each in result.records),
        "duration": sum(each.duration for each in result.records),
        "hold": hold_text(record.input_hold),
    }


def _limit_values(setting: Setting) -> dict[str, object]:
    states = [one.state for one in setting.outcomes]
    return {
        "outcomes": setting.outcomes,
        "limits_met": all(state == "met" for state in states),
        "limits_missed": "not met" in states,
        "limits_sentence": limits_sentence(setting.outcomes),
        "limits_short": limits_short(setting.outcomes),
    }


def _data_values(result: Identification, setting: Setting) -> dict[str, object]:
    quality = setting.quality
    level = "not looked at" if quality is None else quality.level
    findings = () if quality is None else quality.findings
    return {
        "about": about_lines(setting.specification),
        "channels": channel_rows(result, setting.specification),
        "sensor_columns": sensor_columns(setting.specification),
        "quality": quality,
        "quality_of": setting.quality_of,
        "n_to_look_at": sum(finding.level != "note" for finding in findings),
        "quality_word": level,
        "quality_class": {"bad": "fault", "doubtful": "doubtful", "good": "good"}.get(level, "noise"),
        "findings": findings[:MOST_FINDINGS],
        "n_more_findings": max(0, len(findings) - MOST_FINDINGS),
        "data_sentences": words.data_sentences(result),
    }


def _mode_values(result: Identification, setting: Setting) -> dict[str, object]:
    modes = result.modes
    groups = [
        (verdict, heading, meaning, [row for row in numbered(modes) if row[1].verdict == verdict])
        for verdict, heading, meaning in VERDICTS
    ]
    believed = groups[0][3]
    return {
        "groups": groups,
        "summary": believed[:MOST_SUMMED_UP],
        "n_more_modes": max(0, len(believed) - MOST_SUMMED_UP),
        "indicators": INDICATORS,
        "caution": caution_sentence(result),
        "assurance": shape_assurance(result)[:MOST_ASSURED, :MOST_ASSURED].tolist() if modes.system else [],
        "frequencies": modes.frequencies[:MOST_ASSURED].tolist(),
        "has_intervals": has_intervals(result),
        "has_geometry": setting.geometry is not None,
        "placement_sentences": placement_of(result, setting).sentences,
    }


def hold_text(hold: InputHold) -> str:
    """What the input did between samples, in words."""
    return {
        "zero_order": "held between samples",
        "linear": "straight lines between samples",
        "band_limited": "band-limited, as behind an anti-alias filter",
    }[hold]


def _title(result: Identification) -> str:
    names = [record.name for record in result.records if record.name]
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "") or "Unnamed record"


def _snippet(result: Identification, provenance: Provenance) -> str:
    """Python that makes the result again; names are written as Python literals of ASCII."""
    record = result.records[0]
    reading = "...  # the records of this result"
    if provenance.sources:
        step = "" if provenance.dt is None else f"    dt={provenance.dt!r},\n"
        reading = (
            "okid.read_records(\n"
            f"    {list(provenance.sources)!a},\n"
            f"    inputs={list(record.input_names)!a},\n"
            f"    outputs={list(record.output_names)!a},\n"
            f"{step}    input_hold={record.input_hold!a},\n)"
        )
    order = (result.fitted_model or result.realisation).order
    given = {choice.what for choice in result.choices if choice.reason == GIVEN}
    settings = (
        ("observer order", f"observer_order={result.observer.order}"),
        ("ridge", f"ridge={result.observer.ridge!r}"),
        ("model order", f"order={order}"),
    )
    arguments = ", ".join(["records", *(text for what, text in settings if what in given)])
    chosen = ", ".join(text for what, text in settings if what not in given)
    return (
        "import modal\nimport okid\n\n"
        f"records = {reading}\n"
        f"result = modal.identify({arguments}){'  # it chose ' + chosen if chosen else ''}\n"
        'modal.write_report(result, "report")'
    )
