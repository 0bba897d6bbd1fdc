"""A figure as text to be put into a page: the same bytes for the same figure, and colours that the page decides."""

import io
import re
import warnings
from dataclasses import asdict

import matplotlib as mpl
from matplotlib.figure import Figure

from modal.names import visible
from modal.plots.style import LIGHT

__all__ = ["svg_text"]

_ROLES = {colour: role for role, colour in asdict(LIGHT).items()}
_COLOUR = re.compile(r"\b(fill|stroke): (#[0-9a-f]{6})\b")
_IDLE_ID = re.compile(r' id="[a-zA-Z0-9.]+_[0-9]+"')
_FONT = re.compile(r"font: (?:(?:normal|oblique|italic) )?(?:(\d+|bold) )?(\d+(?:\.\d+)?)px [^;\"]*")
_BARE_LINE = re.compile(r'<path d="([^"]*)" ((?:clip-path="[^"]*" )?style="fill: none;[^"]*")/>\s*')
_LONG_NUMBER = re.compile(r"(?<=[ \d-])(\d+\.\d{2})\d+")


def svg_text(figure: Figure, *, name: str, description: str) -> str:
    """One `<svg>` element; every colour of the light theme becomes `var(--role, colour)`.

    Args:
        figure: drawn in the light theme.
        name: identifies the picture within the page, so that no two pictures share a clip path.
        description: what a screen reader says.
    """
    file = io.StringIO()
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": f"modal-report {name}"}), warnings.catch_warnings():
        # The reader's browser has fonts that this machine lacks; text stays text.
        warnings.filterwarnings("ignore", message=r"Glyph \d+ .* missing from", category=UserWarning)
        warnings.filterwarnings("ignore", message=r"Matplotlib currently does not support", category=UserWarning)
        figure.savefig(file, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    text = file.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r' xmlns:xlink="[^"]*"| xmlns="[^"]*"', "", text).replace("xlink:href", "href")
    text = _IDLE_ID.sub("", text)
    text = re.sub(r'(<svg [^>]*?)width="[^"]*" height="[^"]*"', r"\1", text, count=1)
    text = re.sub(r"(?<= d=\")[^\"]*", lambda path: _short_path(path.group()), text)
    text = _joined(text)
    text = _FONT.sub(_size_only, text)
    text = _COLOUR.sub(_variable, text)
    return text.replace("<svg ", f'<svg role="img" aria-label="{_attribute(visible(description))}" ', 1)


def _short_path(path: str) -> str:
    """Two decimals, and no line end between the steps."""
    return re.sub(r"\s*\n\s*", "", _LONG_NUMBER.sub(r"\1", path)).strip()


def _joined(text: str) -> str:
    """Unfilled lines of one style that follow one another as one path: a mesh of 3000 of them is a tenth as long."""
    parts: list[str] = []
    end, style = 0, ""
    for line in _BARE_LINE.finditer(text):
        if parts and line.start() == end and line.group(2) == style:
            parts[-1] += line.group(1)
        else:
            parts += [*([f'" {style}/>\n'] if style else []), text[end : line.start()], f'<path d="{line.group(1)}']
        end, style = line.end(), line.group(2)
    return "".join([*parts, f'" {style}/>\n' if style else "", text[end:]])


def _variable(match: re.Match[str]) -> str:
    kind, colour = match.groups()
    role = _ROLES.get(colour)
    return f"{kind}: var(--{role}, {colour})" if role else match.group()


def _size_only(match: re.Match[str]) -> str:
    weight, size = match.groups()
    return (f"font-weight: {weight}; " if weight else "") + f"font-size: {size}px"


def _attribute(text: str) -> str:
    return text.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;").replace(">", "&gt;")
