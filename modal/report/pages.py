"""The pages for people: the same sections in HTML (with pictures) and in Markdown (without).

Text that came from a file is made harmless in both; the shapes are numbers for the page's script, which moves them.
"""

import base64
import hashlib
import json
import platform
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Final

import numpy as np

from modal.geometry.placement import Placement, placed
from modal.identification.result import Identification
from modal.identification.words import (
    caution_sentence,
    damping_shown,
    damping_text,
    frequency_text,
    mass_sentence,
    mass_text,
)
from modal.modes.mode import Mode, numbered
from modal.plots.results import shape_assurance
from modal.quality import DataQuality
from modal.report.pictures import NOTHING_BESIDES, Picture, PictureLimits, Setting
from modal.sections import words
from modal.sections.validation import (
    Provenance,
    about_lines,
    channel_rows,
    coherence_sentence,
    gap_command,
    gap_sentence,
    has_intervals,
    installed_version,
    sensor_columns,
    uncertainty_sentences,
    validation_sentences,
)
from modal.sections.words import INDICATORS, limits_class, limits_sentence, limits_short, shown
from modal.verdict.judgement import LEAST_PART
from modal.wording.text import escape_markdown, fit_text, hertz, ratio_text, reproduced, whole_percent
from okid.arrays import ComplexArray, FloatArray
from okid.errors import visible
from okid.record import InputHold

if TYPE_CHECKING:
    import jinja2
    from markupsafe import Markup


class PageLimits:
    """How much a page shows."""

    MOST_NODES: Final = 1500
    """Nodes of a structure that a page turns smoothly; a larger one is left to the recording."""
    MOST_DEFLECTIONS: Final = 12_000
    """Nodes times modes: about half a megabyte of the page. Of a large structure fewer modes can be chosen."""
    MOST_SUMMED_UP: Final = 10
    """Modes of the system on the page of the verdict; the table of all poles has all of them."""
    MOST_CHANNELS: Final = 10
    """Show so many channels, the worst first; the others are folded."""
    MOST_FINDINGS: Final = 40
    """Findings on the data that are shown, the worst first."""


OBLIQUE = (-0.62, 0.36)
"""Turn and tilt from which all three directions are seen."""

SWING = 0.22
"""Greatest deflection over the largest extent of the structure."""


def placement_of(result: Identification, setting: Setting) -> Placement:
    """The outputs on the geometry, or in a row without one."""
    record = result.channels
    return placed(setting.geometry, record.output_names, record.output_units)


def moving_shapes(result: Identification, setting: Setting) -> "Markup | str":
    """Nodes, lines and deflections as JSON without any letter that could end a tag; "" where nothing is to move."""
    from markupsafe import Markup

    placement = placement_of(result, setting)
    geometry = placement.geometry
    modes = result.modes.system[: min(24, PageLimits.MOST_DEFLECTIONS // max(1, geometry.n_nodes))]
    if not modes or geometry.n_nodes > PageLimits.MOST_NODES:
        return ""
    deflections = [placement.deflection(mode) for mode in modes]
    centre = (geometry.positions.max(axis=0) + geometry.positions.min(axis=0)) / 2
    document = {
        "nodes": _rows((geometry.positions - centre) / geometry.size),
        "lines": [list(line) for line in geometry.lines],
        "surfaces": [list(surface) for surface in geometry.surfaces],
        "home": _side_seen(placement, deflections),
        "modes": [
            {
                "name": f"{hertz(mode.frequency)} Hz",
                "real": _rows(SWING * deflection.real),
                "imaginary": _rows(SWING * deflection.imag),
            }
            for mode, deflection in zip(modes, deflections, strict=True)
        ],
    }
    text = json.dumps(document, allow_nan=False, separators=(",", ":"))
    return Markup(text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026"))  # noqa: S704 - see there


def _side_seen(placement: Placement, deflections: Sequence[ComplexArray]) -> tuple[float, float]:
    """Turn about the vertical and tilt [rad] at first: from the side where sticks move in one plane, else oblique."""
    sideways = max(float(np.abs(deflection[:, 1]).max()) for deflection in deflections)
    if placement.is_given or sideways > 0.0:
        return OBLIQUE
    return (0.0, 0.35) if np.ptp(placement.geometry.positions[:, 1]) > 0 else (0.0, 0.0)


def _rows(values: FloatArray) -> list[list[float]]:
    """To four decimals of the size of the structure: finer than a pixel."""
    return [[round(float(value), 4) + 0.0 for value in row] for row in np.nan_to_num(values)]


_LEVEL_CLASSES = {"bad": "fault", "doubtful": "doubtful", "good": "good"}


def environment(*, html: bool) -> "jinja2.Environment":
    """The templates of a report, with their filters.

    Args:
        html: escape for HTML, else for Markdown.
    """
    import jinja2

    made = jinja2.Environment(
        loader=jinja2.PackageLoader("modal.report", "templates"),
        autoescape=html,  # noqa: S701 - Markdown has its own escape, _finalize_markdown
        finalize=_finalize_html if html else _finalize_markdown,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters["num"] = shown
    made.filters["literal"] = _literal
    made.filters["lines"] = _lines
    made.filters["frequency"] = frequency_text
    made.filters["damping"] = damping_text
    made.filters["mass"] = mass_text
    made.filters["damping_shown"] = damping_shown
    made.filters["hertz"] = hertz
    made.filters["percent"] = ratio_text
    made.filters["fit"] = fit_text
    made.filters["share"] = whole_percent
    made.filters["reproduced"] = reproduced
    made.filters["remark"] = words.remark_of
    made.filters["again"] = _again
    made.filters["limit_class"] = limits_class
    made.filters["level_class"] = lambda level: _LEVEL_CLASSES.get(level, "noise")
    return made


def inline(picture: Picture) -> dict[str, str]:
    """A picture for a template."""
    from markupsafe import Markup

    return {
        "svg": Markup(picture.svg),  # noqa: S704 - svg_text escapes its text
        "caption": picture.caption,
        "chart": Markup(picture.chart),  # noqa: S704 - chart_text leaves no letter that ends a tag
    }


@cache
def page_script() -> tuple[str, str]:
    """The script of the page, and the hash by which its Content-Security-Policy lets it run, and no other.

    Returns:
        Its text as it stands between the tags, and base64 of its SHA-256.
    """
    from markupsafe import Markup

    templates = resources.files("modal.report").joinpath("templates")
    text = "".join(templates.joinpath(name).read_text(encoding="utf-8") for name in ("page.js", "shapes.js"))
    digest = base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode("ascii")
    return Markup(text), digest  # noqa: S704 - our own file


def _finalize_html(value: object) -> object:
    """Names made harmless, and no line that begins with a percent sign."""
    return visible(value).replace(" %", "\N{NO-BREAK SPACE}%") if type(value) is str else value


def _finalize_markdown(value: object) -> object:
    return escape_markdown(value) if type(value) is str else value


def _literal(text: str) -> object:
    """Lines of an indented code block, in which Markdown takes every letter as it is."""
    from markupsafe import Markup

    return Markup("\n    ").join(Markup(visible(line)) for line in text.split("\n"))  # noqa: S704 - Markdown, not HTML


def _lines(text: str) -> object:
    """Lines of a block that keeps them, each made harmless: a page would run them together otherwise."""
    from markupsafe import Markup, escape

    return Markup("\n").join(escape(visible(line)) for line in text.split("\n"))


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
    """One page that needs nothing but itself."""
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
        **_verdict_values(result, setting.quality),
        **_limit_values(setting),
        **_data_values(result, setting),
        "next_sentences": words.next_sentences(result, setting.quality),
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


def _verdict_values(result: Identification, quality: DataQuality | None) -> dict[str, object]:
    record = result.records[0] if result.records else None
    return {
        "title": _title(result),
        "headline": words.modes_headline(result),
        "judgement": words.judgement_of(result, quality),
        "fit_word": words.fit_word(result.fit.mean),
        "result": result,
        "record": record,
        "names": result.channels,
        "n_samples": sum(each.n_samples for each in result.records),
        "n_missing": sum(int(each.n_samples - each.complete_rows().sum()) for each in result.records),
        "duration": sum(each.duration for each in result.records),
        "hold": "" if record is None or not record.n_inputs else hold_text(record.input_hold),
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
        "channels": channel_rows(result, setting.specification, quality),
        "most_channels": PageLimits.MOST_CHANNELS,
        "sensor_columns": sensor_columns(setting.specification),
        "quality": quality,
        "quality_of": setting.quality_of,
        "n_to_look_at": sum(finding.level != "note" for finding in findings),
        "quality_word": level,
        "quality_class": {"bad": "fault", "doubtful": "doubtful", "good": "good"}.get(level, "noise"),
        "findings": findings[: PageLimits.MOST_FINDINGS],
        "n_more_findings": max(0, len(findings) - PageLimits.MOST_FINDINGS),
        "data_sentences": words.data_sentences(result),
        "inputs_measured": result.channels.n_inputs > 0 and result.record_kind != "decay",
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
        "summary": believed[: PageLimits.MOST_SUMMED_UP],
        "changes": _changes(mode for _, mode in believed),
        "remarked": any(words.remark_of(mode) for _, mode in believed[: PageLimits.MOST_SUMMED_UP]),
        "weighed": bool(np.isfinite([mode.modal_mass for mode in modes]).any()),
        "mass_sentence": mass_sentence(result),
        "least_part": LEAST_PART,
        "n_more_modes": max(0, len(believed) - PageLimits.MOST_SUMMED_UP),
        "indicators": INDICATORS,
        "caution": caution_sentence(result),
        "assurance": shape_assurance(result)[: PictureLimits.MOST_ASSURED, : PictureLimits.MOST_ASSURED].tolist()
        if modes.system
        else [],
        "frequencies": modes.frequencies[: PictureLimits.MOST_ASSURED].tolist(),
        "has_intervals": has_intervals(result),
        "has_geometry": setting.geometry is not None,
        "placement_sentences": placement_of(result, setting).sentences,
    }


def _changes(modes: Iterable[Mode]) -> tuple[str, ...]:
    """What was changed when the modes were identified again, one a column of the table of modes."""
    return next((tuple(what for what, _ in mode.reappears) for mode in modes if mode.reappears), ("any change",))


def _again(mode: Mode) -> tuple[float, ...]:
    """How well a mode came back under each change; their mean where no more is known."""
    return tuple(overlap for _, overlap in mode.reappears) or (mode.repeatability,)


def hold_text(hold: InputHold) -> str:
    """What the input did between samples, in words."""
    return {
        "zero_order": "held between samples",
        "linear": "straight lines between samples",
        "band_limited": "band-limited, as behind an anti-alias filter",
    }[hold]


def _title(result: Identification) -> str:
    sources = result.records or (result.channels,)
    names = [source.name for source in sources if source.name]
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "") or "Unnamed record"


def _snippet(result: Identification, provenance: Provenance) -> str:
    """Python that makes the result again; names are written as Python literals of ASCII."""
    if result.response is not None or not result.records:
        table = "...  # the frequency responses of this result"
        if provenance.sources:
            table = f"okid.read_response({provenance.sources[0]!a})"
        return (
            f"import modal\nimport okid\n\ntable = {table}\nresult = modal.identify(table)\n"
            'modal.write_report(result, "report")'
        )
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
    observer = result.observer  # ambient set-ups have one each
    fitted = (
        ()
        if observer is None
        else (
            ("observer order", f"observer_order={observer.order}"),
            ("ridge", f"ridge={observer.ridge!r}"),
        )
    )
    settings = (
        *fitted,
        ("model order", f"order={order}"),
        ("record kind", f"kind={result.record_kind!a}"),
    )
    arguments = ", ".join(["records", *(text for what, text in settings if what in given)])
    chosen = ", ".join(text for what, text in settings if what not in given and what != "record kind")
    return (
        "import modal\nimport okid\n\n"
        f"records = {reading}\n"
        f"result = modal.identify({arguments}){'  # it chose ' + chosen if chosen else ''}\n"
        'modal.write_report(result, "report")'
    )
