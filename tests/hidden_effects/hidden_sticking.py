"""Coulomb friction without smoothing: sliding, reversals located in time, sticking, breaking loose.

At a place that slides, the friction is Fc sign(v). At a place that rests it is what holds the place at rest,

    w* = -(V (A x + B u + E w_others)) / (V E_friction)     (V x = v, so that V x' = 0)

as long as |w*| <= Fc. While it rests the whole plant obeys x' = S (A x + B u + E w_others) with the projector
S = I - E_friction V / (V E_friction): linear again, so sticking costs no more than sliding.

Nothing here imports okid, era or modal.
"""

import numpy as np
import scipy

__all__ = ["holding_force", "resting", "through_reversals"]

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
