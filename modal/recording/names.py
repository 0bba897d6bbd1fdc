"""Names from files are not to be trusted: as parts of entity paths, as titles of views, as cells of a table.

A channel may be called `<script>`, nothing at all, a thousand letters, or text that runs from right to left and
carries what follows along. What is shown goes through `modal.names`; here are the paths, and the short forms.
"""

from collections.abc import Sequence
from typing import Final

from modal.names import escape_markdown, shorten, visible

__all__ = ["cell", "label", "path_parts", "with_unit"]

LONGEST_PART: Final = 64
"""Letters of a channel name that are kept in an entity path."""


def label(text: str, longest: int = 28) -> str:
    r"""One line of visible text, at most `longest` characters; "unnamed" where nothing would be seen.

    Example:
        >>> label("tip\nmass"), label("  ")
        ('tip mass', 'unnamed')
    """
    return shorten(" ".join(visible(text).split()), longest) or "unnamed"


def with_unit(name: str, unit: str, longest: int = 28) -> str:
    """A name and its unit in brackets, where there is one.

    Example:
        >>> with_unit("tip", "m/s^2")
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
    import rerun

    parts: list[str] = []
    for index, name in enumerate(names):
        part = label(name, longest=len(name) + len("unnamed"))[:LONGEST_PART]
        if part.startswith("__"):  # reserved by Rerun for its own entities
            part = "name" + part
        escaped = rerun.escape_entity_path_part(part)
        while escaped in parts:
            escaped = f"{escaped}_{index}"
        parts.append(escaped)
    return tuple(parts)
