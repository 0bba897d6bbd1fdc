"""Records of random structures under eight kinds of noise, with their true modes; nothing here imports the product.

    x(k+1) = A x(k) + B u(k) + G w(k),   y(k) = C x(k) + D u(k) + v(k)

    white     v white on each sensor
    coloured  v autoregressive on each sensor, first or second order, its own colour each
    wind      w an independent white force on each state, beside a little white v
    force     w one white force through a column that nobody measured, direct part included, beside a little white v
    hidden    w one or two inputs as large as those that are measured, held back from the record
    loop      wind, and u = r - g F(z) y of the sample before: a controller that nobody can switch off
    output    wind alone, no input recorded
    input     v white, and the inputs recorded with white noise of their own

Every share of noise is drawn; the modes are 2 to 5, the inputs 1 to 3, the outputs 2 to 6. Process noise is started
long before the record. `system` fixes the structure, `record` the inputs and the noise.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from crb import CramerRaoBound, cramer_rao_bound
from scipy.signal import lfilter
from systems import TruthSystem, random_system

Kind = Literal["white", "coloured", "wind", "force", "hidden", "loop", "output", "input"]
KINDS: tuple[Kind, ...] = get_args(Kind)
SPIN_UP = 2000


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class NoiseRecord:
    """What was recorded, and the truth; the bound is known for white sensor noise only.

    `fed_back` is the size of what a controller adds to the first input, relative to what drives it from outside.
    """

    kind: Kind
    inputs: np.ndarray
    outputs: np.ndarray
    system: TruthSystem
    share: float
    bound: CramerRaoBound | None
    fed_back: float = 0.0


def noise_record(kind: Kind, *, system: int, record: int) -> NoiseRecord:
    """One record of one structure."""
    rng = np.random.default_rng((system, KINDS.index(kind), 16))
    n_inputs, n_outputs = int(rng.integers(1, 4)), int(rng.integers(2, 7))
    n_hidden = {"force": 1, "hidden": int(rng.integers(1, 3))}.get(kind, 0)
    whole = random_system(
        rng,
        n_modes=int(rng.integers(2, 6)),
        n_inputs=n_inputs + n_hidden,
        n_outputs=n_outputs,
        close_pair=rng.choice([None, 0.08]),
        weak_mode=None,
        damping_range=(0.005, 0.03),
    )
    share = float(rng.uniform(0.05, 0.3))
    n_samples = int(rng.integers(3000, 6001))
    poles = rng.uniform(0.5, 0.95, n_outputs), rng.uniform(0.2, 2.8, n_outputs)
    second = rng.random(n_outputs) < 0.5
    rng = np.random.default_rng((system, KINDS.index(kind), record, 17))
    n_total = SPIN_UP + n_samples
    u = rng.standard_normal((n_total, n_inputs))
    if rng.random() < 0.5:
        u = lfilter([1.0], [1.0, -0.6], u, axis=0)
    u[: SPIN_UP // 2] = 0.0
    measured = slice(0, n_inputs)
    system_ = whole if not n_hidden else _measured(whole, measured)
    clean = _run(system_, u)
    size = clean[SPIN_UP:].std(axis=0)
    v, w = np.zeros_like(clean), np.zeros((n_total, whole.order))
    bound = None
    if kind in ("white", "input"):
        v = (share if kind == "white" else 0.02) * size * rng.standard_normal(v.shape)
    if kind == "coloured":
        v = share * size * _coloured(rng, v.shape, *poles, second)
    if kind in ("wind", "loop", "output"):
        w = rng.standard_normal(w.shape) * np.repeat(rng.uniform(0.5, 1.5, whole.order // 2), 2)
        w *= share * size.mean() / _run(system_, np.zeros_like(u), w)[SPIN_UP:].std(axis=0).mean()
        v = 0.1 * share * size * rng.standard_normal(v.shape)
    if n_hidden:
        other = _measured(whole, slice(n_inputs, None))
        v = _run(other, rng.standard_normal((n_total, n_hidden)))
        wanted = share if kind == "force" else rng.uniform(0.7, 1.4)
        v = v * wanted * size.mean() / v[SPIN_UP:].std(axis=0).mean()
        v = v + 0.02 * size * rng.standard_normal(v.shape)
    if kind == "output":
        u = np.zeros_like(u)
    fed_back = 0.0
    if kind == "loop":
        reference = u[SPIN_UP:, 0]
        u, y = _closed(system_, u, w, v, gain=float(rng.uniform(0.5, 1.5)) / size.max())
        fed_back = float((u[SPIN_UP:, 0] - reference).std() / reference.std())
    else:
        y = _run(system_, u, w) + v
    seen = u[SPIN_UP:]
    if kind == "white":
        bound = cramer_rao_bound(
            system_, seen, initial_state=_states(system_, u)[SPIN_UP], noise_std=share * size, level="unknown"
        )
    if kind == "input":
        seen = seen + share * seen.std(axis=0) * rng.standard_normal(seen.shape)
    if kind == "output":
        seen = seen[:, :0]
    return NoiseRecord(
        kind=kind, inputs=seen, outputs=y[SPIN_UP:], system=system_, share=share, bound=bound, fed_back=fed_back
    )


def _measured(system: TruthSystem, inputs: slice) -> TruthSystem:
    return TruthSystem(
        A=system.A,
        B=system.B[:, inputs],
        C=system.C,
        D=system.D[:, inputs],
        dt=system.dt,
        hold=system.hold,
        poles=system.poles,
        shapes=system.shapes,
        participation=system.participation[inputs],
    )


def _states(system: TruthSystem, u: np.ndarray, w: np.ndarray | None = None) -> np.ndarray:
    drive = u @ system.B.T if w is None else u @ system.B.T + w
    states = np.zeros((len(u), system.order))
    for k in range(len(u) - 1):
        states[k + 1] = system.A @ states[k] + drive[k]
    return states


def _run(system: TruthSystem, u: np.ndarray, w: np.ndarray | None = None) -> np.ndarray:
    return _states(system, u, w) @ system.C.T + u @ system.D.T


def _coloured(rng: np.random.Generator, shape: tuple[int, int], size, angle, second) -> np.ndarray:
    """Unit standard deviation; a pair at this angle where `second`, else a real pole."""
    noise = rng.standard_normal(shape)
    for i in range(shape[1]):
        factors = [1.0, -2 * size[i] * np.cos(angle[i]), size[i] ** 2] if second[i] else [1.0, -size[i]]
        noise[:, i] = lfilter([1.0], factors, noise[:, i])
    return noise / noise[SPIN_UP:].std(axis=0)


def _closed(
    system: TruthSystem, r: np.ndarray, w: np.ndarray, v: np.ndarray, *, gain: float
) -> tuple[np.ndarray, np.ndarray]:
    """Inputs and outputs with u = r - g z, z+ = 0.7 z + 0.3 (first output), g halved until the loop is stable."""
    A, B, C, D = system.A, system.B, system.C, system.D
    n, g = system.order, gain * r[SPIN_UP:].std() / 0.5
    column = B[:, [0]]
    while True:
        loop = np.block([[A, -g * column], [0.3 * C[:1], np.array([[0.7 - 0.3 * g * D[0, 0]]])]])
        if np.abs(np.linalg.eigvals(loop)).max() < 1.0 - 1e-3:
            break
        g /= 2
    u, y, x, z = r.copy(), np.empty_like(v), np.zeros(n), 0.0
    for k in range(len(r)):
        u[k, 0] -= g * z
        y[k] = C @ x + D @ u[k] + v[k]
        x = A @ x + B @ u[k] + w[k]
        z = 0.7 * z + 0.3 * y[k, 0]
    return u, y
