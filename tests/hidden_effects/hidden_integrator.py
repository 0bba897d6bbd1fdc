"""A plant with hidden effects, marched in small steps, every record of a case at once.

    x' = A x + B u + E w(d, v, z, t),   d = displacement x, v = velocity x at the places

Over a step h the linear part is exact, and the laws are integrated by the fourth-order Runge-Kutta rule in the
coordinates that move with it:

    x2 = Eh x + h/2 Eh E w1,  x3 = Eh x + h/2 E w2,  x4 = Ef x + h Eh E w3,
    x+ = Ef x + h/6 (Ef E w1 + 2 Eh E (w2 + w3) + E w4),   Eh = exp(A h/2), Ef = exp(A h)

with the exact response to the input added to each line. The laws are sharp (`hidden_laws.py`). Inputs are held or
joined by lines between samples; a delayed input switches inside a sample, and there the steps are split.

Coulomb friction is followed through sliding and sticking without smoothing, its reversals located in time. At a place
that slides the friction is Fc sign(v). At a place that rests it is what holds the place at rest,

    w* = -(V (A x + B u + E w_others)) / (V E_friction)     (V x = v, so that V x' = 0)

as long as |w*| <= Fc. While it rests the whole plant obeys x' = S (A x + B u + E w_others) with the projector
S = I - E_friction V / (V E_friction): linear again, so sticking costs no more than sliding.

References:
    J. D. Lawson, "Generalized Runge-Kutta processes for stable systems with large Lipschitz constants", SIAM Journal on
    Numerical Analysis 4(3), 1967, doi:10.1137/0704033.

Nothing here imports okid, era or modal.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy
from hidden_laws import Coulomb, Law

LEAST_STRETCH = 1e-9
"""Stretches shorter than this share of a step are not looked into."""


def resting(plant, friction):
    """A, B, E of the plant while the place rests; its own column of E is zero."""
    V = plant.velocity[friction]
    S = np.eye(len(plant.A)) - np.outer(plant.E[:, friction], V) / (V @ plant.E[:, friction])
    return S @ plant.A, S @ plant.B, S @ plant.E


def holding_force(plant, friction, x, u, forces):
    """(n,) force that keeps the place at rest; x (n, n_states), u (n, n_inputs), forces (n, n_places) of the others."""
    V, others = plant.velocity[friction], np.array(forces)
    others[:, friction] = 0.0
    push = (x @ plant.A.T + u @ plant.B.T + others @ plant.E.T) @ V
    return -push / (V @ plant.E[:, friction])


def through_reversals(world, x, z, regime, *, t, length, u, slope):
    """One record from t over `length`, through every reversal, rest and breaking loose on the way.

    Classical Runge-Kutta in two halves from event to event: the stretches are shorter than a step of the march. Returns
    state, memory and regime (-1, 0, 1) at the end.
    """
    plant, laws, friction = world.plant, world.laws, world.friction
    V, E = plant.velocity[friction], plant.E[:, friction]
    rest_A, rest_B, rest_E = resting(plant, friction)
    n_places = plant.E.shape[1]

    def forces(x, z, time):
        d, v = plant.displacement @ x, plant.velocity @ x
        w, dz = np.zeros(n_places), np.zeros(n_places)
        for i, law in enumerate(laws):
            if i != friction:
                at = np.full((1, 1, 1), d[i]), np.full((1, 1, 1), v[i]), np.full((1, 1, 1), z[i]), time
                w[i], dz[i] = law.force(*at).item(), law.memory_rate(*at).item()
        return w, dz

    def slope_of(x, z, time, regime):
        w, dz = forces(x, z, time)
        now = u + slope * (time - t)
        if regime == 0:
            return rest_A @ x + rest_B @ now + rest_E @ w, dz
        w[friction] = regime * laws[friction].Fc
        return plant.A @ x + plant.B @ now + plant.E @ w, dz

    def advance(x, z, time, span, regime):
        h = span / 2
        for _ in range(2):
            k1, m1 = slope_of(x, z, time, regime)
            k2, m2 = slope_of(x + h / 2 * k1, z + h / 2 * m1, time + h / 2, regime)
            k3, m3 = slope_of(x + h / 2 * k2, z + h / 2 * m2, time + h / 2, regime)
            k4, m4 = slope_of(x + h * k3, z + h * m3, time + h, regime)
            x, z, time = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), z + h / 6 * (m1 + 2 * m2 + 2 * m3 + m4), time + h
        return x, z

    def holding(x, z, time):
        w, _ = forces(x, z, time)
        now = u + slope * (time - t)
        return holding_force(plant, friction, x[np.newaxis], now[np.newaxis], w[np.newaxis])[0]

    limit = laws[friction].Fc

    def margin(span, x, z, time, regime):
        """Positive while the regime lasts."""
        x, z = advance(x, z, time, span, regime)
        return regime * (V @ x) if regime != 0 else limit - abs(holding(x, z, time + span))

    time, left, first = t, length, LEAST_STRETCH * length
    while left > first:
        if margin(left, x, z, time, regime) >= 0:
            return *advance(x, z, time, left, regime), regime
        # a place that has just broken loose, or come to rest, has a margin of zero at its start
        span = first
        if margin(first, x, z, time, regime) > 0:
            span = scipy.optimize.brentq(
                margin, first, left, args=(x, z, time, regime), xtol=1e-13 * length, rtol=1e-14
            )
        x, z = advance(x, z, time, span, regime)
        x = x - E * (V @ x) / (V @ E)
        time, left = time + span, left - span
        needed = holding(x, z, time)
        # a place that was at rest has reached the limit, whatever rounding says
        regime = 0.0 if regime != 0 and abs(needed) <= limit else np.sign(needed)
    return x, z, regime


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


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class HiddenPlant:
    """Linear part and places; rows read the motion at each place off the state.

    `A` (n, n), `B` (n, n_inputs), `E` (n, n_places), `displacement` and `velocity` (n_places, n); `limit`: a state that
    overflows, (index, highest value).
    """

    A: np.ndarray
    B: np.ndarray
    E: np.ndarray
    displacement: np.ndarray
    velocity: np.ndarray
    limit: tuple[int, float] | None = None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class World:
    """A plant, one law a place, which of them is Coulomb friction (None: none), and if any has memory or slider."""

    plant: HiddenPlant
    laws: tuple[Law, ...]
    friction: int | None
    rated: bool
    dragged: bool

    @classmethod
    def of(cls, plant, laws):
        rubbing = [i for i, law in enumerate(laws) if isinstance(law, Coulomb)]
        if len(rubbing) > 1:
            raise ValueError("at most one place may have Coulomb friction")
        return cls(
            plant=plant,
            laws=tuple(laws),
            friction=rubbing[0] if rubbing else None,
            rated=any(law.has_rate for law in laws),
            dragged=any(law.has_slider for law in laws),
        )

    @property
    def limit(self):
        """Largest friction force."""
        return self.laws[self.friction].Fc

    def for_record(self, index):
        """As one record alone sees it."""
        return replace(self, laws=tuple(law.for_record(index) for law in self.laws))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class March:
    """At the samples, once the input of that sample has come: `states` (n_records, n_samples, n), `forces` and `memory`
    (n_records, n_samples, n_places)."""

    states: np.ndarray
    forces: np.ndarray
    memory: np.ndarray


def march(plant, laws, inputs, *, dt, hold, initial_states, n_steps, delay=0.0):
    """Every record of one plant at once.

    Args:
        plant: The linear part with its places.
        laws: One law a place, at most one of them Coulomb friction.
        inputs: (n_records, n_samples, n_inputs).
        dt: [s].
        hold: "zero_order" or "linear".
        initial_states: (n_records, n).
        n_steps: Steps a sample.
        delay: By which every input is late [s]; before the record it was zero. Only with "zero_order".
    """
    world = World.of(plant, laws)
    pace = Pace.of(world, inputs, dt=dt, hold=hold, n_steps=n_steps, delay=delay)
    n_records, n_samples, _ = inputs.shape
    n, m = len(plant.A), len(laws)
    x, z = np.array(initial_states, dtype=float)[:, np.newaxis, :], np.zeros((n_records, 1, m))
    states, forces, memory = (np.empty((n_records, n_samples, width)) for width in (n, m, m))
    friction = world.friction
    regime = np.zeros(n_records) if friction is None else np.sign(x[:, 0] @ plant.velocity[friction])
    for k in range(n_samples):
        for j in range(len(pace.lengths)):
            t = k * dt + pace.times[j]
            if friction is not None:
                regime = _released(world, regime, x, z, t=t, u=pace.start[j][k])
            matrices, forced = pace.at(j, k, regime)
            if j == 0:
                states[:, k], memory[:, k] = x[:, 0], z[:, 0]
                forces[:, k] = _forces_at_sample(world, regime, x, z, t=t, u=pace.start[j][k])
            before = x, z
            x, z = _advance(matrices, forced, world, regime, x=x, z=z, t=t, h=pace.lengths[j])
            if friction is not None:
                end = pace.start[j][k] + pace.slope[j][k] * pace.lengths[j]
                for r in np.flatnonzero(_left_regime(world, regime, x, z, t=t + pace.lengths[j], u=end)):
                    x[r, 0], z[r, 0], regime[r] = through_reversals(
                        world.for_record(r), before[0][r, 0], before[1][r, 0], regime[r],
                        t=t, length=pace.lengths[j], u=pace.start[j][k, r], slope=pace.slope[j][k, r],
                    )  # fmt: skip
            if plant.limit is not None:
                x[:, 0, plant.limit[0]] = np.minimum(x[:, 0, plant.limit[0]], plant.limit[1])
    return March(states=states, forces=forces, memory=memory)


def _advance(step, forced, world, regime, *, x, z, t, h):
    """One step; x (n_records, 1, n), z (n_records, 1, n_places)."""
    rated = world.rated
    m, p = len(world.laws), 2 * len(world.laws)
    straight = x @ step.stacked + forced
    if not m:
        return straight, z
    pushed = np.multiply if m == 1 else np.matmul  # by one force, a product of matrices is one of numbers
    n_first, n_middle = straight[..., :p], straight[..., p : 2 * p]
    w1, r1 = _force(world, regime, n_first, z, t)
    second = n_middle + pushed(w1, step.second)
    w2, r2 = _force(world, regime, second, z + h / 2 * r1 if rated else z, t + h / 2)
    third = n_middle + pushed(w2, step.third)
    w3, r3 = _force(world, regime, third, z + h / 2 * r2 if rated else z, t + h / 2)
    fourth = straight[..., 2 * p : 3 * p] + pushed(w3, step.fourth)
    w4, r4 = _force(world, regime, fourth, z + h * r3 if rated else z, t + h)
    x = straight[..., 3 * p :] + pushed(w1, step.first_to_end)
    x += pushed(w2 + w3, step.middle_to_end)
    x += pushed(w4, step.last_to_end)
    if rated:
        z = z + h / 6 * (r1 + 2 * r2 + 2 * r3 + r4)
    if world.dragged:
        d = x @ step.displacement
        z = np.concatenate(
            [law.slid(d[..., i : i + 1], z[..., i : i + 1]) for i, law in enumerate(world.laws)], axis=-1
        )
    return x, z


def _force(world, regime, motion, z, t):
    """Forces and rates of memory (n_records, 1, n_places); a place that rests counts none: its plant holds it."""
    laws, friction, rated = world.laws, world.friction, world.rated
    m = len(laws)
    if m == 1 and friction is None:
        d, v = motion[..., :1], motion[..., 1:]
        return laws[0].force(d, v, z, t), laws[0].memory_rate(d, v, z, t) if rated else None
    w, r = [], []
    for i, law in enumerate(laws):
        at = motion[..., i : i + 1], motion[..., m + i : m + i + 1], z[..., i : i + 1], t
        w.append(law.Fc * regime[:, np.newaxis, np.newaxis] if i == friction else law.force(*at))
        if rated:
            r.append(law.memory_rate(*at))
    return np.concatenate(w, axis=-1), np.concatenate(r, axis=-1) if rated else None


def _forces_at_sample(world, regime, x, z, *, t, u):
    """(n_records, n_places) with the friction that holds where it rests."""
    plant, friction = world.plant, world.friction
    if not world.laws:
        return np.zeros((len(x), 0))
    motion = np.concatenate([x @ plant.displacement.T, x @ plant.velocity.T], axis=-1)
    w = _force(world, regime, motion, z, t)[0][:, 0]
    if friction is not None and np.any(regime == 0):
        held = regime == 0
        w[held, friction] = holding_force(plant, friction, x[held, 0], u[held], w[held])
    return w


def _left_regime(world, regime, x, z, *, t, u):
    """(n_records,) whether a place that slid has turned back, or one that rested is pushed beyond the friction."""
    left = regime * (x[:, 0] @ world.plant.velocity[world.friction]) < 0
    if np.any(regime == 0):
        left |= _released(world, regime, x, z, t=t, u=u) != regime
    return left


def _released(world, regime, x, z, *, t, u):
    """The regime after breaking loose: where more than Fc would be needed to hold the place."""
    if not np.any(regime == 0):
        return regime
    needed = _forces_at_sample(world, regime, x, z, t=t, u=u)[:, world.friction]
    return np.where((regime == 0) & (np.abs(needed) > world.limit), np.sign(needed), regime)
