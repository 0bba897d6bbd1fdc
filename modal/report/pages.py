"""The pages for people: the same sections in HTML (with pictures) and in Markdown (without)."""

import platform
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from modal.identification import Identification
from modal.names import escape_markdown, visible
from modal.numbering import numbered
from modal.report import words
from modal.report.columns import INDICATORS, shown
from modal.report.pictures import Picture, shape_assurance
from modal.report.provenance import Provenance, installed_version
from okid.record import InputHold

if TYPE_CHECKING:
    import jinja2

__all__ = ["environment", "hold_text", "html_text", "inline", "markdown_text"]

VERDICTS = (
    ("system", "Modes of the system", "Found again in other data, with other observers and at other orders."),
    ("doubtful", "Doubtful", "May be modes of the system; the data do not settle it. Do not quote them."),
    ("noise", "Noise", "What the model needs to describe this record, but no property of the system."),
)


def html_text(result: Identification, provenance: Provenance, pictures: Mapping[str, Picture]) -> str:
    """One page that needs nothing but itself."""
    drawn = {name: inline(picture) for name, picture in pictures.items()}
    template = environment(html=True).get_template("report.html.j2")
    return template.render(**_context(result, provenance), pictures=drawn) + "\n"


def inline(picture: Picture) -> dict[str, str]:
    """A picture for a template."""
    from markupsafe import Markup

    return {"svg": Markup(picture.svg), "caption": picture.caption}  # noqa: S704 - svg_text escapes its text


def markdown_text(result: Identification, provenance: Provenance) -> str:
    """The same words and tables as Markdown."""
    return environment(html=False).get_template("report.md.j2").render(**_context(result, provenance)) + "\n"


def environment(*, html: bool) -> "jinja2.Environment":
    """Where templates are found, and how the text of names is made harmless in HTML or in Markdown."""
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
    made.filters["frequency"] = words.frequency_text
    made.filters["damping"] = words.damping_text
    made.filters["hertz"] = words.hertz
    made.filters["percent"] = words.percent
    made.filters["fit"] = words.fit_text
    return made


def _finalize_html(value: object) -> object:
    """Names made harmless, and no line that begins with a percent sign."""
    return visible(value).replace(" %", "\N{NO-BREAK SPACE}%") if type(value) is str else value


def _finalize_markdown(value: object) -> object:
    return escape_markdown(value) if type(value) is str else value


def _context(result: Identification, provenance: Provenance) -> dict[str, object]:
    record = result.records[0]
    modes = result.modes
    return {
        "title": _title(result),
        "headline": words.headline(result),
        "judgement": words.judge(result),
        "fit_word": words.fit_word(result.fit.mean),
        "result": result,
        "record": record,
        "n_samples": sum(each.n_samples for each in result.records),
        "n_missing": sum(int(each.n_samples - each.complete_rows().sum()) for each in result.records),
        "duration": sum(each.duration for each in result.records),
        "hold": hold_text(record.input_hold),
        "groups": [
            (verdict, heading, meaning, [row for row in numbered(modes) if row[1].verdict == verdict])
            for verdict, heading, meaning in VERDICTS
        ],
        "data_sentences": words.data_sentences(result),
        "indicators": INDICATORS,
        "caution": words.caution_sentence(result),
        "assurance": shape_assurance(modes).tolist() if modes.system else [],
        "frequencies": modes.frequencies.tolist(),
        "has_intervals": bool(np.isfinite([mode.frequency_std for mode in modes.system]).any()),
        "folds": [float(fold) for fold in np.atleast_1d(result.fit.folds)],
        "provenance": provenance,
        "version": installed_version(),
        "python_version": platform.python_version(),
        "numpy_version": np.__version__,
        "snippet": _snippet(result, provenance),
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
    chosen = f"observer_order={result.observer.order}, ridge={result.observer.ridge:g}, order={order}"
    return (
        "import modal\nimport okid\n\n"
        f"records = {reading}\n"
        f"result = modal.identify(records)  # it chose {chosen}\n"
        'modal.write_report(result, "report")'
    )


def _literal(text: str) -> object:
    """Lines of an indented code block, in which Markdown takes every letter as it is."""
    from markupsafe import Markup

    return Markup("\n    ").join(Markup(visible(line)) for line in text.split("\n"))  # noqa: S704 - Markdown, not HTML


def _lines(text: str) -> object:
    """Lines of a block that keeps them, each made harmless: a page would run them together otherwise."""
    from markupsafe import Markup, escape

    return Markup("\n").join(escape(visible(line)) for line in text.split("\n"))
