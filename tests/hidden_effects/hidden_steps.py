"""The steps of a sample: their lengths, their matrices, and what the input does in them.

Nothing here imports okid, era or modal.
"""

from dataclasses import dataclass

import numpy as np
import scipy
from hidden_sticking import resting

__all__ = ["Pace", "Step"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Step:
    """Matrices of a step, transposed to act on rows; leading axis one a record where records differ."""

    stacked: np.ndarray
    second: np.ndarray
    third: np.ndarray
    fourth: np.ndarray
    first_to_end: np.ndarray
    middle_to_end: np.ndarray
    last_to_end: np.ndarray
    displacement: np.ndarray

    @classmethod
    def of(cls, A, E, displacement, velocity, h):
        half, full = scipy.linalg.expm(A * h / 2), scipy.linalg.expm(A * h)
        motion = np.vstack([displacement, velocity])
        return cls(
            stacked=np.vstack([motion, motion @ half, motion @ full, full]).T,
            second=h / 2 * (motion @ half @ E).T,
            third=h / 2 * (motion @ E).T,
            fourth=h * (motion @ half @ E).T,
            first_to_end=h / 6 * (full @ E).T,
            middle_to_end=h / 3 * (half @ E).T,
            last_to_end=h / 6 * E.T,
            displacement=displacement.T,
        )

    @classmethod
    def chosen(cls, slide, rest, is_resting):
        """One leading entry a record."""
        names = cls.__dataclass_fields__
        return cls(**{name: np.stack([getattr(slide, name), getattr(rest, name)])[is_resting] for name in names})


class Pace:
    """The steps of a sample: their lengths, matrices and inputs, for sliding and for resting."""

    def __init__(self, world, plants, lengths, *, start, slope):
        displacement, velocity = world.plant.displacement, world.plant.velocity
        self.friction, self.lengths, self.start, self.slope = world.friction, lengths, start, slope
        motion = np.vstack([displacement, velocity])
        self.times = np.concatenate([[0.0], np.cumsum(lengths)])
        self._steps = [{h: Step.of(A, E, displacement, velocity, h) for h in set(lengths)} for A, _, E in plants]
        self._forced = [
            [_response_to_input(A, B, motion, h, start=start[j], slope=slope[j]) for j, h in enumerate(lengths)]
            for A, B, _ in plants
        ]
        self._chosen = {}

    @classmethod
    def of(cls, world, inputs, *, dt, hold, n_steps, delay):
        if delay and hold != "zero_order":
            raise ValueError("an input can be late only if it is held")
        plant = world.plant
        plants = [(plant.A, plant.B, plant.E)]
        if world.friction is not None:
            plants.append(resting(plant, world.friction))
        lengths, lags = _schedule(dt, n_steps, delay)
        start, slope = _input_pieces(np.swapaxes(inputs, 0, 1), lengths, lags, dt=dt, hold=hold)
        return cls(world, plants, lengths, start=start, slope=slope)

    def at(self, j, k, regime):
        """Matrices and response to the input of step j of sample k."""
        h = self.lengths[j]
        if self.friction is None:
            return self._steps[0][h], self._forced[0][j][k]
        is_resting = (regime == 0).astype(int)
        key = h, is_resting.tobytes()
        if key not in self._chosen:
            self._chosen[key] = Step.chosen(self._steps[0][h], self._steps[1][h], is_resting)
        slide, rest = self._forced[0][j][k], self._forced[1][j][k]
        return self._chosen[key], np.where(is_resting[:, np.newaxis, np.newaxis], rest, slide)


def _schedule(dt, n_steps, delay):
    """Lengths of the steps of a sample, and by how many samples the input that acts in each is late."""
    whole = int(np.floor(delay / dt + 1e-9))
    rest = delay - whole * dt
    if rest < 1e-9 * dt:
        return [dt / n_steps] * n_steps, [whole] * n_steps
    early = max(1, round(n_steps * rest / dt))
    late = max(1, n_steps - early)
    return [rest / early] * early + [(dt - rest) / late] * late, [whole + 1] * early + [whole] * late


def _input_pieces(inputs, lengths, lags, *, dt, hold):
    """Value and slope of the input at the start of each step; inputs (n_samples, n_records, n_inputs)."""
    times = np.concatenate([[0.0], np.cumsum(lengths)])
    start, slope = [], []
    for j, lag in enumerate(lags):
        if hold == "zero_order":
            start.append(np.concatenate([np.zeros_like(inputs[:lag]), inputs[: len(inputs) - lag]]))
            slope.append(np.zeros_like(inputs))
        else:
            rise = np.diff(inputs, axis=0, append=inputs[-1:]) / dt
            start.append(inputs + rise * times[j])
            slope.append(rise)
    return start, slope


def _response_to_input(A, B, motion, h, *, start, slope):
    """What the input of a step adds to each block of `Step.stacked`, (n_samples, n_records, 1, ...)."""
    n, n_inputs = B.shape

    def response(length):
        block = np.zeros((n + 2 * n_inputs,) * 2)
        block[:n, :n], block[:n, n : n + n_inputs] = A, B
        block[n : n + n_inputs, n + n_inputs :] = np.eye(n_inputs)
        exact = scipy.linalg.expm(block * length)
        return start @ exact[:n, n : n + n_inputs].T + slope @ exact[:n, n + n_inputs :].T

    half, full = response(h / 2), response(h)
    blocks = [np.zeros((*start.shape[:2], len(motion))), half @ motion.T, full @ motion.T, full]
    return np.concatenate(blocks, axis=-1)[:, :, np.newaxis, :]
