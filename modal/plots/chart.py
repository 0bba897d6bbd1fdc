"""A chart: panels in rows and columns, a key, where each of them lies, and the chart as text to be put into a page.

A chart is made once and read several times: here it is drawn for a page, `modal.recording` draws it for the Rerun
viewer, `modal.plots.results` as a matplotlib figure. On a page it is the same bytes for the same chart, in colours that
the page decides: an SVG that says everything without a script. What a page's script needs to read values off it stands
beside it: for each panel its place in the picture and the limits of its axes, for each line its values to five digits.
"""

import html
import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from modal.plots.panels import COLOURS, STYLE, Area, Curve, Mark, Panel, Role, Scale, Segments, runs, text_width
from okid.arrays import ROUNDED, FloatArray
from okid.errors import visible

INCH: Final = 72.0
"""Take an inch for so many points, as printers do."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Key:
    """A key outside of all panels."""

    panel: Panel
    below: bool = False
    title: str = ""

    @property
    def height(self) -> float:
        """Room that it takes [pt]."""
        return STYLE.line * STYLE.tick * (2.0 if self.title else 1.0) + STYLE.gap


class Chart:
    """Panels in rows and columns."""

    __slots__ = ("across", "down", "height", "key", "rows", "width")

    def __init__(
        self,
        size: tuple[float, float],
        rows: list[list[Panel | None]],
        *,
        across: Sequence[float] = (),
        down: Sequence[float] = (),
    ) -> None:
        self.width, self.height = size
        self.rows = rows
        self.across = across
        self.down = down
        self.key: Key | None = None

    @property
    def panels(self) -> list[Panel]:
        """All panels, row by row."""
        return [panel for row in self.rows for panel in row if panel is not None]

    def arrange(self) -> None:
        """Give every panel its box and its limits; doing it again changes nothing."""
        for panel in self.panels:
            panel.fix_limits()
        columns = list(zip(*self.rows, strict=True))
        top = below = STYLE.gap
        if self.key is not None:
            top, below = top + (not self.key.below) * self.key.height, below + self.key.below * self.key.height
        tops, heights = _spread(
            (top, self.height - below), [(_most(_above, row), _most(_below, row)) for row in self.rows], self.down
        )
        for row, upper, height in zip(self.rows, tops, heights, strict=True):
            for one in row:
                if one is not None:
                    one.box = (0.0, upper, 0.0, height)
        lefts, widths = _spread(
            (0.0, self.width), [(_most(_left, column), _most(_right, column)) for column in columns], self.across
        )
        for column, left, width in zip(columns, lefts, widths, strict=True):
            for one in column:
                if one is not None:
                    one.box = _equal_box(one, (left, one.box[1], width, one.box[3]))


def grid_of(
    n_rows: int, n_columns: int, *, size: tuple[float, float], across: Sequence[float] = (), down: Sequence[float] = ()
) -> Chart:
    """A figure of `size` inches with a panel in each of `n_rows` times `n_columns` places."""
    rows: list[list[Panel | None]] = [[Panel() for _ in range(n_columns)] for _ in range(n_rows)]
    return Chart((INCH * size[0], INCH * size[1]), rows, across=across, down=down)


def one_panel(width: float, height: float) -> tuple[Chart, Panel]:
    """A figure of one panel, sizes in inches, and the panel."""
    figure = grid_of(1, 1, size=(width, height))
    return figure, figure.panels[0]


def row_of(n_panels: int, *, most_columns: int, width: float, height: float) -> Chart:
    """As many panels as are asked for, `most_columns` in a row of `height` inches."""
    n_columns = min(most_columns, max(1, n_panels))
    n_rows = max(1, -(-n_panels // n_columns))
    figure = grid_of(n_rows, n_columns, size=(width, 0.3 + height * n_rows))
    for number in range(max(1, n_panels), n_rows * n_columns):
        figure.rows[number // n_columns][number % n_columns] = None
    return figure


def _spread(
    room: tuple[float, float], margins: Sequence[tuple[float, float]], ratios: Sequence[float]
) -> tuple[list[float], list[float]]:
    """Start and length of each cell between the two ends of the room, when each needs margins before and behind."""
    shares = np.asarray(ratios or [1.0] * len(margins))
    free = room[1] - room[0] - sum(before + behind for before, behind in margins)
    lengths = (max(free, 1.0) * shares / shares.sum()).tolist()
    starts, at = [], room[0]
    for (before, behind), length in zip(margins, lengths, strict=True):
        starts.append(at + before)
        at += before + length + behind
    return starts, lengths


def _most(need: Callable[[Panel], float], panels: Sequence[Panel | None]) -> float:
    return max([need(panel) for panel in panels if panel is not None], default=0.0)


def _above(panel: Panel) -> float:
    head = STYLE.line * STYLE.head * (panel.head.count("\n") + 1) + STYLE.gap if panel.head else STYLE.gap
    return head + STYLE.line * STYLE.tick * panel.rows_above


def _below(panel: Panel) -> float:
    if not panel.frame:
        return STYLE.gap
    deep = STYLE.gap
    if panel.x.labelled:
        texts = [text for _, text in panel.x.ticks or ()]
        lines = 1 + max([text.count("\n") for text in texts], default=0)
        long = max([text_width(text, STYLE.tick) for text in texts], default=0.0)
        deep += STYLE.gap + (long if panel.x.upright else STYLE.line * STYLE.tick * lines)
    return deep + (STYLE.line * STYLE.label if panel.x.label else 0.0)


def _left(panel: Panel) -> float:
    if not panel.frame:
        return STYLE.gap
    texts = [text for _, text in panel.y_ticks()] if panel.y.labelled else []
    wide = max([text_width(text, STYLE.tick) for text in texts], default=0.0)
    return 2.0 * STYLE.gap + wide + (STYLE.line * STYLE.label if panel.y.label else 0.0)


def _right(panel: Panel) -> float:
    return 2.0 * STYLE.gap if panel.frame else STYLE.gap


def _equal_box(panel: Panel, box: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    """The box, made smaller in one direction where one unit is to be as long along as upwards."""
    if not panel.equal:
        return box
    left, top, width, height = box
    (x0, x1), (y0, y1) = panel.x.limits or (0.0, 1.0), panel.y.limits or (0.0, 1.0)
    unit = min(width / abs(x1 - x0), height / abs(y1 - y0))
    wide, high = unit * abs(x1 - x0), unit * abs(y1 - y0)
    return left + 0.5 * (width - wide), top + 0.5 * (height - high), wide, high


_DASHES = {"": "", "dashed": "4 3", "dotted": "1 2.2"}
_ARROW = 7.0
"""Draw the head of an arrow this long [pt]."""


def svg_text(figure: Chart, *, name: str, description: str) -> str:
    """One `<svg>` element; every colour is `var(--role, colour)`.

    Args:
        figure: to draw.
        name: identifies the picture within the page, so that no two pictures share a clip path or a line.
        description: what a screen reader says.
    """
    figure.arrange()
    said, size = html.escape(visible(description)), f"{figure.width:.6g} {figure.height:.6g}"
    parts = [f'<svg role="img" aria-label="{said}" viewBox="0 0 {size}">']
    for number, panel in enumerate(figure.panels):
        parts += _panel(panel, name, number)
    if figure.key is not None:
        title = f' data-title="{html.escape(figure.key.title)}"' if figure.key.title else ""
        parts += [f'<g class="key"{title}>', *_outer_key(figure, figure.key), "</g>"]
    return "\n".join([*parts, "</svg>"])


def page_of(svg: str) -> str:
    """A picture as a file of its own, on paper and in a usual font."""
    opening = '<svg xmlns="http://www.w3.org/2000/svg" style="background: #ffffff; font-family: sans-serif" '
    return svg.replace("<svg ", opening, 1) + "\n"


def line_identity(name: str, panel: int, number: int) -> str:
    """How a line is called in its page: by picture, panel and place among the lines of the panel."""
    return f"{_slug(name)}-p{panel}-s{number}"


def _slug(name: str) -> str:
    return re.sub(r"[^a-z]+", "-", name.lower())


def _panel(panel: Panel, name: str, number: int) -> list[str]:
    left, top, width, height = panel.box
    clip = f"{_slug(name)}-c{number}"
    room = f'x="{left:.2f}" y="{top - 1:.2f}" width="{width:.2f}" height="{height + 2:.2f}"'
    parts = [f'<clipPath id="{clip}"><rect {room}/></clipPath>'] if panel.frame else []
    if panel.frame:
        parts += _axes(panel)
    parts.append(f'<g clip-path="url(#{clip})">' if panel.frame else "<g>")
    areas = [mark for mark in panel.marks if isinstance(mark, Area)]
    parts += [_area(panel, area) for area in areas]
    lines = 0
    for mark in panel.marks:
        if isinstance(mark, Segments):
            parts.append(_segments(panel, mark))
        elif isinstance(mark, Curve):
            shown = _line(panel, mark)
            tagged = mark.label or mark.follows
            parts.append(f'<g id="{line_identity(name, number, lines)}">{shown}</g>' if tagged else shown)
            lines += 1
    parts.append("</g>")
    parts += _said(panel)
    if panel.key is not None and panel.keyed:
        parts += ['<g class="key">', *_inner_key(panel), "</g>"]
    return parts


def _axes(panel: Panel) -> list[str]:
    """Grid, the lines on the left and below, ticks and names."""
    left, top, width, height = panel.box
    bottom, middle = top + height, top + 0.5 * height
    x_ticks, y_ticks = _seen(panel, panel.x_ticks(), 0), _seen(panel, panel.y_ticks(), 1)
    grid = [f"M{x:.2f} {top:.2f}v{height:.2f}" for x, _ in x_ticks if panel.x.grid]
    grid += [f"M{left:.2f} {y:.2f}h{width:.2f}" for y, _ in y_ticks if panel.y.grid]
    edges = {
        "both": f"M{left:.2f} {top:.2f}v{height:.2f}h{width:.2f}",
        "below": f"M{left:.2f} {bottom:.2f}h{width:.2f}",
        "none": "",
    }
    parts = [_path("".join([*grid, edges[panel.edges]]), "grid", STYLE.grid)]
    low = bottom + STYLE.gap
    if panel.x.labelled:
        for x, text in x_ticks:
            if panel.x.upright:
                parts.append(_words(x, low, text, panel.x.role, size=STYLE.tick, anchor="end", turned=True))
                continue
            for line, words in enumerate(text.split("\n")):
                down = low + STYLE.tick * (1.0 + STYLE.line * line)
                parts.append(_words(x, down, words, panel.x.role, size=STYLE.tick, anchor="middle"))
    if panel.y.labelled:
        across = left - STYLE.gap
        parts += [
            _words(across, y + STYLE.tick / 3, text, panel.y.role, size=STYLE.tick, anchor="end") for y, text in y_ticks
        ]
    if panel.x.label:
        texts = [text for _, text in x_ticks] if panel.x.labelled else []
        deep = STYLE.line * STYLE.tick * max([1 + text.count("\n") for text in texts], default=0)
        if panel.x.upright:
            deep = max([text_width(text, STYLE.tick) for text in texts], default=0.0)
        parts.append(
            _words(left + width / 2, low + deep + STYLE.label, panel.x.label, "ink", size=STYLE.label, anchor="middle")
        )
    if panel.y.label:
        wide = max([text_width(text, STYLE.tick) for _, text in y_ticks], default=0.0) if panel.y.labelled else 0.0
        below = (STYLE.line - 1.0) * STYLE.label  # letters and brackets reach below their line, towards the ticks
        across = left - 2.0 * STYLE.gap - wide - below
        parts.append(_words(across, middle, panel.y.label, "ink", size=STYLE.label, anchor="middle", turned=True))
    return parts


def _seen(panel: Panel, ticks: Sequence[tuple[float, str]], side: int) -> list[tuple[float, str]]:
    """(place in the figure, text) of the ticks within the limits."""
    low, high = sorted((panel.x if side == 0 else panel.y).limits or (0.0, 1.0))
    inside = [(value, text) for value, text in ticks if low - ROUNDED * abs(low) <= value <= high + ROUNDED * abs(high)]
    values = np.array([value for value, _ in inside])
    places = panel.place(np.stack([values, values], axis=-1))[:, side]
    return [(float(place), text) for place, (_, text) in zip(places, inside, strict=True)]


def _said(panel: Panel) -> list[str]:
    """The head, and the words at their places."""
    left, top, width, _ = panel.box
    parts = []
    lines = panel.head.split("\n") if panel.head else []
    for number, text in enumerate(reversed(lines)):
        up = top - STYLE.gap - STYLE.line * (STYLE.head * number + STYLE.tick * panel.rows_above)
        at, anchor = (left + width / 2, "middle") if panel.centred else (left, "start")
        parts.append(_words(at, up, text, "ink", size=STYLE.head, anchor=anchor))
    for word in panel.words:
        x, y = panel.place(np.array([word.x, word.y])) + word.shift
        y = top + word.shift[1] if np.isinf(word.y) else y
        parts.append(_words(x, y, word.text, word.role, size=word.size, anchor=word.anchor))
    return parts


def _line(panel: Panel, line: Curve) -> str:
    places = panel.place(line.corners)
    parts = []
    if line.width:
        strips = "".join(_strip(places[first:behind]) for first, behind in runs(places))
        parts.append(_path(strips, line.role, line.width, opacity=line.opacity, dash=_DASHES[line.dash]))
    if line.dot:
        seen = places[np.isfinite(places).all(axis=1)]
        parts.append(_dots(seen, line.role, line.dot, square=line.square, opacity=line.opacity))
    return "".join(parts)


def _dots(places: FloatArray, role: Role, size: float, *, square: bool, opacity: float = 1.0) -> str:
    """Dots as pieces of no length with round or square ends: all of them are one short path."""
    dots = "".join([f"M{x:.2f} {y:.2f}h0" for x, y in places.tolist()])
    return _path(dots, role, size, opacity=opacity, cap="square" if square else "round")


def _strip(places: FloatArray) -> str:
    return "M" + "L".join([f"{x:.2f} {y:.2f}" for x, y in places.tolist()])


def _area(panel: Panel, area: Area) -> str:
    places = [panel.place(polygon) for polygon in area.polygons]
    one = len(places) > 1 and area.opacity < 1  # pale faces that lie over each other are darker there
    paths = [_strip(corners) + "z" for corners in places]
    return "\n".join(_filled(path, area.role, area.opacity) for path in (paths if one else ["".join(paths)]))


def _segments(panel: Panel, segments: Segments) -> str:
    places = panel.place(segments.ends)
    text = "".join([f"M{a:.2f} {b:.2f}L{c:.2f} {d:.2f}" for (a, b), (c, d) in places.tolist()])
    drawn = _path(text, segments.role, segments.width, opacity=segments.opacity)
    if not segments.arrows:
        return drawn
    heads = []
    for start, end in places:
        along = (end - start) / max(float(np.linalg.norm(end - start)), ROUNDED)
        side = 0.4 * _ARROW * np.array([-along[1], along[0]])
        heads.append(_strip(np.array([end, end - _ARROW * along + side, end - _ARROW * along - side])) + "z")
    return drawn + _filled("".join(heads), segments.role, segments.opacity)


def _inner_key(panel: Panel) -> list[str]:
    """What each line is, on a ground that keeps it readable where lines pass behind."""
    left, top, width, height = panel.box
    marks = panel.keyed
    row = STYLE.line * STYLE.tick
    wide = STYLE.sample + 3 * STYLE.gap + max(text_width(mark.label, STYLE.tick) for mark in marks)
    high = row * len(marks) + STYLE.gap
    corners = {
        f"{down} {side}": (x, y)
        for down, y in (("upper", top + STYLE.gap), ("lower", top + height - high - STYLE.gap))
        for side, x in (("right", left + width - wide - STYLE.gap), ("left", left + STYLE.gap))
    }
    x, y = corners[_emptiest(panel, corners, (wide, high)) if panel.key == "best" else str(panel.key)]
    ground = f"M{x:.2f} {y:.2f}h{wide:.2f}v{high:.2f}h{-wide:.2f}z"
    parts = [_filled(ground, "paper", STYLE.ground)]
    for number, mark in enumerate(marks):
        parts += _entry(mark, x + STYLE.gap, y + STYLE.gap / 2 + row * (number + 0.5))
    return parts


def _emptiest(panel: Panel, corners: dict[str, tuple[float, float]], size: tuple[float, float]) -> str:
    """The corner in which the fewest points lie."""
    points = panel.place(np.concatenate([mark.corners for mark in panel.marks]))
    inside = {
        where: int((((points >= corner) & (points <= np.add(corner, size))).all(axis=1)).sum())
        for where, corner in corners.items()
    }
    return min(inside, key=lambda where: inside[where])


def _outer_key(figure: Chart, key: Key) -> list[str]:
    marks = key.panel.keyed
    widths = [STYLE.sample + 5 * STYLE.gap + text_width(mark.label, STYLE.tick) for mark in marks]
    free = figure.width - sum(widths)
    x = free / 2 if key.below else free - STYLE.gap
    y = figure.height - STYLE.tick if key.below else STYLE.tick
    parts = []
    if key.title:
        title = y - STYLE.line * STYLE.tick
        parts.append(_words(figure.width / 2, title, key.title, "muted", size=STYLE.tick, anchor="middle"))
    for mark, width in zip(marks, widths, strict=True):
        parts += _entry(mark, x, y)
        x += width
    return parts


def _entry(mark: Mark, x: float, y: float) -> list[str]:
    """A sample of the line, dot or area, and its name; centred on the height `y`."""
    end, middle = x + STYLE.sample, x + STYLE.sample / 2
    parts = []
    if isinstance(mark, Area):
        high = 0.7 * STYLE.tick
        parts.append(_filled(f"M{x:.2f} {y - high / 2:.2f}H{end:.2f}v{high:.2f}H{x:.2f}z", mark.role, mark.opacity))
    elif mark.width:
        dash = _DASHES[mark.dash] if isinstance(mark, Curve) else ""
        parts.append(_path(f"M{x:.2f} {y:.2f}H{end:.2f}", mark.role, mark.width, opacity=mark.opacity, dash=dash))
    if isinstance(mark, Curve) and mark.dot:
        parts.append(_dots(np.array([[middle, y]]), mark.role, mark.dot, square=mark.square))
    return [*parts, _words(end + STYLE.gap, y + STYLE.tick / 3, mark.label, "muted", size=STYLE.tick, anchor="start")]


def _colour(role: Role) -> str:
    return f"var(--{role}, {COLOURS[role]})"


def _path(path: str, role: Role, width: float, *, opacity: float = 1.0, dash: str = "", cap: str = "") -> str:
    style = f"fill: none; stroke: {_colour(role)}; stroke-width: {width:g}; stroke-linejoin: round"
    style += (f"; stroke-opacity: {opacity:g}" if opacity < 1 else "") + (f"; stroke-dasharray: {dash}" if dash else "")
    return f'<path d="{path}" style="{style}{f"; stroke-linecap: {cap}" if cap else ""}"/>'


def _filled(path: str, role: Role, opacity: float) -> str:
    return f'<path d="{path}" style="fill: {_colour(role)}; fill-opacity: {opacity:g}"/>'


def _words(
    x: float, y: float, text: str, role: Role, *, size: float, anchor: str = "start", turned: bool = False
) -> str:
    turn = f' transform="rotate(-90 {x:.2f} {y:.2f})"' if turned else ""
    where = f"; text-anchor: {anchor}" if anchor != "start" else ""
    style = f"font-size: {size:g}px; fill: {_colour(role)}{where}"
    return f'<text x="{x:.2f}" y="{y:.2f}"{turn} style="{style}">{html.escape(visible(text))}</text>'


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
        >>> from modal.plots.chart import grid_of
        >>> figure = grid_of(1, 1, size=(4, 3))
        >>> figure.panels[0].line([0, 1, 2], [3, 4, 5], "measured", label="measured")
        >>> json.loads(chart_text(figure, "x"))["panels"][0]["series"][0]["y"]
        [3, 4, 5]
    """
    figure.arrange()
    panels = [
        _panel_numbers(panel, name, number, notes or {})
        for number, panel in enumerate(figure.panels)
        if any(line.label or line.follows for line in panel.lines)
    ]
    text = json.dumps({"panels": panels}, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _panel_numbers(panel: Panel, name: str, number: int, notes: Mapping[str, Notes]) -> dict[str, object]:
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
    if x.size > 2 and np.isfinite(x).all() and np.ptp(np.diff(x)) <= ROUNDED * abs(float(x[-1] - x[0])):
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
