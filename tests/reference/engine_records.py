"""Records of structures with one more force, by the classical Runge-Kutta rule; of the product only containers."""

import numpy as np
from systems import chain_matrices

from modal.structure.structural_model import StructuralModel
from okid.record import Record

DT = 0.02
NOISE = 0.01
"""Noise as a share of the outputs of the quietest record."""


def held_noise(n_samples, n_inputs, seed):
    """Held noise below 5 Hz of standard deviation 1."""
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((n_samples + 40, n_inputs))
    window = np.hanning(7)
    slow = np.stack([np.convolve(column, window, mode="same") for column in noise.T], axis=1)[20:-20]
    return slow / slow.std()


def run(masses, stiffnesses, dampings, inputs, *, law=None, element=0, n_steps=6, dt=DT):
    """(n_samples, n_dofs) displacements under inputs held on the first DOFs; `law(d, v, t)` acts in one element."""
    if len(masses) == 1:
        return _run_one(masses[0], stiffnesses[0], dampings[0], inputs, law, n_steps=n_steps, h=dt / n_steps, dt=dt)
    _, damping, stiffness = chain_matrices(masses, stiffnesses, dampings)
    n_dofs = len(masses)
    per_mass = 1.0 / np.asarray(masses, dtype=float)
    direction = np.zeros(n_dofs)
    direction[element] = 1.0
    if element:
        direction[element - 1] = -1.0
    states = np.block(
        [[np.zeros((n_dofs, n_dofs)), np.eye(n_dofs)], [-per_mass[:, None] * np.hstack([stiffness, damping])]]
    )
    own = np.kron(np.eye(2), direction)  # displacement and velocity of the element
    pull = np.r_[np.zeros(n_dofs), per_mass * direction]
    push = np.zeros((len(inputs), 2 * n_dofs))
    push[:, n_dofs : n_dofs + inputs.shape[1]] = inputs * per_mass[: inputs.shape[1]]
    x, h, found = np.zeros(2 * n_dofs), dt / n_steps, np.empty((len(inputs), n_dofs))

    def slope(s, force, t):
        alone = states @ s + force
        return alone if law is None else alone - law(*(own @ s), t) * pull

    for k, force in enumerate(push):
        found[k] = x[:n_dofs]
        for i in range(n_steps):
            t = k * dt + i * h
            a = slope(x, force, t)
            b = slope(x + 0.5 * h * a, force, t + 0.5 * h)
            c = slope(x + 0.5 * h * b, force, t + 0.5 * h)
            d = slope(x + h * c, force, t + h)
            x = x + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
    return found


def _run_one(mass, stiffness, damping, inputs, law, *, n_steps, h, dt):
    """The same in plain numbers, a tenth of the time; to the last bit what one degree of freedom in arrays gives."""
    mass, stiffness, damping = float(mass), float(stiffness), float(damping)
    d, v, found = 0.0, 0.0, np.empty((len(inputs), 1))

    def acceleration(d, v, force, t):
        extra = 0.0 if law is None else float(law(d, v, t))
        return (force - stiffness * d - damping * v - extra) / mass

    for k, (force, *_) in enumerate(inputs.tolist()):
        found[k] = d
        for i in range(n_steps):
            t = k * dt + i * h
            v1, a1 = v, acceleration(d, v, force, t)
            v2 = v + 0.5 * h * a1
            a2 = acceleration(d + 0.5 * h * v1, v2, force, t + 0.5 * h)
            v3 = v + 0.5 * h * a2
            a3 = acceleration(d + 0.5 * h * v2, v3, force, t + 0.5 * h)
            v4 = v + h * a3
            a4 = acceleration(d + h * v3, v4, force, t + h)
            d = d + h / 6.0 * (v1 + 2.0 * v2 + 2.0 * v3 + v4)
            v = v + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
    return found


def experiment(
    law=None,
    *,
    element=0,
    levels=(1.0, 3.0, 2.0),
    n_samples=500,
    seed=1,
    masses=(1.0,),
    stiffnesses=(100.0,),
    dampings=(0.6,),
    n_inputs=1,
    noise=NOISE,
    missing=0.0,
):
    """Records of these levels, the last one held out; all displacements are measured, with noise of one size."""
    rng = np.random.default_rng(seed)
    masses = np.array(masses)
    clean, inputs = [], []
    for i, level in enumerate(levels):
        u = level * held_noise(n_samples, n_inputs, 100 * seed + i)
        inputs.append(u)
        clean.append(run(masses, stiffnesses, dampings, u, law=law, element=element))
    size = noise * min(one.std() for one in clean)
    found = []
    for i, (u, y) in enumerate(zip(inputs, clean, strict=True)):
        measured = y + size * rng.standard_normal(y.shape)
        measured[rng.random(y.shape) < missing] = np.nan
        found.append(Record(u, measured, DT, input_hold="zero_order", name=f"level {levels[i]:g}"))
    return found[:-1], found[-1:], size**2


def nominal(*, masses=(1.0,), stiffnesses=(103.0,), dampings=(0.7,), n_inputs=1):
    """A chain with slightly wrong stiffness and damping."""
    return StructuralModel.chain(
        masses, stiffnesses, dampings, force_dofs=list(range(n_inputs)), sensor_dofs=list(range(len(masses)))
    )
