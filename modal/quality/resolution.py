"""Few levels in use: the channel's own steps are as large as what it measures.

Rounding to levels a distance q apart adds noise of standard deviation q / sqrt(12) (Widrow's model, good from about q =
one standard deviation of the signal downwards).

References:
    Widrow, Kollar, Quantization Noise, 2008, chapter 5, doi 10.1017/CBO9780511754661.
"""

import numpy as np

from modal.quality.channel import Channel, named, where_found
from modal.quality.findings import Finding
from modal.wording.numbers import percent

__all__ = ["resolution_findings", "resolution_of"]

DOUBTFUL_NOISE = 0.05
"""Rounding noise in standard deviations of the channel: 26 dB, four levels a standard deviation and a half."""
BAD_NOISE = 0.3
"""About one level a standard deviation."""
_SAMPLES = 1 << 16
_OFF_GRID = 0.05
_SAME = 1e-9


def resolution_of(channel: Channel) -> float:
    """Distance of neighbouring levels, nan where the values lie on no grid.

    Example:
        >>> from okid.record import Record
        >>> from okid.scaling import channel_scaling
        >>> from modal.quality.channel import channels_of
        >>> record = Record([], 0.5 * np.random.default_rng(0).integers(-9, 9, 400), 0.1)
        >>> [resolution_of(channel) for channel in channels_of([record], channel_scaling([record]))]
        [0.5]
    """
    if channel.std == 0.0:
        return float("nan")
    taken = [part[: max(2, _SAMPLES * part.size // channel.n_samples)] for part in channel.parts]
    values = np.unique(np.concatenate(taken))
    values = values[~np.isnan(values)]
    gaps = np.diff(values)
    gaps = gaps[gaps > _SAME * channel.extent]
    if gaps.size < 1:
        return float("nan")
    step = float(gaps.min())
    multiples = gaps / step
    step = float(gaps[multiples < 1.5].mean())
    multiples = gaps / step
    on_grid = np.abs(multiples - np.round(multiples)) <= _OFF_GRID
    # two values always lie on a grid: a channel with as many values as samples has none
    enough = 2 * values.size <= sum(part.size for part in taken)
    return step if on_grid.all() and (enough or multiples.max() < 1.5) else float("nan")


def resolution_findings(channel: Channel, resolution: float, n_records: int) -> list[Finding]:
    """Rounding noise that is a notable part of an output; the levels of an input are what they are."""
    if channel.role == "input" or not np.isfinite(resolution):
        return []
    noise = resolution / (np.sqrt(12.0) * channel.std)
    if noise < DOUBTFUL_NOISE:
        return []
    n_levels = round(channel.extent / resolution) + 1
    return [
        Finding(
            level="bad" if noise >= BAD_NOISE else "doubtful",
            what="coarse",
            where=where_found(channel.name, (), n_records),
            sentence=f"output {named(channel.name)} moves over {n_levels} levels only, {channel.value(resolution)} "
            f"apart: rounding alone adds noise of {percent(noise)} of its motion; use a smaller range or a more "
            "sensitive sensor.",
            channels=(channel.name,),
            share=float(noise),
        )
    ]
