"""Colours by meaning, the same in every picture, and the sizes of letters and lines."""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from okid.arrays import FloatArray

__all__ = ["COLOURS", "NINETY_FIVE", "STYLE", "Role", "envelope", "text_width"]

Role = Literal["paper", "ink", "muted", "grid", "measured", "model", "residual", "system", "doubtful", "noise"]
"""What a colour means: background, text, text of second rank, lines behind the data, what was measured, what the model
says, what is left over, and modes that are of the system, may be, and are not."""

COLOURS: Final[dict[Role, str]] = {
    "paper": "#ffffff",
    "ink": "#1c2430",
    "muted": "#667080",
    "grid": "#e1e5ea",
    "measured": "#2b6cd4",
    "model": "#e2761b",
    "residual": "#c63c4d",
    "system": "#12875c",
    "doubtful": "#b67a12",
    "noise": "#a3abb5",
}
"""Draw in these on light paper; a page exchanges each for its own by name."""


@dataclass(frozen=True, slots=True)
class Style:
    """Sizes in points, 1/72 inch, but for the page.

    Attributes:
        tick: letters of ticks and keys.
        label: letters of the names of axes.
        head: letters above a panel.
        line: height of a line of words over the size of its letters.
        grid: width of grid and axes.
        gap: between words and what they stand beside.
        sample: length of the piece of line in a key.
        margin: share of the range of the data that stays free at both ends of an axis.
        across: least distance of ticks along, wide enough for a number.
        down: least distance of ticks upwards.
        ground: opacity of the paper behind a key.
        thin: width of a line that another is to be seen over, or that only marks a place.
        stroke: width of a line.
        thick: width of the line that matters most.
        dot: diameter of a dot.
        faint: opacity of an area behind everything.
        pale: opacity of a band that means something, and of a line that is not to be trusted.
        half: opacity of what another line is drawn over.
        strong: opacity of a line that lets what is behind it shine through.
        page: width of a picture as wide as its page [in].
    """

    tick: float = 8.5
    label: float = 9.0
    head: float = 9.5
    line: float = 1.25
    grid: float = 0.7
    gap: float = 4.0
    sample: float = 18.0
    margin: float = 0.05
    across: float = 36.0
    down: float = 25.0
    ground: float = 0.85
    thin: float = 0.8
    stroke: float = 1.2
    thick: float = 1.7
    dot: float = 4.8
    faint: float = 0.12
    pale: float = 0.25
    half: float = 0.5
    strong: float = 0.8
    page: float = 10.4


NINETY_FIVE: Final = 1.96
"""Draw so many standard deviations for 95 %, the quantile of a normal distribution."""

STYLE: Final = Style()
"""Draw every picture in these sizes."""

_WIDTHS: Final = (("iljtfrI|!.,:;'()[] ·", 0.38), ("mwMW@%—…", 0.92), ("ABCDEFGHKNOPQRUVXYZ&+±−=<>≥≤→", 0.72))
"""Take letters as this wide, as a share of their size: those of the widest of the usual fonts of browsers."""


def text_width(text: str, size: float) -> float:
    """About how wide a line of words is [pt], on the safe side: the reader's browser has the font, not we."""
    kinds = {letter: width for letters, width in _WIDTHS for letter in letters}
    return size * sum(kinds.get(letter, 0.62) for letter in text)


def envelope(time: FloatArray, values: FloatArray, *, n_points: int = 1200) -> tuple[FloatArray, FloatArray]:
    """Least and greatest value of each of `n_points / 2` stretches: a long record drawn small, its peaks kept.

    Example:
        >>> import numpy as np
        >>> envelope(np.arange(8.0), np.array([0, 5.0, 1, 1, 1, -2, 0, 0]), n_points=4)[1].tolist()
        [0.0, 5.0, -2.0, 1.0]
    """
    if values.size <= n_points:
        return time, values
    step = -(-values.size // (n_points // 2))
    n_whole = values.size // step
    blocks = values[: n_whole * step].reshape(n_whole, step)
    empty = np.asarray(np.isnan(blocks).all(axis=1))
    filled = np.where(empty[:, None], 0.0, blocks)
    pairs = np.stack([np.nanmin(filled, axis=1), np.nanmax(filled, axis=1)], axis=1)
    pairs[empty] = np.nan
    times = time[: n_whole * step].reshape(n_whole, step)[:, [0, step // 2]]
    return times.ravel(), pairs.ravel()
