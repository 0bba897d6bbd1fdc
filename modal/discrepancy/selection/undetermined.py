"""What the data do not fix of a law that explains them: then one of its limits explains them as well.

A length, a time or a frequency whose deviation is as large as itself may be any. Two limits are reached otherwise:

A hung mass acts on its place by m w^2 / (1 - (w / w0)^2), so what the records tell of its frequency f0 is 1 / f0^2,
the give of its spring; that is 2 / f0 times as uncertain as f0, and at 0 the mass is fixed rigidly. No more of it is
seen where f0 lies above 99.9 % of the power of each input and output, or above half the sampling frequency: any mass
does the same.

A gain is none at one. Beside other masses the gain of the only input is the scale of all masses, stiffnesses and
dampings, those too that are held: what is said of them beforehand, relative deviations s_j, fixes the scale to
(sum of 1 / s_j^2)^(-1/2) and no better.
"""

from collections.abc import Collection, Sequence

import numpy as np

from modal.discrepancy.fitting.estimation import covariance
from modal.discrepancy.fitting.nodes import Node, Task, grid_error
from modal.discrepancy.selection.lack_of_fit import SLIGHT
from modal.effects.ambiguity import Circumstance
from modal.effects.catalogue import effect_name
from modal.effects.effect import ParameterKind
from modal.simulation import SURE
from modal.simulation.assembly import EffectPlacement
from modal.simulation.plant import Plant
from modal.wording.text import number, quantity
from okid.record import Record

GAINS = frozenset({"input_gain", "sensor_gain"})
HARDLY_ANY = 1e-3
"""Take a band to end where no more than this share of the power of a channel lies above it."""


def undetermined(
    best: Node, root: Node, task: Task, fits: Sequence[Record], circumstances: Collection[Circumstance]
) -> list[str]:
    """Why parameters of a law that the data do not fix make it no firm name: the law is one of its limits."""
    grid = grid_error(best)
    spread = np.hypot(np.sqrt(np.maximum(np.diag(covariance(best.coarse, task.fit))[: grid.size], 0.0)), grid)
    assembly, reasons = best.coarse.assembly, []
    scale = _scale_deviation(assembly.plant) if "other_masses" in circumstances else 0.0
    highest = highest_frequency(fits)
    for i, item in enumerate(assembly.placements[len(root.effects) :], start=len(root.effects)):
        span = assembly.common_of(i)
        for j, value, deviation in zip(item.common, best.fitted.unknowns.common[span], spread[span], strict=False):
            kind, size = item.effect.parameters[j], float(value)
            what = "frequency" if _hangs(item, kind) else kind.meaning
            of = f"the {what} of {effect_name(item.effect.key)} at {item.where}"
            if item.effect.key in GAINS:
                open_by = float(np.hypot(deviation, scale * size if item.effect.key == "input_gain" else 0.0))
                if SLIGHT <= abs(size - 1.0) <= SURE * open_by:
                    reasons.append(
                        f"{of} is not determined ({number(size)} +- {number(open_by)}): none at all, a gain of one, "
                        "explains the data as well"
                    )
            elif _hangs(item, kind) and size > highest:
                reasons.append(
                    f"{of} ({quantity(size, 'Hz')}) lies above 99.9 % of the power of every input and output "
                    f"({quantity(highest, 'Hz')}): one of its limits explains the data as well: a mass"
                )
            elif _is_open(item, kind, size, float(deviation)):
                limit = ": a mass" if _hangs(item, kind) else ""
                reasons.append(
                    f"{of} is not determined ({number(size)} +- {number(deviation)}): one of its limits explains the "
                    f"data as well{limit}"
                )
    return reasons


def _is_open(item: EffectPlacement, kind: ParameterKind, value: float, deviation: float) -> bool:
    """Whether a length, a time or a frequency may be none, or infinite where a mass hangs by it."""
    if kind.role != "shape" or not any(kind.dimension):
        return False
    if _hangs(item, kind):
        return not value > 2.0 * SURE * deviation
    return not abs(value) > deviation  # nor is a zero at a bound


def _hangs(item: EffectPlacement, kind: ParameterKind) -> bool:
    """Whether a parameter is the frequency of a mass that hangs on a spring."""
    return item.effect.key == "missing_mode" and kind.name == "frequency"


def highest_frequency(records: Sequence[Record]) -> float:
    """The frequency below which all but a thousandth of the power lies of each input and output, in Hz.

    Example:
        >>> t = 0.01 * np.arange(400.0)
        >>> waves = [Record(np.sin(20 * np.pi * t), np.sin(f * np.pi * t), 0.01) for f in (10, 40)]
        >>> highest_frequency(waves[:1]), highest_frequency(waves)
        (10.0, 20.0)
        >>> gaps = np.where(np.arange(400) % 37, 9.81 + 0.1 * np.sin(10 * np.pi * t), np.nan)
        >>> highest_frequency([Record(np.sin(20 * np.pi * t), gaps, 0.01)])
        10.0
    """
    found = 0.0
    for record in records:
        signals = np.hstack([record.inputs, record.outputs])
        rows, known = np.arange(len(signals)), [np.flatnonzero(np.isfinite(one)) for one in signals.T]
        lines = [np.interp(rows, at, one[at]) for one, at in zip(signals.T, known, strict=True) if at.size]
        whole = np.array(lines).T  # straight over gaps: zeros there would move at all frequencies
        power = np.abs(np.fft.rfft(whole - whole.mean(axis=0), axis=0)) ** 2
        for one in np.cumsum(power, axis=0).T:
            line = int(np.searchsorted(one, (1.0 - HARDLY_ANY) * one[-1])) if one[-1] > 0.0 else 0
            found = max(found, line / (record.n_samples * record.dt))
    return found


def _scale_deviation(plant: Plant) -> float:
    """How well the scale of a model is known beforehand, as a share of it."""
    every = [*plant.parameters, *(one.parameter for one in plant.masses)]
    return float(np.sum([(one.nominal / one.deviation) ** 2 for one in every if one.deviation > 0.0]) ** -0.5)


PLAUSIBLE_GAIN = (0.3, 3.0)
"""Doubt a gain beyond these: a unit is wrong (a thousand, g, degrees)."""
HARDLY_FOLLOWS = 0.03
"""Call a channel dead or another one where its gain is below this size."""


def doubted_gains(best: Node, root: Node) -> list[str]:
    """Why a gain far from one, a wrong unit, or one that hardly differs from one, is not firm."""
    reasons = []
    for item, i in zip(
        best.coarse.assembly.placements[len(root.effects) :], range(len(root.effects), len(best.effects)), strict=True
    ):
        if item.effect.key in GAINS:
            gain = float(best.coarse.unknowns.common[best.coarse.assembly.common_of(i).start])
            if not PLAUSIBLE_GAIN[0] <= gain <= PLAUSIBLE_GAIN[1]:
                reasons.append(doubted_gain(gain, item.where))
            elif abs(gain - 1.0) < SLIGHT:
                reasons.append(
                    f"a gain of {number(gain, 4)} at {item.where} is within a hundredth of one, which no gauge is sure "
                    "of and errors of a simulation look like"
                )
    return reasons


def doubted_gain(gain: float, where: str) -> str:
    """What a gain far from one looks like; a thousandth may be a unit or a dead channel, so both are named."""
    words = f"a gain of {number(gain)} at {where} looks like"
    if abs(gain) < HARDLY_FOLLOWS:
        return f"{words} a dead or wrong channel, or a wrong unit: check the wiring and the units of the records"
    if PLAUSIBLE_GAIN[0] <= -gain <= PLAUSIBLE_GAIN[1]:
        return f"{words} a turned direction: check the sign of the channel"
    return f"{words} a wrong unit: check the units of the records"
