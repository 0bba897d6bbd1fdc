"""Where templates are found, and how text that came from a file is made harmless in HTML or in Markdown."""

import base64
import hashlib
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING

from modal.identification.trust import damping_shown, damping_text, frequency_text
from modal.report.picture import Picture
from modal.sections.columns import shown
from modal.sections.limit_words import limits_class
from modal.wording.names import escape_markdown, visible
from modal.wording.numbers import fit_text, hertz, ratio_text, whole_percent

if TYPE_CHECKING:
    import jinja2

__all__ = ["environment", "inline", "page_script"]

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
    made.filters["damping_shown"] = damping_shown
    made.filters["hertz"] = hertz
    made.filters["percent"] = ratio_text
    made.filters["fit"] = fit_text
    made.filters["share"] = whole_percent
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
