"""A chart of `modal.plots` in a 2-D view of Rerun, and the views that several pages are made of.

Rerun's own plots run over a timeline and have no logarithmic axis, so all that is not a function of time is a `Chart`,
the same that a report draws, as strips, points and labels. One unit of the view is about one point of the screen.
Labels are as large as the viewer makes them and never stand on end: what an axis upwards shows stands above it, beside
the key, whose words have the colours of what they name.
"""

import importlib
import math
import re
import unicodedata
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from modal.plots.chart import Chart
from modal.plots.panels import STYLE, Area, Curve, Mark, Panel, Role, Scale, Segments, Tick, runs
from okid.arrays import ROUNDED, FloatArray


class _Later:
    """A library that is imported when something of it is first used: whoever only checks data never pays for rerun."""

    def __init__(self, library: str) -> None:
        self._library = library

    def __getattr__(self, name: str) -> Any:
        return getattr(importlib.import_module(self._library), name)


rr: Any = _Later("rerun")
rrb: Any = _Later("rerun.blueprint")

RecordingStream = Any
"""A stream of Rerun, `rerun.RecordingStream`."""

Blueprint = Any
"""A layout of Rerun, `rerun.blueprint.Blueprint`."""

DRAWN: Final = (
    *((0x20, 0x7E), (0xA0, 0xAC), (0xAE, 0x148), (0x14A, 0x17F), (0x218, 0x21B)),  # Latin
    *((0x384, 0x38A), (0x38E, 0x3A1), (0x3A3, 0x3CF)),  # Greek
    *((0x401, 0x40C), (0x40E, 0x44F), (0x451, 0x45C), (0x490, 0x493)),  # Cyrillic
    *((0x1E80, 0x1E85), (0x1EA0, 0x1EF9)),  # more Latin
    *((0x2010, 0x2011), (0x2013, 0x2014), (0x2018, 0x2022), (0x2026, 0x2026), (0x2074, 0x207A), (0x2080, 0x2089)),
    *((0x2190, 0x2199), (0x2212, 0x2212), (0x221E, 0x221E), (0x2248, 0x2248), (0x2260, 0x2260), (0x2264, 0x2265)),
    (0x25A0, 0x25A1),
)
"""Code points that both fonts inside Rerun 0.41 (Inter, JetBrains Mono) can draw. The viewer looks for others among the
fonts of the machine, and where there are none it does not draw a box but stops: seen with Arabic, Han, U+FFFD."""

BOX: Final = "\N{WHITE SQUARE}"


def drawable(text: str) -> str:
    """The text with a box for each character that not every Rerun viewer can draw, or its plain form where it has one.

    Example:
        >>> drawable("h\N{LATIN SMALL LETTER E WITH ACUTE}t\N{DOUBLE-STRUCK CAPITAL R}")
        'hétR'
    """
    return "".join(letter if _is_drawn(letter) else _plain(letter) for letter in text)


def _is_drawn(letter: str) -> bool:
    return any(first <= ord(letter) <= last for first, last in DRAWN)


def _plain(letter: str) -> str:
    plain = unicodedata.normalize("NFKC", letter)
    return plain if all(map(_is_drawn, plain)) else BOX


Colour = tuple[int, int, int]


class Palette:
    """Colours on the dark ground of the viewer, by what they stand for."""

    BACKGROUND: Final[Colour] = (13, 14, 17)
    FRAME: Final[Colour] = (120, 124, 134)
    GRID: Final[Colour] = (38, 41, 48)
    GREY: Final[Colour] = (112, 116, 126)
    PALE: Final[Colour] = (196, 200, 210)
    WHITE: Final[Colour] = (240, 242, 248)
    BLUE: Final[Colour] = (86, 156, 255)  # measured
    DIM_BLUE: Final[Colour] = (58, 88, 140)
    ORANGE: Final[Colour] = (255, 160, 77)  # simulated from the inputs alone
    GREEN: Final[Colour] = (72, 207, 140)  # kept, stable, system
    GOLD: Final[Colour] = (245, 196, 84)  # inputs, choices
    RED: Final[Colour] = (240, 96, 96)  # what is left over


@dataclass(frozen=True, slots=True)
class Pane:
    """Where a plot is stored and how large it is; the blueprint makes a view of the same shape.

    Attributes:
        path: the entity above all parts of the plot, which is the view's origin.
        width: of the whole plot, margins included, in view units.
        height: likewise.
    """

    path: str
    width: float
    height: float


class Drawing:
    """Sizes of what a chart is made of in the viewer."""

    ENLARGED: Final = 2.0
    """Enlarge a chart so much: a row of words, 10.6 points, is as high as a label of the viewer with its ground."""
    PADDING: Final = 12.0
    """Leave so much between the words of a label and its ends, in view units."""
    KEY_ROWS: Final = 2
    """Give a key so many rows, the first of them beside the head; say how many more there are."""


COLOURS: Final[dict[Role, Colour]] = {
    "paper": Palette.BACKGROUND,
    "ink": Palette.PALE,
    "muted": Palette.GREY,
    "grid": Palette.GRID,
    "measured": Palette.BLUE,
    "model": Palette.ORANGE,
    "residual": Palette.RED,
    "system": Palette.GREEN,
    "doubtful": Palette.GOLD,
    "noise": Palette.GREY,
}
"""Draw what a role means in the colour that it has on every page."""

Said = tuple[float, float, str, Colour]
"""A label: the place of its middle in the view, its words and their colour."""


def log_chart(recording: RecordingStream, pane: Pane, chart: Chart, *, behind: float = 2.0) -> None:
    """Draw a chart below the path of its pane, everything static; it is laid out anew, in the shape of the pane.

    Each line, area and set of pieces is an entity, named by its label; those of several panels stand below the
    number of their panel.

    Args:
        recording: the stream.
        pane: where and how large.
        chart: of `modal.plots`, which nobody else will draw.
        behind: what the first line is drawn over; grid and frame lie below.
    """
    chart.width, chart.height = pane.width / Drawing.ENLARGED, pane.height / Drawing.ENLARGED
    keys = [_entries(chart, panel) for panel in chart.panels]
    chart.key = None
    for panel in chart.panels:
        panel.head = (panel.y.label or panel.head).replace("\n", ": ")
        panel.y.label, panel.centred = "", False
        _words_inside(chart, panel)
    chart.arrange()
    rows = [_wrapped(panel, entries) for panel, entries in zip(chart.panels, keys, strict=True)]
    for panel, lines in zip(chart.panels, rows, strict=True):
        panel.rows_above += len(lines) - 1
    chart.arrange()
    for number, (panel, lines) in enumerate(zip(chart.panels, rows, strict=True)):
        path = pane.path if len(chart.panels) == 1 else f"{pane.path}/{number}"
        if panel.frame:
            _log_frame(recording, path, panel)
        for place, (name, mark) in enumerate(zip(_names(panel.marks), panel.marks, strict=True)):
            _log_mark(recording, f"{path}/{name}", panel, mark, behind + place)
        _log_words(recording, path, [*_ticks(panel), *_head(panel, lines), *_words(panel)])


def seen_at(panel: Panel, x: npt.ArrayLike, y: npt.ArrayLike) -> FloatArray:
    """(n, 2) places in the view of values, once the chart is drawn; beyond an axis they lie on its edge."""
    points = np.stack(np.broadcast_arrays(*(np.asarray(part, dtype=np.float64) for part in (x, y))), axis=-1)
    left, top, width, height = panel.box
    return Drawing.ENLARGED * np.clip(panel.place(panel.within(points)), (left, top), (left + width, top + height))


def role_colour(role: Role, opacity: float = 1.0) -> Colour:
    """The colour of a role as it shines through to the background: lines in the viewer hide what is behind them.

    Example:
        >>> role_colour("measured"), role_colour("measured", 0.5)
        ((86, 156, 255), (50, 85, 136))
    """
    red, green, blue = (
        round(ground + opacity * (full - ground))
        for full, ground in zip(COLOURS[role], Palette.BACKGROUND, strict=True)
    )
    return red, green, blue


def _entries(chart: Chart, panel: Panel) -> list[tuple[str, Colour]]:
    """The words of the key of a panel, and their colours."""
    outer = chart.key if chart.key is not None and chart.key.panel is panel else None
    if outer is None and panel.key is None:
        return []
    title = [(outer.title, COLOURS["muted"])] if outer is not None and outer.title else []
    return [*title, *((mark.label, role_colour(mark.role, max(mark.opacity, STYLE.half))) for mark in panel.keyed)]


def _wrapped(panel: Panel, entries: Sequence[tuple[str, Colour]]) -> list[list[tuple[str, Colour]]]:
    """The entries in rows, the first of which begins behind the head."""
    room = Drawing.ENLARGED * panel.box[2]
    lines: list[list[tuple[str, Colour]]] = [[]]
    used = _wide(panel.head) if panel.head else 0.0
    for text, colour in entries:
        if used + _wide(text) > room and (lines[-1] or used):
            lines.append([])
            used = 0.0
        lines[-1].append((text, colour))
        used += _wide(text)
    left = sum(map(len, lines[Drawing.KEY_ROWS :]))
    if left:
        lines[Drawing.KEY_ROWS - 1][-1:] = [(f"{left + 1} more", Palette.GREY)]
    return lines[: Drawing.KEY_ROWS]


def _wide(text: str) -> float:
    # about the width of a letter
    return 7.0 * len(text) + 2.0 * Drawing.PADDING


def _words_inside(chart: Chart, panel: Panel) -> None:
    """Take long words from beside their rows to above their bars; one row lies 1 below the other."""
    ticks = panel.y.ticks or ()
    if max([_wide(text) for _, text in ticks], default=0.0) > 0.3 * Drawing.ENLARGED * chart.width:
        panel.y.labelled = False
        for place, text in ticks:
            panel.word(-math.inf, place - 0.5, text, "ink", shift=(0.0, STYLE.tick / 3))
        first, last = panel.y.limits or (0.0, 1.0)
        panel.y.limits = (first, min(last, -0.9)) if first > last else (first, last)


def _log_frame(recording: RecordingStream, path: str, panel: Panel) -> None:
    left, top, width, height = (Drawing.ENLARGED * edge for edge in panel.box)
    right, bottom = left + width, top + height
    across = [[(x, top), (x, bottom)] for x, _ in _seen(panel, panel.x, panel.x_ticks()) if panel.x.grid]
    along = [[(left, y), (right, y)] for y, _ in _seen(panel, panel.y, panel.y_ticks()) if panel.y.grid]
    _strips(recording, f"{path}/grid", [*across, *along], Palette.GRID, width=STYLE.grid, order=0.0)
    _strips(recording, f"{path}/frame", [[(left, top), (left, bottom), (right, bottom)]], Palette.FRAME, order=1.0)


def _seen(panel: Panel, axis: Scale, ticks: Sequence[Tick]) -> list[Tick]:
    """(place in the view, words) of the ticks within the limits, of plain numbers as the viewer's fonts have them."""
    low, high = sorted(axis.limits or (0.0, 1.0))
    slack = ROUNDED * (high - low)
    inside = [(value, text) for value, text in ticks if low - slack <= value <= high + slack]
    side = 0 if axis is panel.x else 1
    plain = axis.ticks is None
    return [(float(seen_at(panel, value, value)[side]), f"{value:.6g}" if plain else text) for value, text in inside]


def _ticks(panel: Panel) -> Iterator[Said]:
    left, top, width, height = (Drawing.ENLARGED * edge for edge in panel.box)
    low = top + height + Drawing.ENLARGED * (STYLE.gap + STYLE.tick / 2)
    if not panel.frame:
        return
    if panel.x.labelled:
        for x, text in _seen(panel, panel.x, panel.x_ticks()):
            yield x, low, text.replace("\n", " "), COLOURS["ink"]
    if panel.y.labelled:
        for y, text in _seen(panel, panel.y, panel.y_ticks()):
            yield left - (_wide(text) - Drawing.PADDING) / 2, y, text, COLOURS["ink"]
    if panel.x.label:
        down = Drawing.ENLARGED * STYLE.line * STYLE.tick if panel.x.labelled else 0.0
        yield left + width / 2, low + down, panel.x.label, COLOURS["ink"]


def _head(panel: Panel, lines: Sequence[Sequence[tuple[str, Colour]]]) -> Iterator[Said]:
    """What the panel shows on the left, the key beside and below it from the right."""
    left, top, width, _ = (Drawing.ENLARGED * edge for edge in panel.box)
    row = Drawing.ENLARGED * STYLE.line * STYLE.tick
    upper = top - Drawing.ENLARGED * (STYLE.gap + STYLE.tick / 2) - row * panel.rows_above
    if panel.head:
        yield (
            left + (_wide(panel.head) - Drawing.PADDING) / 2 - Drawing.ENLARGED * STYLE.gap,
            upper,
            panel.head,
            COLOURS["ink"],
        )
    for number, entries in enumerate(lines):
        right = left + width
        for text, colour in reversed(entries):
            yield right - _wide(text) / 2, upper + row * number, text, colour
            right -= _wide(text)


def _words(panel: Panel) -> Iterator[Said]:
    for word in panel.words:
        x, y = seen_at(panel, word.x, word.y) + Drawing.ENLARGED * np.array(word.shift)
        aside = {"start": 0.5, "middle": 0.0, "end": -0.5}[word.anchor] * _wide(word.text)
        yield x + aside, y - Drawing.ENLARGED * word.size / 3, word.text, COLOURS[word.role]


def _log_words(recording: RecordingStream, path: str, said: Sequence[Said]) -> None:
    if not said:
        return
    labels = rr.Points2D(
        [(x, y - 19.0) for x, y, _, _ in said],  # a label hangs below its point
        radii=rr.Radius.ui_points(0.0),
        colors=[colour for *_, colour in said],
        labels=[drawable(text) for _, _, text, _ in said],
        show_labels=True,
        draw_order=30.0,
    )
    recording.log(f"{path}/words", labels, static=True, strict=True)


def _log_mark(recording: RecordingStream, path: str, panel: Panel, mark: Mark, order: float) -> None:
    colour = role_colour(mark.role, mark.opacity)
    if isinstance(mark, Area):
        _log_area(recording, path, panel, mark, order)
    elif isinstance(mark, Segments):
        ends = [seen_at(panel, *pair.T) for pair in mark.ends[~np.isnan(mark.ends).any(axis=(1, 2))]]
        _strips(recording, path, ends, colour, width=mark.width, order=order)
    else:
        if mark.width:
            _strips(recording, path, _curve(panel, mark), colour, width=mark.width, order=order)
        if mark.dot:
            _log_dots(recording, f"{path}/dots" if mark.width else path, panel, mark, order)


def _curve(panel: Panel, curve: Curve) -> list[FloatArray]:
    """The strips of a line within the panel: it ends on the edge, and is not drawn along it."""
    points = panel.within(curve.corners)
    outside = ~_is_inside(panel, points)
    around = np.pad(outside, 1, constant_values=True)
    points[outside & around[:-2] & around[2:]] = np.nan
    places = seen_at(panel, points[:, 0], points[:, 1])
    return [places[first:behind] for first, behind in runs(places) if behind - first > 1]


def _is_inside(panel: Panel, points: FloatArray) -> npt.NDArray[np.bool_]:
    """(n,) whether a point lies between the limits; nan does not."""
    left, top, width, height = panel.box
    places, edge = panel.place(points), 0.5  # half a point, against rounding
    return np.asarray(
        ((places >= (left - edge, top - edge)) & (places <= (left + width + edge, top + height + edge))).all(axis=-1)
    )


def _log_dots(recording: RecordingStream, path: str, panel: Panel, curve: Curve, order: float) -> None:
    """The dots within the panel; where the pointer rests on one, its numbers show."""
    shown = curve.corners[_is_inside(panel, curve.corners)]
    if not len(shown):
        return
    along, upwards = panel.x.label.split(" [")[0], panel.head.split(" [")[0]
    texts = [drawable(f"{along} {x:.5g}: {upwards} {y:.5g}") for x, y in shown.tolist()]
    dots = rr.Points2D(
        seen_at(panel, *shown.T),
        radii=rr.Radius.ui_points(0.7 * curve.dot),
        colors=role_colour(curve.role, curve.opacity),
        labels=texts,
        show_labels=False,
        draw_order=order + 0.5,
    )
    recording.log(path, dots, static=True, strict=True)


def _log_area(recording: RecordingStream, path: str, panel: Panel, area: Area, order: float) -> None:
    """An opaque box as strokes side by side; of a band with a name the rim, since the view cannot fill a polygon."""
    rims = [seen_at(panel, *polygon.T) for polygon in area.polygons if len(polygon)]
    if area.opacity < 1.0 and not area.label:
        return
    if area.opacity < 1.0:
        closed = [np.concatenate([rim, rim[:1]]) for rim in rims]
        _strips(recording, path, closed, role_colour(area.role, max(area.opacity, STYLE.pale)), order=order)
        return
    strokes, radii = [], []
    for rim in rims:
        (left, top), (right, bottom) = rim.min(axis=0), rim.max(axis=0)
        n_strokes = max(1, math.ceil((bottom - top) / 6.0))  # their ends are round
        edges, radius = np.linspace(top, bottom, n_strokes + 1), (bottom - top) / (2 * n_strokes)
        ends = min(left + radius, right), max(right - radius, left)
        strokes += [[(end, middle) for end in ends] for middle in ((edges[1:] + edges[:-1]) / 2).tolist()]
        radii += [radius] * n_strokes
    boxes = rr.LineStrips2D(strokes, radii=radii, colors=COLOURS[area.role], draw_order=order)
    recording.log(path, boxes, static=True, strict=True)


def _strips(
    recording: RecordingStream,
    path: str,
    strips: Sequence[object],
    colour: Colour,
    *,
    width: float = STYLE.thin,
    order: float,
) -> None:
    if strips:
        radius = rr.Radius.ui_points(Drawing.ENLARGED * width / 2)
        lines = rr.LineStrips2D(strips, radii=radius, colors=colour, draw_order=order)
        recording.log(path, lines, static=True, strict=True)


def _names(marks: Sequence[Mark]) -> list[str]:
    """The label of each as a part of a path, letters and digits alone; its place where it has none of its own."""
    names = [re.sub(r"[^a-z0-9]+", "_", mark.label.lower()).strip("_") for mark in marks]
    return [name if name and names.count(name) == 1 else f"{place}_{name}" for place, name in enumerate(names)]


def series_view(origin: str, name: str, contents: Sequence[str], *, legend: bool = True) -> Any:
    """The view of series over time, linked with all others."""
    return rrb.TimeSeriesView(
        origin=origin,
        contents=[f"+ {path if path.startswith('$') else '/' + path}" for path in contents],
        name=name,
        axis_x=rrb.TimeAxis(link="LinkToGlobal"),
        plot_legend=rrb.PlotLegend("RightTop", visible=legend),
    )


def plot_view(pane: Pane, name: str) -> Any:
    """The view of a drawn plot, in the shape of its pane."""
    return rrb.Spatial2DView(
        origin=pane.path,
        name=name,
        background=rrb.Background(Palette.BACKGROUND),
        visual_bounds=rrb.VisualBounds2D(x_range=(0.0, pane.width), y_range=(0.0, pane.height)),
    )


def tabs(views: Sequence[Any], name: str) -> Any:
    """A tab for each view, the first in front; a single view needs none."""
    return rrb.Tabs(*views, active_tab=0, name=name) if len(views) > 1 else views[0]


def document_view(path: str, name: str) -> Any:
    """The view of words."""
    return rrb.TextDocumentView(origin=path, name=name)
