"""Thrust and speed of a measured propeller: is the law a square?

A staircase holds the command of a motor for 600 samples a step; columns `sample, command, rpm_raw, force_raw`. The
first half of each step is left out as transient. Speed and thrust follow from the raw columns as their author says
(`about.json` beside the files): rpm = raw 780/12; a mass of 0.5 kg on a lever of 88 mm gave the strain gauge v2, none
gave v1, and the motor pulls at 84 mm.

The thrust F = a w^p is fitted by least squares over the steps, p and a free. What the law leaves is mostly drift of the
gauge from step to step, not the noise of one sample, so the interval of p is drawn from what is left.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from okid.arrays import FloatArray
from okid.errors import UnreadableFileError

__all__ = ["ThrustLaw", "read_staircase", "thrust_law", "thrust_sentences"]

GRAVITY = 9.81
MASS, MASS_LEVER, MOTOR_LEVER = 0.5, 0.088, 0.084
"""[kg], [m], [m] of the calibration."""
STAIRCASES = {"14.4": "tiger700_14p4V.csv", "15.0": "tiger700_15p0V.csv"}
"""Supply voltage and file."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ThrustLaw:
    """F = a w^p over the steps of one staircase.

    Attributes:
        n_steps: number of steps.
        largest: thrust of the fastest step [N].
        exponent: p.
        exponent_std: its standard deviation, from what the law leaves.
        left: root mean square of what the fitted law leaves [N].
        left_by_square: the same with p = 2 [N].
    """

    n_steps: int
    largest: float
    exponent: float
    exponent_std: float
    left: float
    left_by_square: float


def thrust_law(speeds: FloatArray, thrusts: FloatArray) -> ThrustLaw:
    """Fit F = a w^p by Gauss-Newton from p = 2.

    Args:
        speeds: (n_steps,) positive [rad/s].
        thrusts: (n_steps,) [N].

    Example:
        >>> speeds = np.linspace(100.0, 1000.0, 20)
        >>> law = thrust_law(speeds, 1e-5 * speeds**2.1)
        >>> round(law.exponent, 6), law.left < 1e-9 < law.left_by_square
        (2.1, True)
    """
    ratio = speeds / speeds.max()
    square = ratio**2
    factor, exponent = float(square @ thrusts / (square @ square)), 2.0
    by_square = thrusts - factor * square
    for _ in range(30):
        law = ratio**exponent
        slopes = np.stack([law, factor * law * np.log(ratio)], axis=1)
        step = np.linalg.lstsq(slopes, thrusts - factor * law, rcond=None)[0]
        factor, exponent = factor + float(step[0]), exponent + float(step[1])
    left = thrusts - factor * ratio**exponent
    spread = np.linalg.inv(slopes.T @ slopes) * (left @ left) / (len(thrusts) - 2)
    return ThrustLaw(
        n_steps=len(thrusts),
        largest=float(thrusts[speeds.argmax()]),
        exponent=exponent,
        exponent_std=float(np.sqrt(spread[1, 1])),
        left=float(np.sqrt(np.mean(left**2))),
        left_by_square=float(np.sqrt(np.mean(by_square**2))),
    )


def read_staircase(folder: Path, voltage: str) -> tuple[FloatArray, FloatArray]:
    """Speed [rad/s] and thrust [N] of each step, settled.

    Args:
        folder: with the staircases and `about.json`.
        voltage: of the supply, a key of `STAIRCASES`.

    Raises:
        UnreadableFileError: a file is missing or is not what it should be.
    """
    try:
        about = json.loads((folder / "about.json").read_text(encoding="utf-8"))
        unloaded, loaded = (float(about["tiger700"]["calibration"][voltage][key]) for key in ("v1", "v2"))
        table = np.loadtxt(folder / STAIRCASES[voltage], delimiter=",", skiprows=1, ndmin=2)
        _, command, speed, force = table.T
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise UnreadableFileError(
            f"{folder} does not hold the staircase {STAIRCASES[voltage]} with its calibration in about.json "
            f"({type(error).__name__}); name the folder that does."
        ) from error
    steps = [np.flatnonzero(command == level) for level in np.unique(command)]
    settled = [rows[len(rows) // 2 :] for rows in steps]
    newton = MASS * GRAVITY * MASS_LEVER / MOTOR_LEVER / (loaded - unloaded)
    # single counts of the speed are wrong by thousands: the median does not see them
    speeds = np.array([np.median(speed[rows]) for rows in settled]) * (780 / 12) * (2 * np.pi / 60)
    thrusts = np.array([np.mean(force[rows]) - unloaded for rows in settled]) * newton
    return speeds, thrusts


def thrust_sentences(folder: Path | None) -> Sequence[str]:
    """What the measured staircases say of the square law, a sentence each; or that there are none.

    Args:
        folder: of the staircases, None where there is none.
    """
    if folder is None:
        return ("measured thrust: skipped, no folder of staircases was named (--measured FOLDER).",)
    sentences = []
    for voltage in STAIRCASES:
        try:
            law = thrust_law(*read_staircase(folder, voltage))
        except UnreadableFileError as error:
            return (f"measured thrust: skipped, {error}",)
        sentences.append(
            f"measured thrust at {voltage} V, {law.n_steps} steps up to {law.largest:.1f} N: exponent "
            f"{law.exponent:.2f} +- {1.96 * law.exponent_std:.2f} (95 %); a pure square leaves "
            f"{100 * law.left_by_square / law.largest:.1f} % of the largest thrust, the fitted power "
            f"{100 * law.left / law.largest:.1f} %"
        )
    return sentences
