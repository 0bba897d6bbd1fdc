"""Forces within the structure that follow the square and cube of a deformation, against modes side by side.

A spring that hardens is a feedback: it drives the structure at its own place with a power of its own deformation. After
few blows a linear model follows that with poles side by side, each near a sum of three of the structure's, and fits the
record as closely as one likes. So a model with fewer modes competes by Schwarz's criterion, which the square and cube
of one deformation drive besides, a sum of the principal motions q that the linear model describes:

    y = sum over modes of shape (start + inner participation [g^2, g^3] / (s - pole)),    g = b'q

with q as measured, once or twice integrated, or differentiated: springs follow displacements, drag follows velocities,
and which of these a sensor shows is not asked. After each blow nothing else drives, so both descriptions have a start
of their own there, and what a force's sensor missed counts for neither. Powers of a motion are faster than it: q is
known between samples, and g is integrated there. Poles and b are found with all sizes projected out; then each mode has
one shape.

Noise that follows the structure, such as wind, lets what has many numbers gain more than white noise does. They count
as much as the spectrum of what the linear model leaves makes of them.

References:
    Adams, Allemang, A frequency domain method for estimating the parameters of a non-linear structural dynamic model
    through feedback, Mech. Syst. Signal Process. 14(4), 2000; Marchesiello, Garibaldi, A time domain approach for
    identifying nonlinear vibrating structures by subspace methods, Mech. Syst. Signal Process. 22(1), 2008; Kaufman, A
    variable projection method for solving separable nonlinear least squares problems, BIT 15, 1975; Schwarz, Annals of
    Statistics 6, 1978, https://doi.org/10.1214/aos/1176344136.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement, product

import numpy as np
import scipy

from era.state_recursion import PoleRecursion
from modal.modes.mode import ModalModel, Mode
from modal.preparation.kind import acting_rows
from modal.verdict.constancy import DIGITS, after_blows
from modal.verdict.judgement import Answer, doubted
from modal.verdict.oscillator import FEWEST, HEAVIEST
from modal.wording.text import NINETY_FIVE, NONLINEAR, counted, hertz, listed, percent
from okid.arrays import TINY, BoolArray, ComplexArray, FloatArray
from okid.record import Record

MOTIONS = 3
"""Look for the deformation among so many principal motions,"""
INTEGRATED = (1, 0, 2, -1)
"""that are integrated so often."""
STARTS = 2
"""Begin from so many of the directions whose components are -1, 0 and 1."""
FEWEST_MODES, MOST_MODES = 2, 8
"""Try no fewer modes, for of one the oscillator competes (`modal.verdict.ring_down`), and no more."""
BLOWS, MOST_ROWS, LONGEST = 8, 3000, 10_000
"""Ask what follows so many of the loudest blows, in so many rows, among the first so many of them together."""
A_CYCLE = 12
"""Know the products at so many points in a cycle of the fastest mode at least."""
STEPS, ENOUGH = 12, 1e-3
"""Move the poles so often, or until what is left falls by less than this share;"""
HALVINGS = 5
"""halve a step so often."""
RIDGE = 1e-3
"""Begin with what columns of size 1 tell that are no closer to others than this."""
TURNS = 30
"""Ask so often what shapes and participations leave."""
EVIDENCE = 10.0
"""Believe in inner forces, or in the oscillator, where the criterion falls by so much: odds of 150 to 1."""
FURTHEST = 2.0
"""Let no pole go further than so many times the decay rate from where the linear model has it."""
LEAST_DECAY = 0.05
"""Let no step leave less than this share of a decay rate."""
EXPLAINED = 1e-10
"""Take what is this share of the largest for explained already."""
NUDGE = 1e-5
"""Nudge a pole by this of its decay rate for a difference."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class InnerForces:
    """A few modes with inner forces that explain records better than the linear model does.

    Attributes:
        poles: (n_modes,) of small motions [rad/s].
        share: rms of the answer to inner forces over that of the output, where it is largest.
        n_linear: poles that the linear model has for it.
    """

    poles: ComplexArray
    share: float
    n_linear: int

    @property
    def sentence(self) -> str:
        """What was found, and what to do."""
        n_modes = len(self.poles)
        modes = f"{counted(n_modes)} mode{'s' * (n_modes > 1)}"
        rings = listed(
            [
                f"{hertz(abs(pole) / (2 * np.pi))} Hz ({percent(-pole.real / abs(pole))} damping)"
                for pole in self.ordered
            ]
        )
        size = f" That force makes {percent(self.share)} of an output." if self.share < 1.0 else ""
        return (
            f"{NONLINEAR}: {modes} with an inner force, a square and cube of the motion, explain what rings down "
            f"better than the {self.n_linear} poles of the linear model do.{size} At small motion they ring at "
            f"{rings}; what lies beside is no mode. `modal-report gap` names the effect."
        )

    @property
    def ordered(self) -> list[complex]:
        """Poles by their frequency."""
        return sorted(self.poles.tolist(), key=abs)


def told_of_inner_forces(modes: ModalModel, found: InnerForces) -> Answer:
    """The nearest mode to each pole of small motion, less sure by their distance, and doubts of all others."""
    poles, told = np.array([mode.pole for mode in modes.modes]), list(modes.modes)
    turning = np.array([mode.kind == "oscillatory" for mode in modes.modes], dtype=np.bool_)
    kept = {}
    for pole in found.ordered:
        apart = np.where(turning, np.abs(poles - pole), np.inf)
        if apart.min() < -pole.real:  # within its half-power band
            kept[int(apart.argmin())] = pole
    for i, mode in enumerate(modes.modes):
        if i not in kept:
            told[i] = doubted(mode, f"{len(found.poles)} modes with an inner force explain what rings down without it")
            continue
        off = (abs(mode.pole) - abs(kept[i])) / (2 * np.pi), mode.damping_ratio + kept[i].real / abs(kept[i])
        told[i] = replace(
            mode,
            frequency_std=float(np.hypot(mode.frequency_std, off[0] / NINETY_FIVE)),
            damping_ratio_std=float(np.hypot(mode.damping_ratio_std, off[1] / NINETY_FIVE)),
        )
    return Answer(modes=replace(modes, modes=tuple(told)), warnings=(found.sentence,))


def inner_forces_of(modes: ModalModel, records: Sequence[Record]) -> InnerForces | None:
    """The modes and inner forces that explain free motion with fewer numbers, or more closely, than a linear model.

    Args:
        modes: of the linear model, all of them.
        records: with blows, nan where a sample was not measured.
    """
    turning = [mode for mode in modes.modes if mode.kind == "oscillatory" and 0.0 < mode.damping_ratio < HEAVIEST]
    asked = _Asked.of(modes.modes, records) if turning and records[0].n_inputs else None
    if asked is None:
        return None
    # a linear model may have poles that pay for nothing: some of them compete, too
    linear = min(asked.linear, *_alone(asked, turning))
    poles, rest = _order(asked, turning)
    able = np.flatnonzero(rest < linear - EVIDENCE) + 1
    able = able[able >= FEWEST_MODES]
    roads = [asked.motions(often) for often in INTEGRATED] if len(able) else []
    certain = {mode.pole for mode in turning if mode.verdict == "system"}
    best: _Description | None = None
    for n_modes in able.tolist():
        if best is not None and poles[n_modes - 1] not in certain:  # what is left may be no mode
            break
        fits = sorted((_fitted_near(asked, road, poles[:n_modes]) for road in roads), key=lambda one: one.power)
        least = (linear if best is None else best.criterion) - EVIDENCE
        told = [one for fit in fits if (one := _told(asked, fit, least=least)) is not None]
        if not told and best is not None:
            break
        best = min(told, key=lambda one: one.criterion, default=None)
        # half of the motions go on, or the one that has won
        roads = [fit.motions for fit in fits[: -(-len(fits) // 2)]] if best is None else [best.trial.motions]
    while best is not None and len(best.trial.poles) > FEWEST_MODES:
        fewer = [
            _told(asked, _without(asked, best.trial, i), least=best.criterion) for i in range(len(best.trial.poles))
        ]
        likelier = [one for one in fewer if one is not None]
        if not likelier:
            break
        best = min(likelier, key=lambda one: one.criterion)
    if best is None:
        return None
    # so few modes may need no inner forces where their poles are free
    alone = _fitted(asked, _Trial.of(asked, best.trial.motions, best.trial.poles, np.zeros(0)))
    if _told(asked, alone, least=best.criterion + EVIDENCE) is not None:
        return None
    return InnerForces(poles=best.trial.poles, share=best.share, n_linear=len(turning))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Asked:
    """What is described: motion after blows.

    Attributes:
        states: (n_modes, n_fine) after each blow, of the linear model, between samples as well.
        modes: whose states these are.
        fine: points a sample.
        rows: which are asked, of each.
        seen: (n_rows, n_outputs) of all together, in what the linear model leaves, rms.
        spectrum: (n_rows // 2 + 1, n_outputs) of what it leaves, its mean 1.
        linear: Schwarz's criterion of the linear model, whose misfit is 0.
        size: (n_outputs,) what the outputs were divided by: so much the linear model leaves, and rounding.
        digits: (n_outputs,) share of its square that is rounding.
        dt: time step [s].
    """

    states: list[ComplexArray]
    modes: tuple[Mode, ...]
    fine: int
    rows: list[BoolArray]
    seen: FloatArray
    spectrum: FloatArray
    linear: float
    size: FloatArray
    digits: FloatArray
    dt: float

    @classmethod
    def of(cls, modes: tuple[Mode, ...], records: Sequence[Record]) -> "_Asked | None":
        """None where nothing moves freely for long enough."""
        dt, n_states = records[0].dt, sum(1 + (mode.kind == "oscillatory") for mode in modes)
        after = [
            part.outputs
            for record, acting in zip(records, acting_rows(records), strict=True)
            for part in after_blows(record, record.outputs, acting, least=max(FEWEST, 2 * n_states))
        ]
        after = sorted(after, key=lambda own: -float(np.nanmax(np.abs(own))))[:BLOWS]
        if not after:
            return None
        after = [own[: LONGEST // len(after)] for own in after]
        whole = [np.isfinite(own).all(axis=1) for own in after]
        if not any(own.any() for own in whole):
            return None
        each = max(1, -(-sum(int(own.sum()) for own in whole) // MOST_ROWS))
        rows = [own & (np.cumsum(own) % each == 0) for own in whole]
        free = [_free_motion(modes, own, there, dt) for own, there in zip(after, rows, strict=True)]
        starts, levels, left = zip(*free, strict=True)
        seen = np.vstack([own[there] - level for own, there, level in zip(after, rows, levels, strict=True)])
        errors = np.vstack(left)
        digits = np.square(DIGITS * np.abs(seen).max(axis=0))
        size: FloatArray = np.sqrt(np.mean(errors**2, axis=0) + digits)
        if not np.all(size > 0.0):
            return None
        fine = max(1, int(np.ceil(A_CYCLE * max(abs(mode.pole.imag) for mode in modes) * dt / (2 * np.pi))))
        poles = np.array([mode.pole for mode in modes])[:, np.newaxis]
        power = np.abs(np.fft.rfft(errors / size, axis=0)) ** 2
        return cls(
            states=[
                start[:, np.newaxis] * np.exp(poles * dt / fine * np.arange(fine * len(own)))
                for start, own in zip(starts, after, strict=True)
            ],
            modes=modes,
            fine=fine,
            rows=rows,
            seen=seen / size,
            spectrum=power / np.maximum(power.mean(axis=0), TINY),
            linear=float(n_states * (seen.shape[1] + len(after)) * np.log(seen.size)),
            size=size,
            digits=digits / size**2,
            dt=dt,
        )

    def misfit(self, power: FloatArray) -> float:
        """-2 ln L, but for a constant, of what is left (n_outputs,) in all rows together."""
        return float(len(self.seen) * np.log(np.maximum(power, 0.0) / len(self.seen) + self.digits).sum())

    def n_numbers(self, n_modes: int) -> int:
        """Of so many modes with inner forces."""
        n_outputs = self.seen.shape[1]
        return 2 * n_modes * (n_outputs + len(self.states) + 2) + min(MOTIONS, n_outputs) - 1

    def price(self, n_numbers: int, basis: FloatArray) -> float:
        """Of so many numbers; more where noise lies along the basis of their answers."""
        along = np.abs(np.fft.rfft(basis, axis=0)) ** 2
        louder = float(((along / along.sum(axis=0)).mean(axis=1) @ self.spectrum).max())
        return n_numbers * max(1.0, louder) * float(np.log(self.seen.size))

    def motions(self, often: int) -> list[FloatArray]:
        """(n_fine, n_motions) a record, principal motions integrated so often, each of size 1 at most."""
        shapes = np.array([mode.shape * (mode.pole**-often if mode.pole else 0.0) for mode in self.modes])
        motions = [(own.T @ (shapes / self.size * self.weights[:, np.newaxis])).real for own in self.states]
        axes = np.linalg.eigh(sum(own.T @ own for own in motions))[1][:, -MOTIONS:]
        turned = [own @ axes for own in motions]
        largest = np.max([np.abs(own).max(axis=0) for own in turned], axis=0)
        return [own / np.maximum(largest, TINY) for own in turned]

    @property
    def weights(self) -> FloatArray:
        """(n_modes,) 2 of a pair, which is written once."""
        return np.array([2.0 if mode.kind == "oscillatory" else 1.0 for mode in self.modes])


def _free_motion(
    modes: Sequence[Mode], outputs: FloatArray, there: BoolArray, dt: float
) -> tuple[ComplexArray, FloatArray, FloatArray]:
    """The state (n_modes,) from which modes leave least of these rows, the level (n_outputs,), and what is left."""
    times, n = dt * np.flatnonzero(there), len(modes)
    size = np.maximum(outputs[there].std(axis=0), TINY)
    rings = np.exp(np.array([mode.pole for mode in modes]) * times[:, np.newaxis])[:, :, np.newaxis]
    rings = rings * np.array([mode.shape / size * (1 + (mode.kind == "oscillatory")) for mode in modes])
    rings = np.moveaxis(rings, 2, 1)  # by row, output and mode
    levels = np.broadcast_to(np.eye(len(size)), (len(times), len(size), len(size)))
    columns = np.concatenate([rings.real, -rings.imag, levels], axis=2).reshape(len(times) * len(size), -1)
    found = np.linalg.lstsq(columns, (outputs[there] / size).ravel(), rcond=None)[0]
    left = outputs[there] - (columns @ found).reshape(-1, len(size)) * size
    return found[:n] + 1j * found[n : 2 * n], found[2 * n :] * size, left


def _order(asked: _Asked, turning: Sequence[Mode]) -> tuple[ComplexArray, FloatArray]:
    """Poles of the linear model, the one that explains most first, and what the criterion of so many may be at best.

    All squares, cubes and products of the motions may explain what those in one direction are to.
    """
    motions = asked.motions(INTEGRATED[0])
    which = [one for n in (2, 3) for one in combinations_with_replacement(range(motions[0].shape[1]), n)]
    products = [np.array([own[:, list(one)].prod(axis=1) for one in which]) for own in motions]
    candidates = {mode.pole: _answers(asked, products, mode.pole) for mode in turning}
    left, basis = asked.seen, np.zeros((len(asked.seen), 0))
    poles: list[complex] = []
    rest: list[float] = []
    while candidates and len(poles) < MOST_MODES:
        along = {pole: _beside(own, basis) for pole, own in candidates.items()}
        pole = max(along, key=lambda one: float(np.square(along[one].T @ left).sum()))
        basis = np.hstack([basis, along[pole]])
        left = left - along[pole] @ (along[pole].T @ left)
        poles.append(pole)
        price = asked.price(asked.n_numbers(len(poles)), basis)
        rest.append(asked.misfit(np.square(left).sum(axis=0)) + price)
        # as `_stand_alone`: what lies beside the first follows what that one does not, which is what is asked
        candidates = {one: own for one, own in candidates.items() if abs(one - pole) > max(-one.real, -pole.real)}
    return np.array(poles), np.array(rest)


def _alone(asked: _Asked, turning: Sequence[Mode]) -> list[float]:
    """Criteria of the mode that explains most, of the two that do, and so on, without inner forces."""
    none = [np.zeros((0, own.shape[1])) for own in asked.states]
    candidates = {mode.pole: _answers(asked, none, mode.pole) for mode in turning}
    left, basis = asked.seen, np.zeros((len(asked.seen), 0))
    criteria: list[float] = []
    while candidates:
        along = {pole: _beside(own, basis) for pole, own in candidates.items()}
        pole = max(along, key=lambda one: float(np.square(along[one].T @ left).sum()))
        basis = np.hstack([basis, along[pole]])
        left = left - along[pole] @ (along[pole].T @ left)
        n_numbers = 2 * (len(criteria) + 1) * (left.shape[1] + len(asked.states))
        criteria.append(asked.misfit(np.square(left).sum(axis=0)) + n_numbers * float(np.log(left.size)))
        del candidates[pole]
    return criteria


def _fitted_near(asked: _Asked, motions: list[FloatArray], poles: ComplexArray) -> "_Trial":
    """What leaves least near these poles."""
    starts = [np.array(one) for one in product((0.0, 1.0, -1.0), repeat=motions[0].shape[1])]
    starts = [one / np.linalg.norm(one) for one in starts if one.any() and one[one != 0.0][0] > 0.0]
    tried = sorted((_Trial.of(asked, motions, poles, one) for one in starts), key=lambda one: one.power)
    return min((_fitted(asked, one) for one in tried[:STARTS]), key=lambda one: one.power)


def _beside(columns: FloatArray, basis: FloatArray) -> FloatArray:
    """A basis of what columns are beside another basis."""
    beside = columns / np.maximum(np.linalg.norm(columns, axis=0), TINY)
    beside = beside - basis @ (basis.T @ beside)
    values, vectors = np.linalg.eigh(beside.T @ beside)
    told = values > EXPLAINED * values.max()
    return np.asarray(beside @ vectors[:, told] / np.sqrt(values[told]))


def _answers(asked: _Asked, products: Sequence[FloatArray], pole: complex) -> FloatArray:
    """(n_rows, 2 n_drives) real and imaginary parts of what the pole makes of each start and each product."""
    h, n = asked.dt / asked.fine, len(products)
    rows = []
    for i, (own, there) in enumerate(zip(products, asked.rows, strict=True)):
        free = np.zeros((n, there.size), dtype=np.complex128)
        free[i] = np.exp(pole * asked.dt * np.arange(there.size))
        line = 0.5 * h * (np.exp(pole * h) * own + np.hstack([own[:, 1:], own[:, -1:]]))  # from point to point
        rows.append(np.vstack([free, _run(np.exp(pole * h), line)[:, :: asked.fine]])[:, there].T)
    both = np.vstack(rows)
    return np.hstack([both.real, both.imag])


def _run(pole: complex, drive: FloatArray | ComplexArray) -> ComplexArray:
    n_drives, n_samples = drive.shape
    if not n_drives:
        return np.zeros((0, n_samples), dtype=np.complex128)
    recursion = PoleRecursion.of(np.full(n_drives, pole), n_samples)
    return recursion.run(drive, np.zeros(n_drives, dtype=np.complex128))[0]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Trial:
    """Modes, a direction, and what is left beside any sizes.

    Attributes:
        motions: (n_fine, n_motions) a record.
        poles: (n_modes,) [rad/s].
        direction: (n_motions,) of size 1.
        answers: (n_rows, n_columns) a mode.
        left: (n_rows, n_outputs).
        basis: (n_rows, all columns) of the answers.
        sizes: (n_columns, n_outputs) a mode.
        power: of what is left.
    """

    motions: list[FloatArray]
    poles: ComplexArray
    direction: FloatArray
    answers: list[FloatArray]
    left: FloatArray
    basis: FloatArray
    sizes: list[FloatArray]
    power: float

    @classmethod
    def of(cls, asked: _Asked, motions: list[FloatArray], poles: ComplexArray, direction: FloatArray) -> "_Trial":
        """With the sizes that leave least."""
        powers = _powers(motions, direction)
        answers = [_answers(asked, powers, pole) for pole in poles.tolist()]
        left, basis, sizes = _projected(asked.seen, answers)
        return cls(
            motions=motions,
            poles=poles,
            direction=direction,
            answers=answers,
            left=left,
            basis=basis,
            sizes=sizes,
            power=float(np.square(left).sum()),
        )


def _powers(motions: Sequence[FloatArray], direction: FloatArray) -> list[FloatArray]:
    """(2, n_fine) after each blow: square and cube of the deformation; nothing (0, n_fine) of no direction."""
    if not direction.size:
        return [np.zeros((0, len(own))) for own in motions]
    return [np.array([(own @ direction) ** 2, (own @ direction) ** 3]) for own in motions]


def _fitted(asked: _Asked, trial: _Trial) -> _Trial:
    """Poles and direction that leave least, with every size projected out (Kaufman's steps)."""
    n_modes, begun = len(trial.poles), trial.poles
    for _ in range(STEPS):
        across = np.linalg.svd(trial.direction[np.newaxis])[2][1:] if trial.direction.size else np.zeros((0, 0))
        slopes = _slopes(asked, trial, across)
        step = np.linalg.lstsq(slopes, trial.left.ravel(), rcond=None)[0]
        step = step / max(1.0, float(np.linalg.norm(step[2 * n_modes :])))
        for _ in range(HALVINGS):
            poles = trial.poles + step[:n_modes] + 1j * step[n_modes : 2 * n_modes]
            far = poles - begun
            poles = begun + far / np.maximum(1.0, np.abs(far) / (-FURTHEST * begun.real))
            poles = np.minimum(poles.real, LEAST_DECAY * begun.real) + 1j * np.abs(poles.imag)
            direction = trial.direction + step[2 * n_modes :] @ across
            other = _Trial.of(asked, trial.motions, poles, direction / max(float(np.linalg.norm(direction)), TINY))
            if other.power < trial.power:
                break
            step = 0.5 * step
        else:
            break
        enough = other.power > (1.0 - ENOUGH) * trial.power
        trial = other
        if enough:
            break
    return trial


def _without(asked: _Asked, trial: _Trial, i: int) -> _Trial:
    """The likeliest without one of its modes."""
    return _fitted(asked, _Trial.of(asked, trial.motions, np.delete(trial.poles, i), trial.direction))


def _slopes(asked: _Asked, trial: _Trial, across: FloatArray) -> FloatArray:
    """(n_values, 2 n_modes + n_motions - 1) of what is left, but for its sign: by poles, and across the direction."""
    now, by_real, by_imaginary = _powers(trial.motions, trial.direction), [], []
    for pole, own, sizes in zip(trial.poles.tolist(), trial.answers, trial.sizes, strict=True):
        nudge = -NUDGE * pole.real
        real, imaginary = np.split((_answers(asked, now, pole + nudge) - own) / nudge, 2, axis=1)
        first, second = np.split(sizes, 2)
        by_real.append(real @ first + imaginary @ second)
        by_imaginary.append(real @ second - imaginary @ first)  # the answer's slope, turned by i
    by_direction = []
    for one in across:
        moved = _powers(trial.motions, trial.direction + NUDGE * one)
        change = [
            (_answers(asked, moved, pole) - own) @ sizes
            for pole, own, sizes in zip(trial.poles.tolist(), trial.answers, trial.sizes, strict=True)
        ]
        by_direction.append(sum(change) / NUDGE)
    every = [one - trial.basis @ (trial.basis.T @ one) for one in by_real + by_imaginary + by_direction]
    return np.array([one.ravel() for one in every]).T


def _projected(seen: FloatArray, answers: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray, list[FloatArray]]:
    """What is left beside any sizes, the basis of the answers, and (n_columns, n_outputs) the sizes of each mode."""
    columns = np.hstack(answers)
    lengths = np.maximum(np.linalg.norm(columns, axis=0), TINY)
    basis, triangle = np.linalg.qr(columns / lengths)
    along = basis.T @ seen
    sizes = np.linalg.lstsq(triangle, along, rcond=1e-12)[0] / lengths[:, np.newaxis]
    return seen - basis @ along, basis, np.split(sizes, np.cumsum([own.shape[1] for own in answers])[:-1])


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Description:
    """Modes with inner forces.

    Attributes:
        trial: with any sizes.
        criterion: Schwarz's, with one shape a mode.
        share: as `InnerForces.share`.
    """

    trial: _Trial
    criterion: float
    share: float


def _told(asked: _Asked, trial: _Trial, *, least: float) -> _Description | None:
    """The description whose modes have one shape each; None where its criterion is not below `least`."""
    answers = trial.answers
    n_outputs = asked.seen.shape[1]
    n_modes, n_drives = len(answers), answers[0].shape[1] // 2
    columns = np.hstack(answers)
    basis, triangle = np.linalg.qr(columns / np.maximum(np.linalg.norm(columns, axis=0), TINY))
    along = basis.T @ asked.seen
    apart = np.square(asked.seen).sum(axis=0) - np.square(along).sum(axis=0)
    n_numbers = 2 * n_modes * (n_outputs + n_drives) + max(0, trial.direction.size - 1)
    price = asked.price(n_numbers, basis)
    if not _stand_alone(trial.poles) or asked.misfit(apart) + price > least:  # no shapes leave less
        return None
    free = np.linalg.lstsq(triangle, along, rcond=RIDGE)[0].reshape(n_modes, 2, n_drives, n_outputs)
    real, imaginary = np.moveaxis(triangle.reshape(len(triangle), n_modes, 2, n_drives), 2, 0)
    turning = np.moveaxis(real + 1j * imaginary, 1, 0)
    left, sizes, right = np.linalg.svd(free[:, 0] - 1j * free[:, 1], full_matrices=False)
    start = np.concatenate([(left[:, :, 0] * sizes[:, :1]).ravel(), right[:, 0].ravel()])
    fit = scipy.optimize.least_squares(
        lambda moved: _rest(moved, turning, along)[0],
        np.concatenate([start.real, start.imag]),
        jac=lambda moved: _rest(moved, turning, along)[1],
        method="trf",
        max_nfev=TURNS,
    )
    criterion = asked.misfit(apart + np.square(fit.fun.reshape(along.shape)).sum(axis=0)) + price
    if criterion > least:
        return None
    drives, shapes = _drives_and_shapes(fit.x, turning, n_outputs)
    drives[:, : len(asked.states)] = 0.0  # what inner forces make
    made = np.einsum("adk,ak,ao->do", turning, drives, shapes).real
    share = np.square(made).sum(axis=0) / np.maximum(np.square(asked.seen).sum(axis=0), TINY)
    return _Description(trial=trial, criterion=criterion, share=float(np.sqrt(share.max())))


def _stand_alone(poles: ComplexArray) -> bool:
    """Whether each rings, and none within the half-power band of another, where the two follow anything."""
    distance = np.abs(poles[:, np.newaxis] - poles) + np.diag(np.full(len(poles), np.inf))
    return bool((-poles.real < np.minimum(HEAVIEST * np.abs(poles), distance.min(axis=1))).all())


def _drives_and_shapes(numbers: FloatArray, turning: ComplexArray, n_outputs: int) -> tuple[ComplexArray, ComplexArray]:
    n_modes, _, n_drives = turning.shape
    real, imaginary = np.split(numbers, 2)
    drives, shapes = np.split(real + 1j * imaginary, [n_modes * n_drives])
    return drives.reshape(n_modes, n_drives), shapes.reshape(n_modes, n_outputs)


def _rest(numbers: FloatArray, turning: ComplexArray, along: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What participations and shapes leave, and its derivatives."""
    n_outputs = along.shape[1]
    drives, shapes = _drives_and_shapes(numbers, turning, n_outputs)
    moved = np.einsum("adk,ak->ad", turning, drives)
    rest = np.einsum("ad,ao->do", moved, shapes).real - along
    by_drive = np.einsum("adk,ao->doak", turning, shapes).reshape(rest.size, -1)
    by_shape = np.einsum("ad,op->doap", moved, np.eye(n_outputs)).reshape(rest.size, -1)
    by_all = np.hstack([by_drive, by_shape])
    return rest.ravel(), np.hstack([by_all.real, -by_all.imag])
