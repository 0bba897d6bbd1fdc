"""What a page's script needs to read values off a figure: where its panels lie, and the numbers behind its lines.

The picture itself stays an SVG that says everything without a script. This is the data beside it: for each panel its
place in the picture and the limits of its axes, for each line its values to five digits. Nothing here is drawn.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from modal.plots.layout import Chart
from modal.plots.marks import Curve, Scale
from modal.plots.panels import Panel
from modal.plots.vector import line_identity
from okid.arrays import FloatArray

__all__ = ["MOST_VALUES", "Notes", "chart_text"]

MOST_VALUES = 4000
"""Keep so many values of one line; of a longer line, every second, third, ... of them."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Notes:
    """What is known of each point of a line besides its place.

    Attributes:
        columns: what the numbers are, e.g. "damping [%]".
        rows: one tuple a point, in the order in which the points are drawn; nan is not shown.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[float, ...], ...]


def chart_text(figure: Chart, name: str, *, notes: Mapping[str, Notes] | None = None) -> str:
    """The numbers of a figure as JSON for a `<script type="application/json">`: no letter of it can end the tag.

    Args:
        figure: of `modal.plots`.
        name: as given to `svg_text`.
        notes: more on the points of the lines with these labels.

    Returns:
        One line of ASCII without "<", ">" and "&".

    Example:
        >>> from modal.plots.panels import grid_of
        >>> figure = grid_of(1, 1, size=(4, 3))
        >>> figure.panels[0].line([0, 1, 2], [3, 4, 5], "measured", label="measured")
        >>> json.loads(chart_text(figure, "x"))["panels"][0]["series"][0]["y"]
        [3, 4, 5]
    """
    figure.arrange()
    panels = [
        _panel(panel, name, number, notes or {})
        for number, panel in enumerate(figure.panels)
        if any(line.label or line.follows for line in panel.lines)
    ]
    text = json.dumps({"panels": panels}, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _panel(panel: Panel, name: str, number: int, notes: Mapping[str, Notes]) -> dict[str, object]:
    return {
        "box": [round(float(edge), 2) for edge in panel.box],
        "x": _axis(panel.x),
        "y": _axis(panel.y),
        "head": panel.head,
        "series": [
            _series(line, line_identity(name, number, place), notes.get(line.label))
            for place, line in enumerate(panel.lines)
            if line.label or line.follows
        ],
    }


def _axis(axis: Scale) -> dict[str, object]:
    what, _, unit = axis.label.partition(" [")
    return {
        "what": what,
        "unit": unit.partition("]")[0],
        "limits": [float(f"{limit:.8g}") for limit in axis.limits or ()],
        "log": axis.log,
    }


def _series(line: Curve, identity: str, notes: Notes | None) -> dict[str, object]:
    made: dict[str, object] = {"name": line.label or line.follows, "id": identity}
    if line.follows or np.isinf(line.corners).any():
        return made  # a follower, or a line across the panel: it is hidden and shown, and has no values to tell
    step = max(1, -(-line.x.size // MOST_VALUES))
    made["points"] = not line.width
    made["x"], made["y"] = _places(line.x[::step]), _numbers(line.y[::step])
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
