"""Text that came from a file, made harmless for where it is shown.

Channel names, units and file names are written by others. In a terminal a control character moves the cursor, in a
spreadsheet a leading "=" is a formula, in Markdown a bracket is a link, and a right-to-left override turns the words
around it. HTML is escaped by the template engine; the rest is done here.
"""

import re

from okid.errors import visible

__all__ = ["csv_cell", "escape_markdown", "plot_label", "shorten", "visible"]

_FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")
_MARKDOWN_ALWAYS = re.compile(r"([\\`*\[\]|~$#!@])")
_MARKDOWN_UNDERSCORE = re.compile(r"(?<![^\W_])_|_(?![^\W_])")


def shorten(text: str, limit: int = 40) -> str:
    """At most `limit` characters, for a name in a sentence unless given; the middle goes: its end may carry a number.

    Example:
        >>> shorten("acceleration of the third floor", 15)
        'acceler…d floor'
    """
    if len(text) <= limit:
        return text
    tail = (limit - 1) // 2
    return text[: limit - 1 - tail] + "…" + text[len(text) - tail :]


def plot_label(text: str, *, limit: int = 28) -> str:
    """A name for a picture: visible and short."""
    return shorten(visible(text), limit)


def escape_markdown(text: str) -> str:
    r"""The text as Markdown that renders as itself: no link, no emphasis, no HTML, no table cell.

    Example:
        >>> print(escape_markdown("floor_1 <b> [x](y) |"))
        floor_1 &lt;b&gt; \[x\](y) \|
    """
    escaped = _MARKDOWN_ALWAYS.sub(r"\\\1", visible(text))
    escaped = _MARKDOWN_UNDERSCORE.sub(r"\\_", escaped)
    escaped = re.sub(r"&", "&amp;", escaped).replace("<", "&lt;").replace(">", "&gt;")
    return escaped.replace("://", r"\://").replace("www.", r"www\.")


def csv_cell(text: str) -> str:
    """The text as a spreadsheet cell that is never run as a formula (OWASP: a quote before = + - @).

    Example:
        >>> csv_cell("=1+1")
        "'=1+1"
    """
    if text.startswith(_FORMULA_STARTS) or visible(text).lstrip(" ").startswith(_FORMULA_STARTS):
        return "'" + visible(text)
    return visible(text)
