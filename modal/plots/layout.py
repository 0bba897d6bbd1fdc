"""A chart: panels in rows and columns, a key, and where each of them lies; nothing is drawn here.

A chart is made once and read several times: `modal.plots.vector` draws it for a page and tells the page's script its
numbers, `modal.recording` draws it for the Rerun viewer, `modal.plots.results` as a matplotlib figure.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from modal.plots.panels import STYLE, Panel, text_width

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
