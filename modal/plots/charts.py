"""What a page's script needs to read values off a figure: where its panels lie, and the numbers behind its lines.

The picture itself stays an SVG that says everything without a script. This is the data beside it: for each panel its
place in the picture and the limits of its axes, for each line its values to five digits. Nothing here is drawn.
"""

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from okid.arrays import FloatArray

__all__ = ["MOST_VALUES", "Notes", "chart_text", "tag_lines"]

MOST_VALUES = 4000
"""Values of one line that are kept; a longer line keeps every second, third, ... of them."""

_FOLLOWER = "_with "
_AUTOMATIC = re.compile(r"_child\d+")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Notes:
    """What is known of each point of a line besides its place.

    Attributes:
        columns: what the numbers are, e.g. "damping [%]".
        rows: one tuple a point, in the order in which the points are drawn; nan is not shown.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[float, ...], ...]


def tag_lines(figure: Figure, name: str) -> None:
    """Give every line that has a label an identity in the SVG, so that a script can find it.

    A line labelled "_with measured" has no entry in the legend and follows the line "measured".

    Args:
        figure: of `modal.plots`.
        name: of the picture within its page, e.g. "responses".
    """
    for panel, axis in enumerate(figure.axes):
        for number, line in enumerate(axis.lines):
            if _series_name(line):
                line.set_gid(_identity(name, panel, number))


def chart_text(figure: Figure, name: str, *, notes: Mapping[str, Notes] | None = None) -> str:
    """The numbers of a drawn figure as JSON for a `<script type="application/json">`: no letter of it can end the tag.

    Args:
        figure: tagged by `tag_lines` and drawn by `svg_text`, which fixes where its panels lie.
        name: as given to `tag_lines`.
        notes: more on the points of the lines with these labels.

    Returns:
        One line of ASCII without "<", ">" and "&".

    Example:
        >>> from modal.plots.style import LIGHT, new_figure
        >>> figure, axes = new_figure(1, 1, size=(4, 3), theme=LIGHT)
        >>> _ = axes[0][0].plot([0, 1, 2], [3, 4, 5], label="measured")
        >>> tag_lines(figure, "x")
        >>> json.loads(chart_text(figure, "x"))["panels"][0]["series"][0]["y"]
        [3, 4, 5]
    """
    width, height = 72.0 * figure.get_size_inches()
    panels = [
        _panel(axis, name, panel, (float(width), float(height)), notes or {})
        for panel, axis in enumerate(figure.axes)
        if axis.get_visible() and any(_series_name(line) for line in axis.lines)
    ]
    text = json.dumps({"panels": panels}, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _panel(
    axis: Axes, name: str, panel: int, size: tuple[float, float], notes: Mapping[str, Notes]
) -> dict[str, object]:
    place = axis.get_position()
    box = (place.x0 * size[0], (1.0 - place.y1) * size[1], place.width * size[0], place.height * size[1])
    return {
        "box": [round(float(edge), 2) for edge in box],
        "x": _axis(axis.get_xlabel(), axis.get_xlim(), axis.get_xscale()),
        "y": _axis(axis.get_ylabel(), axis.get_ylim(), axis.get_yscale()),
        "head": (axis.get_title(loc="left") or axis.get_title()).replace(r"\$", "$"),
        "series": [
            _series(axis, line, _identity(name, panel, number), notes.get(str(line.get_label())))
            for number, line in enumerate(axis.lines)
            if _series_name(line)
        ],
    }


def _axis(label: str, limits: tuple[float, float], scale: str) -> dict[str, object]:
    what, _, unit = label.replace(r"\$", "$").partition(" [")
    return {
        "what": what,
        "unit": unit.partition("]")[0],
        "limits": [float(f"{limit:.8g}") for limit in limits],
        "log": scale == "log",
    }


def _series(axis: Axes, line: Line2D, identity: str, notes: Notes | None) -> dict[str, object]:
    made: dict[str, object] = {"name": _series_name(line), "id": identity}
    if str(line.get_label()).startswith("_") or line.get_transform() != axis.transData:
        return made  # a follower, or a line across the panel: it is hidden and shown, and has no values to tell
    x, y = (np.asarray(values, dtype=np.float64) for values in line.get_data())
    step = max(1, -(-x.size // MOST_VALUES))
    made["points"] = str(line.get_linestyle()) in ("None", "none", "", " ")
    made["x"], made["y"] = _places(x[::step]), _numbers(y[::step])
    if notes:
        made["columns"] = list(notes.columns)
        made["rows"] = [_numbers(row) for row in notes.rows[::step]]
    return made


def _places(x: FloatArray) -> object:
    """An even grid as its first value, step and length; any other places one by one."""
    if x.size > 2 and np.isfinite(x).all() and np.ptp(np.diff(x)) <= 1e-9 * abs(float(x[-1] - x[0])):
        return {"from": float(f"{x[0]:.9g}"), "step": float(f"{(x[-1] - x[0]) / (x.size - 1):.9g}"), "n": x.size}
    return _numbers(x)


def _numbers(values: Sequence[float] | FloatArray) -> list[float | int | None]:
    """To five digits, whole numbers without a point, nan and infinity as null."""
    return [_number(float(value)) for value in values]


def _number(value: float) -> float | int | None:
    if not math.isfinite(value):
        return None
    rounded = float(f"{value:.5g}")
    return int(rounded) if rounded.is_integer() and abs(rounded) < 1e9 else rounded


def _series_name(line: Line2D) -> str:
    """The label without the mark of a follower; "" for a line that belongs to no series."""
    label = str(line.get_label())
    if _AUTOMATIC.fullmatch(label):
        return ""
    return label.removeprefix(_FOLLOWER) if label.startswith(_FOLLOWER) else "" if label.startswith("_") else label


def _identity(name: str, panel: int, number: int) -> str:
    return f"{re.sub(r'[^a-z]+', '-', name.lower())}-p{panel}-s{number}"
