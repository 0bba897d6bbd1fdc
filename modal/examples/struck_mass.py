"""A mass on a spring and damper, struck once and measured with noise: all of ERA on the smallest system.

The mass obeys m x'' + c x' + k x = F. A hammer pushes with 1 N for one tick of the clock; a sensor reads the position
at every tick, with noise. From those samples alone, without m, c and k, we want a model that answers the hammer as the
mass does, and with it the frequency and the damping. Wherever `samples` stands below, they are (2N + 1,) positions [m]
from the tick of the push on. Five steps lead there:

1. **Samples are a product.** For a push of one tick the samples are h(k) = C A^(k-1) B with the sampled matrices A, B,
   C of the mass, whatever coordinates its state is written in (`StruckMass.model`, `sampled_pulse`).
2. **The full-order model.** Write the samples into a Hankel matrix H(k), entry (i, j) = h(k + i + j). Moving on by one
   tick multiplies it by one matrix, so A = H(2) H(1)^-1, B = first column of H(1), C = first row of the identity is a
   model (`full_order_model`). With N rows and columns it has 2N unknowns and repeats 2N samples *exactly, noise
   included*. That is its fault: it is an autoregression of order N through every wrong digit, many of its poles grow in
   time, and beyond the 2N samples it explodes. A perfect fit proves nothing.
3. **The Pareto plot.** The singular values of H(1) show that two directions carry the motion and the other N - 2 carry
   noise (`singular_value_shares`). Three measures of "how much do the first n carry?" give three answers. The share in
   the *sum* of singular values looks poor (about 55 % for N = 100) and falls with the number of samples written into H:
   it is an artefact of N. The share of *energy* (squares) is about 98 %. The *gap*, the ratio of a singular value to
   the next one, is above 20 at n = 2 and near 1 from there on: decide on the gap.
4. **Truncated, then reduced.** Keep n directions: H(1) ~ Hr = U S V'. With Hr in place of H(1) the model still has N
   states (`truncated_model`); in the n coordinates that matter it has n (`reduced_model`): that is ERA. Nothing should
   have changed between the two, and *exactly* nothing has, provided that the truncated A carries the projector U U' on
   its left, for Hr Hr^+ = U U' is not the identity. Without it the two differ by some tenths of a percent.
5. **Compare** pulse and step responses with the noise-free truth (`study`). Two states answer within one or two
   percent, less than the noise of 2.7 %; the full-order model passes through every noisy sample and is useless.

The packages do steps 3 and 4 for any number of inputs and outputs, and judge what they find (`by_the_packages`).

Run `python -m modal.examples.struck_mass [-o DIR]` for the figures and, in a folder, the pictures.

References:
    Juang and Pappa, "An eigensystem realization algorithm for modal parameter identification and model reduction",
    Journal of Guidance, Control, and Dynamics 8(5), 1985, doi 10.2514/3.20031.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from era.balanced import realise
from modal.examples.story import command_line, print_written
from modal.modes.extraction import extract_modes
from modal.modes.mode import ModalModel
from modal.plots.chart import Chart, Key, grid_of, one_panel, page_of, svg_text
from modal.plots.panels import Role
from okid.arrays import FloatArray, frozen
from okid.errors import InsufficientDataError
from okid.markov import MarkovParameters


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LinearModel:
    """x(k+1) = A x(k) + B u(k), y(k) = C x(k) + D u(k), with one input and one output.

    Attributes:
        A: (order, order).
        B: (order,).
        C: (order,).
        D: feedthrough.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: float

    def __post_init__(self) -> None:
        for name in ("A", "B", "C"):
            object.__setattr__(self, name, frozen(getattr(self, name), name=name))

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.A)


def sampled_pulse(model: LinearModel, n_samples: int) -> FloatArray:
    """(n_samples,) answer to a push of one unit for one tick: D, C B, C A B, ..."""
    response, state = np.empty(n_samples), model.B
    response[0] = model.D
    for k in range(1, n_samples):
        response[k] = model.C @ state
        state = model.A @ state
    return response


def step_response(model: LinearModel, n_samples: int) -> FloatArray:
    """(n_samples,) answer to a push that stays: the running sum of the pulse response."""
    return np.asarray(np.cumsum(sampled_pulse(model, n_samples)))


def hankel(samples: FloatArray, first: int) -> FloatArray:
    """H(first), entry (i, j) = samples[first + i + j], square, as large as 2N + 1 samples allow for first = 1 and 2.

    Raises:
        InsufficientDataError: fewer than five samples.

    Example:
        >>> hankel(np.arange(5.0), 1)
        array([[1., 2.], [2., 3.]])
    """
    size = (len(samples) - 1) // 2
    if size < 2:
        raise InsufficientDataError(
            f"a Hankel matrix needs 5 samples or more, but there are {len(samples)}; record more."
        )
    entries: FloatArray = samples[first + np.add.outer(np.arange(size), np.arange(size))]
    return entries


def full_order_model(samples: FloatArray) -> LinearModel:
    """A = H(2) H(1)^-1, B = H(1) e1, C = e1': repeats every sample that it was made from, noise and all."""
    first, second = hankel(samples, 1), hankel(samples, 2)
    A = np.linalg.solve(first.T, second.T).T.astype(np.float64)
    return LinearModel(A=A, B=first[:, 0], C=np.eye(len(first))[0], D=float(samples[0]))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SingularValueShares:
    """The Pareto plot of the Hankel matrix, by three measures.

    Attributes:
        singular_values: (N,) of H(1), falling.
        sum_share: (N,) share that the first 1, 2, ... N have in the sum of all; an artefact of N.
        energy_share: (N,) the same of their squares.
        gap: (N - 1,) ratio of each to the next one; the order is where it is largest.
    """

    singular_values: FloatArray
    sum_share: FloatArray
    energy_share: FloatArray
    gap: FloatArray

    def __post_init__(self) -> None:
        for name in ("singular_values", "sum_share", "energy_share", "gap"):
            object.__setattr__(self, name, frozen(getattr(self, name), name=name))

    @property
    def order(self) -> int:
        """Where the gap is largest."""
        return int(np.argmax(self.gap)) + 1


def singular_value_shares(samples: FloatArray) -> SingularValueShares:
    """How much the first n directions of the Hankel matrix carry, for every n."""
    values = np.linalg.svd(hankel(samples, 1), compute_uv=False).astype(np.float64)
    floor = np.maximum(values, np.finfo(float).eps * values[0])  # exact data: the gap is taken to rounding
    return SingularValueShares(
        singular_values=values,
        sum_share=np.cumsum(values) / values.sum(),
        energy_share=np.cumsum(values**2) / (values**2).sum(),
        gap=floor[:-1] / floor[1:],
    )


def truncated_model(samples: FloatArray, order: int, *, projector: Literal["left", "none"] = "left") -> LinearModel:
    """N states, but a Hankel matrix of which only `order` directions are kept: A = U U' H(2) Hr^+, B = Hr e1, C = e1'.

    Args:
        samples: (2N + 1,) pulse response from the tick of the push on.
        order: directions kept.
        projector: "left" carries U U' in A and equals the reduced model exactly; "none" leaves it out, to show that
            it is needed.
    """
    U, values, Vt = np.linalg.svd(hankel(samples, 1))
    U, values, Vt = U[:, :order], values[:order], Vt[:order]
    A = hankel(samples, 2) @ (Vt.T / values) @ U.T
    if projector == "left":
        A = U @ (U.T @ A)
    return LinearModel(A=A, B=(U * values) @ Vt[:, 0], C=np.eye(len(A))[0], D=float(samples[0]))


def reduced_model(samples: FloatArray, order: int) -> LinearModel:
    """ERA: A = S^-1/2 U' H(2) V S^-1/2, B = S^1/2 V' e1, C = e1' U S^1/2, with `order` states."""
    U, values, Vt = np.linalg.svd(hankel(samples, 1))
    root = np.sqrt(values[:order])
    U, Vt = U[:, :order], Vt[:order]
    A = (U / root).T @ hankel(samples, 2) @ (Vt.T / root)
    return LinearModel(A=A, B=root * Vt[:, 0], C=U[0] * root, D=float(samples[0]))


def frequency_and_damping(model: LinearModel, dt: float) -> tuple[float, float]:
    """Frequency [Hz] and damping ratio of a model with one oscillating mode, from its poles s = ln(lambda) / dt.

    Args:
        model: with two states.
        dt: time between samples [s].

    Example:
        >>> A = np.array([[0.0, -0.25], [1.0, 0.0]])  # halves the state with every quarter turn
        >>> turn = LinearModel(A=A, B=np.array([1.0, 0.0]), C=np.array([1.0, 0.0]), D=0.0)
        >>> frequency, damping_ratio = frequency_and_damping(turn, dt=1.0)
        >>> f"{frequency:.4f} Hz, {damping_ratio:.3f}"
        '0.2733 Hz, 0.404'
    """
    discrete = np.linalg.eigvals(model.A).astype(complex)
    pole = np.log(discrete[np.argmax(discrete.imag)]) / dt
    return float(abs(pole) / (2 * np.pi)), float(-pole.real / abs(pole))


WIDE = (10, 3.6)
"""Draw two charts side by side at this width and height [inch]."""


def draw_full_order(short: "Study", *, n_beyond: int = 20) -> Chart:
    """Why a perfect fit proves nothing: the full-order model on its own samples, and just beyond them."""
    n_fitted = len(short.samples)
    figure = grid_of(1, 2, size=WIDE)
    inside, beyond = figure.panels
    tick = short.truth.dt * np.arange(n_fitted + n_beyond)
    clean = sampled_pulse(short.truth.model(), len(tick))
    full, reduced = sampled_pulse(short.full, len(tick)), sampled_pulse(short.reduced, len(tick))
    for panel, shown in ((inside, n_fitted), (beyond, len(tick))):
        panel.line(tick[:shown], clean[:shown], "noise", label="truth, no noise")
        panel.dots(tick[:n_fitted], short.samples, "measured", dot=5.0, label="measured")
        panel.line(tick[:shown], full[:shown], "residual", label=f"full order, {short.full.order} states")
        label = f"reduced, {short.reduced.order} states"
        panel.line(tick[:shown], reduced[:shown], "model", dash="dashed", label=label)
        panel.x.label, panel.y.label = "time [s]", "position [m]"
    span = float(np.abs(clean).max())
    inside.head, beyond.head = "the samples that were fitted", "beyond them"
    beyond.y.limits = (-2 * span, 2 * span)
    beyond.upright(tick[n_fitted - 1], "muted", dash="dotted")
    figure.key = Key(panel=inside)
    return figure


def draw_pareto(result: "Study") -> Chart:
    """Singular values with their share in the sum, their share in the energy, and the gap."""
    shares = result.shares
    number = np.arange(1.0, len(shares.singular_values) + 1.0)
    figure = grid_of(1, 2, size=WIDE)
    left, right = figure.panels
    left.polygons(
        _bars(number, shares.singular_values / shares.singular_values[0]), "noise", opacity=1, label="singular value"
    )
    left.line(number, shares.sum_share, "residual", label="share of the sum")
    left.line(number, shares.energy_share, "system", label="share of the energy")
    left.upright(shares.order, "muted", dash="dotted")
    left.x.label, left.y.label = "number of singular values", "relative to the largest, share"
    left.y.limits = (0.0, 1.05)
    left.head = (
        f"the first {shares.order}: {shares.sum_share[shares.order - 1]:.0%} of the sum, "
        f"{shares.energy_share[shares.order - 1]:.1%} of the energy"
    )
    left.key = "best"
    shown = min(20, len(shares.gap))
    for i in range(shown):
        role: Role = "system" if i + 1 == shares.order else "noise"
        right.polygons(_bars(number[i : i + 1], shares.gap[i : i + 1]), role, opacity=1)
    right.x.label, right.y.label = "number of singular values", "ratio to the next"
    right.head = f"the gap says {shares.order} (first {shown})"
    return figure


def draw_reduction(result: "Study") -> Chart:
    """Truncated against reduced: equal to rounding with the left projector, not without it."""
    order, n_samples = result.reduced.order, len(result.samples)
    reduced = sampled_pulse(result.reduced, n_samples)
    models: tuple[tuple[str, LinearModel, Role], ...] = (
        ("A = U U' H(2) Hr^+  (with the projector)", result.truncated, "system"),
        ("A = H(2) Hr^+  (without)", truncated_model(result.samples, order, projector="none"), "residual"),
    )
    figure, panel = one_panel(7, 3.6)
    tick = result.truth.dt * np.arange(n_samples)
    for label, model, role in models:
        difference = np.abs(sampled_pulse(model, n_samples) - reduced) / np.abs(reduced).max()
        panel.line(tick, np.maximum(difference, 1e-18), role, label=label)
    panel.y.log, panel.x.label, panel.y.label = True, "time [s]", "difference, relative to the peak"
    panel.head = "N states less n states: nothing changed"
    figure.key = Key(panel=panel)
    return figure


def draw_responses(result: "Study") -> Chart:
    """Pulse and step response: truth, measurement, reduced model."""
    n_samples = len(result.samples)
    tick = result.truth.dt * np.arange(n_samples)
    figure = grid_of(1, 2, size=WIDE)
    pulse, step = figure.panels
    for panel, answer, measured in (
        (pulse, sampled_pulse, result.samples),
        (step, step_response, np.cumsum(result.samples)),
    ):
        panel.dots(tick, measured, "measured", dot=2.5, label="measured")
        panel.line(tick, answer(result.truth.model(), n_samples), "noise", width=2.5, label="truth, no noise")
        label = f"reduced, {result.reduced.order} states"
        panel.line(tick, answer(result.reduced, n_samples), "model", dash="dashed", label=label)
        panel.x.label, panel.y.label = "time [s]", "position [m]"
    pulse.head = f"pulse response: error {result.pulse_error:.1%}"
    step.head = f"step response: error {result.step_error:.1%} (noise of sums grows)"
    figure.key = Key(panel=pulse)
    return figure


def _bars(place: FloatArray, height: FloatArray) -> list[FloatArray]:
    """A rectangle from zero up at each of (n,) places."""
    return [
        np.array([[x - 0.4, 0.0], [x + 0.4, 0.0], [x + 0.4, y], [x - 0.4, y]])
        for x, y in zip(place.tolist(), height.tolist(), strict=True)
    ]


def write_pictures(short: "Study", result: "Study", folder: Path) -> tuple[Path, ...]:
    """Draw all four pictures as SVG files, and return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, figure in (
        ("1-full-order", draw_full_order(short)),
        ("2-pareto", draw_pareto(result)),
        ("3-truncated-reduced", draw_reduction(result)),
        ("4-responses", draw_responses(result)),
    ):
        paths.append(folder / f"{name}.svg")
        paths[-1].write_text(page_of(svg_text(figure, name=name, description=name)), encoding="utf-8")
    return tuple(paths)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StruckMass:
    """The truth: a mass on a spring and damper, and the clock that it is watched with.

    Attributes:
        mass: [kg].
        damping: [N s/m].
        stiffness: [N/m].
        dt: time between samples [s].
    """

    mass: float = 1.0
    damping: float = 0.4
    stiffness: float = 4.0
    dt: float = 0.1

    @property
    def angular_frequency(self) -> float:
        """Undamped, sqrt(k / m) [rad/s]."""
        return float(np.sqrt(self.stiffness / self.mass))

    @property
    def frequency(self) -> float:
        """Undamped [Hz]."""
        return self.angular_frequency / (2 * np.pi)

    @property
    def damping_ratio(self) -> float:
        """Damping over critical damping, c / (2 sqrt(k m))."""
        return float(self.damping / (2 * np.sqrt(self.stiffness * self.mass)))

    def model(self) -> LinearModel:
        """Sampled exactly, the force held for one tick: the closed form of expm([[A, B], [0, 0]] dt).

        Example:
            >>> truth = StruckMass()
            >>> frequency, damping_ratio = frequency_and_damping(truth.model(), truth.dt)
            >>> f"{frequency:.5f} Hz, {damping_ratio:.3f}"
            '0.31831 Hz, 0.100'
        """
        natural, decay = self.angular_frequency, self.damping_ratio * self.angular_frequency
        damped = natural * np.sqrt(1 - self.damping_ratio**2)
        shrink, cosine, sine = np.exp(-decay * self.dt), np.cos(damped * self.dt), np.sin(damped * self.dt) / damped
        A = shrink * np.array([[cosine + decay * sine, sine], [-(natural**2) * sine, cosine - decay * sine]])
        B = np.array([(1 - shrink * (cosine + decay * sine)) / self.stiffness, shrink * sine / self.mass])
        return LinearModel(A=A, B=B, C=np.array([1.0, 0.0]), D=0.0)


def measured_samples(truth: StruckMass, n_samples: int, *, noise: float, rng: np.random.Generator) -> FloatArray:
    """(n_samples,) positions after the blow with white noise [m]."""
    clean = sampled_pulse(truth.model(), n_samples)
    size = noise * float(np.abs(clean).max())
    return clean + size * rng.standard_normal(n_samples)


def by_the_packages(truth: StruckMass, samples: FloatArray) -> ModalModel:
    """The same result in the words of the packages: samples after a blow are Markov parameters already.

    Example:
        >>> truth = StruckMass()
        >>> samples = measured_samples(truth, 201, noise=0.0, rng=np.random.default_rng(0))
        >>> [(round(mode.frequency, 5), round(mode.damping_ratio, 3)) for mode in by_the_packages(truth, samples)]
        [(0.31831, 0.1)]
    """
    return extract_modes(realise(MarkovParameters(system=samples[:, np.newaxis, np.newaxis], dt=truth.dt)))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Study:
    """Everything that the five steps give for one measurement.

    Attributes:
        truth: the mass.
        samples: (2N + 1,) as measured [m].
        shares: the Pareto plot.
        full: full-order model, N states.
        truncated: `shares.order` directions, N states.
        reduced: `shares.order` states.
        unstable_poles: how many poles of the full-order model grow in time.
        frequency: of the reduced model [Hz].
        damping_ratio: of the reduced model.
        pulse_error: of the reduced model, norm of the difference from the noise-free pulse response over its norm.
        step_error: the same of the step response.
    """

    truth: StruckMass
    samples: FloatArray
    shares: SingularValueShares
    full: LinearModel
    truncated: LinearModel
    reduced: LinearModel
    unstable_poles: int
    frequency: float
    damping_ratio: float
    pulse_error: float
    step_error: float


def study(truth: StruckMass, samples: FloatArray, *, order: int = 2) -> Study:
    """All five steps on the samples of one blow."""
    full, reduced = full_order_model(samples), reduced_model(samples, order)
    clean = truth.model()
    frequency, damping_ratio = frequency_and_damping(reduced, truth.dt)
    errors = []
    for response in (sampled_pulse, step_response):
        wanted = response(clean, len(samples))
        errors.append(float(np.linalg.norm(response(reduced, len(samples)) - wanted) / np.linalg.norm(wanted)))
    return Study(
        truth=truth,
        samples=frozen(samples, name="samples"),
        shares=singular_value_shares(samples),
        full=full,
        truncated=truncated_model(samples, order),
        reduced=reduced,
        unstable_poles=int((np.abs(np.linalg.eigvals(full.A)) > 1).sum()),
        frequency=frequency,
        damping_ratio=damping_ratio,
        pulse_error=errors[0],
        step_error=errors[1],
    )


def summary(result: Study) -> str:
    """The figures of one study in words."""
    n, shares, truth = result.shares.order, result.shares, result.truth
    return f"""N = {len(shares.singular_values)}, {len(result.samples)} samples:
  full-order model: {result.full.order} states, {result.unstable_poles} unstable poles
  first {n} directions: {shares.sum_share[n - 1]:.1%} of the sum, {shares.energy_share[n - 1]:.1%} of the energy, \
gap {shares.gap[n - 1]:.0f}
  reduced model: {result.frequency:.4f} Hz (true {truth.frequency:.4f}), \
damping ratio {result.damping_ratio:.4f} (true {truth.damping_ratio:.4f})
  error of its responses: pulse {result.pulse_error:.1%}, step {result.step_error:.1%}"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Study blows of four lengths, print the figures, write the pictures into a folder."""
    what = "A mass on a spring, struck once: what model is in the samples?"
    given = command_line(what, arguments, written="the pictures", seed=1985)
    truth = StruckMass()
    studies = []
    for size in (10, 25, 50, 100):
        samples = measured_samples(truth, 2 * size + 1, noise=0.027, rng=np.random.default_rng(given.seed))
        studies.append(study(truth, samples))
        print(summary(studies[-1]))
    if given.output is not None:
        print_written(lambda: write_pictures(studies[0], studies[-1], given.output))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
