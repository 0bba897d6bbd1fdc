"""A plant with hidden effects, marched in small steps, every record of a case at once.

    x' = A x + B u + E w(d, v, z, t),   d = displacement x, v = velocity x at the places

Over a step h the linear part is exact, and the laws are integrated by the fourth-order Runge-Kutta rule in the
coordinates that move with it:

    x2 = Eh x + h/2 Eh E w1,  x3 = Eh x + h/2 E w2,  x4 = Ef x + h Eh E w3,
    x+ = Ef x + h/6 (Ef E w1 + 2 Eh E (w2 + w3) + E w4),   Eh = exp(A h/2), Ef = exp(A h)

with the exact response to the input added to each line. The laws are sharp (`hidden_laws.py`); Coulomb friction is
followed through sliding and sticking with its reversals located (`hidden_sticking.py`). Inputs are held or joined by
lines between samples; a delayed input switches inside a sample, and there the steps are split.

References:
    J. D. Lawson, "Generalized Runge-Kutta processes for stable systems with large Lipschitz constants", SIAM Journal on
    Numerical Analysis 4(3), 1967, doi:10.1137/0704033.

Nothing here imports okid, era or modal.
"""

from dataclasses import dataclass, replace

import numpy as np
from hidden_laws import Coulomb, Law
from hidden_steps import Pace
from hidden_sticking import holding_force, through_reversals

__all__ = ["HiddenPlant", "March", "World", "march"]


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
    """A plant, one law a place, which of them is Coulomb friction (None: none), and whether any has a memory."""

    plant: HiddenPlant
    laws: tuple[Law, ...]
    friction: int | None
    rated: bool

    @classmethod
    def of(cls, plant, laws):
        rubbing = [i for i, law in enumerate(laws) if isinstance(law, Coulomb)]
        if len(rubbing) > 1:
            raise ValueError("at most one place may have Coulomb friction")
        rated = any(law.has_rate for law in laws)
        return cls(plant=plant, laws=tuple(laws), friction=rubbing[0] if rubbing else None, rated=rated)

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
    laws, rated = world.laws, world.rated
    m, p = len(laws), 2 * len(laws)
    straight = x @ step.stacked + forced
    if not m:
        return straight, z
    n_first, n_middle = straight[..., :p], straight[..., p : 2 * p]
    w1, r1 = _force(world, regime, n_first, z, t)
    second = n_middle + w1 @ step.second
    w2, r2 = _force(world, regime, second, z + h / 2 * r1 if rated else z, t + h / 2)
    third = n_middle + w2 @ step.third
    w3, r3 = _force(world, regime, third, z + h / 2 * r2 if rated else z, t + h / 2)
    fourth = straight[..., 2 * p : 3 * p] + w3 @ step.fourth
    w4, r4 = _force(world, regime, fourth, z + h * r3 if rated else z, t + h)
    x = straight[..., 3 * p :] + w1 @ step.first_to_end + (w2 + w3) @ step.middle_to_end + w4 @ step.last_to_end
    if rated:
        z = z + h / 6 * (r1 + 2 * r2 + 2 * r3 + r4)
    if any(law.has_slider for law in laws):
        d = x @ step.displacement
        z = np.concatenate([law.slid(d[..., i : i + 1], z[..., i : i + 1]) for i, law in enumerate(laws)], axis=-1)
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
