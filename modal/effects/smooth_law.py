"""A law of unknown form: a cubic spline through points, each of which a person can read.

The points stand over the motion that was seen, nearer together about rest, which quiet records see alone, without
conditions on the curvature at the ends ("not a knot"), since curvature 0 there would leave a rest of a pure cubic. The
outer cubics go on for one step more, then straight: a curve knows nothing beyond the motion that it was learned on.

Where the motion passes through rest, the law has neither value nor slope there: a constant force is an effect of its
own and a slope is a wrong linear stiffness or damping, which is calibrated. So the point nearest to rest is put there,
and the value at a neighbour p follows from those at all others, with s_j the slope at rest of the spline that is 1 at
point j and 0 at all others,

    f_p = -sum(s_j f_j, j != p) / s_p

References:
    de Boor, A Practical Guide to Splines, 2001, chapter 4; Noel, Schoukens, Grey-box state-space identification of
    nonlinear mechanical vibrations, Int. J. Control 91, 2018, https://doi.org/10.1080/00207179.2017.1308557.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar, Literal

import numpy as np
import numpy.typing as npt
import scipy

from modal.effects.effect import (
    Effect,
    Force,
    ForceEffect,
    Motion,
    ParameterKind,
    Situation,
    Values,
    cut_to_finite,
    memoryless,
)
from modal.simulation import DIFFERENCE_STEP
from okid.arrays import FloatArray

N_POINTS = (9, 15, 25)
"""Give a law so many points; more where it is still not smooth enough."""
CROWDING = 1.5
"""Let points crowd about rest by this power of equal steps: quiet records see nothing else of the law."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SmoothLaw(ForceEffect):
    """A force that is a smooth function of one motion.

    Class attributes:
        reads: The motion.

    Attributes:
        n_points: Number of points, the one at rest and its neighbour included.
        span: Range of the motion; None while it is not known.
    """

    n_points: int = N_POINTS[0]
    span: tuple[float, float] | None = None

    reads: ClassVar[Literal["displacement", "velocity"]]
    form_free = True
    reference = "Noel, Schoukens 2018, doi 10.1080/00207179.2017.1308557"

    @property
    def parameters(self) -> tuple[ParameterKind, ...]:  # type: ignore[override]
        """The range, which stays as it is once it is known, and the force at each point."""
        along = (0, 1, 0) if self.reads == "displacement" else (0, 1, -1)
        low, high = ((-np.inf, np.inf),) * 2 if self.span is None else ((end, end) for end in self.span)
        ends = (
            ParameterKind(
                name=name, meaning=f"{name} end of the {self.reads} seen", dimension=along, lower=bounds[0],
                upper=bounds[1], role="shape",
            )
            for name, bounds in (("low", low), ("high", high))
        )  # fmt: skip
        count = self.n_points - 2 * _passes_rest(*(self.span or (-1.0, 1.0)))
        points = (
            ParameterKind(name=f"force_{j + 1}", meaning=f"force at point {j + 1}", dimension=(1, 0, 0))
            for j in range(count)
        )
        return (*ends, *points)

    @property
    def neutral(self) -> tuple[float, ...]:  # type: ignore[override]
        """No force at any point."""
        return (*(self.span or (-1.0, 1.0)), *(0.0 for _ in self.parameters[2:]))

    def over(self, motion: Motion) -> "SmoothLaw":
        """The law over the range of a motion."""
        run = getattr(motion, self.reads)
        low, high = float(run.min()), float(run.max())
        return replace(self, span=(low, high if high > low else low + 1.0))

    def with_values(self, values: Mapping[str, float]) -> Effect:
        """The law with as many points, over the same range, as values have that were given for it."""
        low, high = float(values.get("low", -1.0)), float(values.get("high", 1.0))
        if not low < high:
            return self
        return replace(self, n_points=max(len(values) - 2, 1) + 2 * _passes_rest(low, high), span=(low, high))

    def starts(self, situation: Situation) -> tuple[tuple[float, ...], ...]:
        """Values to start from."""
        law = self if self.span is not None else self.over(situation.motion)
        return ((*(law.span or ()), *(1.0 for _ in self.parameters[2:])),)

    def force(self, values: Values, motion: Motion) -> Force:
        """The force and its derivatives."""
        run = cut_to_finite(getattr(motion, self.reads))
        heights = np.array([float(np.mean(value)) for value in values[2:]])
        low, high = (float(np.mean(value)) for value in values[:2])
        basis, rise = self._basis(run, low, high)
        by_range = [np.zeros_like(run)] * 2
        if self.span is None:
            step = DIFFERENCE_STEP
            by_range = [
                (self._basis(run, low + a, high + b)[0] - self._basis(run, low - a, high - b)[0]) @ heights / (2 * step)
                for a, b in ((step, 0.0), (0.0, step))
            ]
        slope = {f"by_{self.reads}": rise @ heights}
        return memoryless(motion, basis @ heights, (*by_range, *basis.T), **slope)

    def refined(self, values: Values, n_points: int) -> tuple["SmoothLaw", tuple[float, ...]]:
        """The same law with more points, and its values."""
        finer = replace(self, n_points=n_points)
        low, high = (float(value) for value in values[:2])
        at = _points(low, high, n_points)[_free(low, high, n_points)]
        heights = self._basis(at, low, high)[0] @ np.array([float(value) for value in values[2:]])
        return finer, (low, high, *(float(height) for height in heights))

    def curve(self, values: Values, motion: FloatArray) -> FloatArray:
        """(n,) the force along a motion."""
        low, high = (float(np.mean(value)) for value in values[:2])
        return np.asarray(self._basis(motion, low, high)[0] @ np.array([float(np.mean(one)) for one in values[2:]]))

    def intervals(self, values: Values, motion: FloatArray) -> npt.NDArray[np.intp]:
        """(n,) the interval between points that each value of a motion lies in."""
        low, high = (float(np.mean(value)) for value in values[:2])
        return np.searchsorted(_points(low, high, self.n_points)[1:-1], motion)

    def bends(self, values: Values, n_pairs: int) -> FloatArray:
        """(n, n_parameters) jumps of the third derivative at the `n_pairs` points next to rest on either side.

        Without such a jump the cubics on both sides of a point are one, as if it were not there: so are the outer ones.
        """
        low, high = (float(np.mean(value)) for value in values[:2])
        if not _passes_rest(low, high):
            return np.zeros((0, len(self.parameters)))
        rest = _at_rest(_points(low, high, self.n_points))
        near = [rest + side * step for step in range(1, n_pairs + 1) for side in (-1, 1)]
        near = [i for i in near if 2 <= i <= self.n_points - 3]
        cubes = 6.0 * _splines(low, high, self.n_points)[0].c[0]
        jumps = np.array([cubes[i] - cubes[i - 1] for i in near]).reshape(len(near), cubes.shape[-1])
        return np.column_stack([np.zeros((len(near), 2)), jumps])

    def linear_name(self, where: str) -> str:
        """Name of the linear parameter of the same motion at a place."""
        return f"{'stiffness' if self.reads == 'displacement' else 'damping'} of {where}"

    def _basis(self, run: FloatArray, low: float, high: float) -> tuple[FloatArray, FloatArray]:
        """(n, n_parameters - 2) what each point's force adds to the law, and its slopes."""
        spline, slope, ends = _splines(low, high, self.n_points)
        at = np.clip(run, *ends)
        values, rise = spline(at), slope(at)
        return values + rise * (run - at)[:, None], rise


def _passes_rest(low: float, high: float) -> bool:
    return low < 0.0 < high


def _points(low: float, high: float, n_points: int) -> FloatArray:
    """The points; the one nearest to rest stands there, where the motion passes it."""
    ends = np.array([low, high])
    first, last = np.sign(ends) * np.abs(ends) ** (1.0 / CROWDING)
    steps = np.linspace(first, last, n_points)
    points = np.sign(steps) * np.abs(steps) ** CROWDING
    points[0], points[-1] = low, high
    if _passes_rest(low, high):
        points[_at_rest(points)] = 0.0
    return np.asarray(points)


def _at_rest(points: FloatArray) -> int:
    return 1 + int(np.argmin(np.abs(points[1:-1])))


def _free(low: float, high: float, n_points: int) -> list[int]:
    """The points whose forces are free: all but the one at rest and the one that follows from a slope of 0 there."""
    if not _passes_rest(low, high):
        return list(range(n_points))
    rest = _at_rest(_points(low, high, n_points))
    return [i for i in range(n_points) if i not in (rest, rest + 1)]


@lru_cache(maxsize=64)
def _splines(
    low: float, high: float, n_points: int
) -> "tuple[scipy.interpolate.CubicSpline, scipy.interpolate.PPoly, tuple[float, float]]":
    """The spline of each free point, its slope, and where they go on straight."""
    points = _points(low, high, n_points)
    free = _free(low, high, n_points)
    heights = np.eye(n_points)[:, free]
    if len(free) < n_points:
        follows = next(i for i in range(n_points) if i not in free and points[i] != 0.0)
        slopes = scipy.interpolate.CubicSpline(points, np.eye(n_points))(0.0, 1)
        heights[follows] = -slopes[free] / slopes[follows]
    spline = scipy.interpolate.CubicSpline(points, heights)
    ends = (2.0 * points[0] - points[1], 2.0 * points[-1] - points[-2])
    return spline, spline.derivative(), ends


@dataclass(frozen=True, slots=True, kw_only=True)
class SmoothStiffness(SmoothLaw):
    """A force that is some smooth function of the displacement, given by its values at points (`SmoothLaw`).

    In the data: whatever the curve makes of it.

    Confused with: every smooth law of the displacement that has a name, which it contains, so it is tried only where
    these fail the test of what they leave. Corners are rounded off.

    Parameters: low, high [length], the range that was seen; force_j [force] at the points between them.

    References:
        Noel, Schoukens, Grey-box state-space identification of nonlinear mechanical vibrations, Int. J. Control 91,
        2018, doi 10.1080/00207179.2017.1308557.
    """

    key = "smooth_stiffness"
    law = "f = smooth function of d through points"
    family = "stiffness of any form"
    signature = "any smooth law of the displacement"
    reads = "displacement"


@dataclass(frozen=True, slots=True, kw_only=True)
class SmoothDamping(SmoothLaw):
    """A force that is some smooth function of the velocity, given by its values at points (`SmoothLaw`).

    In the data: whatever the curve makes of it.

    Confused with: every smooth law of the velocity that has a name, which it contains, so it is tried only where these
    fail the test of what they leave. A jump at rest is dry friction, an effect of its own.

    Parameters: low, high [length/time], the range that was seen; force_j [force] at the points between them.

    References:
        Noel, Schoukens, Grey-box state-space identification of nonlinear mechanical vibrations, Int. J. Control 91,
        2018, doi 10.1080/00207179.2017.1308557.
    """

    key = "smooth_damping"
    law = "f = smooth function of v through points"
    family = "damping of any form"
    signature = "any smooth law of the velocity"
    reads = "velocity"
    needs = frozenset({"velocity"})
