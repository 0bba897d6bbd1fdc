"""The embedded case of `modal-report demo`: a five-storey steel tower with a tuned mass on its roof, and its truth.

Two actuators push with arbitrary (coloured) forces from a converter that holds each value for one sample; five
accelerometers and one position sensor look on. The tuned mass splits the first bending mode into a close pair. The
tower is already swinging when the recording starts, every sensor has an offset and 3 % noise, some samples are lost.

The equations of motion are integrated interval by interval by Taylor's series of the motion itself, exact for a held
force; nothing of the identification (neither `era.simulate` nor a matrix exponential) takes part, so agreement between
what is found and what is true is evidence.

The position sensor of the tuned mass reads motion relative to the roof, up to a dozen times that of the roof. No node
moves by it, so it has no place here; the report says so, and the mode table and the assurance matrix hold it as ever.
"""

from dataclasses import dataclass

import numpy as np

from modal.geometry.sensors import Geometry, Sensor
from modal.modes.mode import ModalModel, Verdict
from okid.arrays import ComplexArray, FloatArray, frozen, frozen_complex
from okid.record import Record

INPUT_NAMES = ("shaker_floor_2", "actuator_roof")
OUTPUT_NAMES = ("floor_1", "floor_2", "floor_3", "floor_4", "roof", "tuned_mass")
OUTPUT_UNITS = ("m/s^2",) * 5 + ("m",)


@dataclass(frozen=True, slots=True, kw_only=True)
class Tower:
    """A laboratory tower of three metres, with a tuned mass of 0.4 percent of it.

    Attributes:
        dt: time step of the record [s].
        n_storeys: number of storeys.
        height: of a storey [m].
        half_width: of a floor [m].
        mass: of a floor [kg].
        stiffness: of a storey [N/m].
        damping_ratio: of every mode of the bare tower, as welded steel has it.
        tuned_mass: [kg].
        tuned_stiffness: [N/m], tuned to the first mode.
        tuned_damping: [N s/m].
        pushed: floors that are pushed, counted from 0 at the first floor above the ground.
    """

    dt: float = 0.02
    n_storeys: int = 5
    height: float = 0.6
    half_width: float = 0.4
    mass: float = 80
    stiffness: float = 120_000
    damping_ratio: float = 0.01
    tuned_mass: float = 1.5
    tuned_stiffness: float = 180
    tuned_damping: float = 0.5
    pushed: tuple[int, ...] = (1, 4)


TOWER = Tower()


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DemoTruth:
    """What an identification of the demo record should find.

    Attributes:
        frequencies: (n_modes,) rising [Hz].
        damping_ratios: (n_modes,).
        shapes: (n_outputs, n_modes) in output units, largest component 1.
        output_names: (n_outputs,) from the ground up, so that shapes can be drawn in this order.
        heights: (n_outputs,) of the sensors above the ground [m].
    """

    frequencies: FloatArray
    damping_ratios: FloatArray
    shapes: ComplexArray
    output_names: tuple[str, ...]
    heights: FloatArray

    def __post_init__(self) -> None:
        for name in ("frequencies", "damping_ratios", "heights"):
            object.__setattr__(self, name, frozen(getattr(self, name), name=name))
        object.__setattr__(self, "shapes", frozen_complex(self.shapes, name="shapes"))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ModeComparison:
    """One true mode and the mode that was found in its place; nan and "" where none was.

    Attributes:
        frequency: true [Hz].
        damping_ratio: true.
        found_frequency: [Hz].
        found_damping_ratio: as identified.
        assurance: |a* b|^2 / (a* a b* b) of the true shape a and the found shape b, 1 when they are equal.
        verdict: of the found mode.
    """

    frequency: float
    damping_ratio: float
    found_frequency: float
    found_damping_ratio: float
    assurance: float
    verdict: Verdict | None


def tower_matrices() -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Mass, damping and stiffness matrix and the force map of the tower with its tuned mass.

    Returns:
        (6, 6) mass [kg], (6, 6) damping [N s/m], (6, 6) stiffness [N/m], (6, 2) force map; the last coordinate is the
        tuned mass, all positions are absolute.
    """
    stiffness = TOWER.stiffness * (
        2 * np.eye(TOWER.n_storeys) - np.eye(TOWER.n_storeys, k=1) - np.eye(TOWER.n_storeys, k=-1)
    )
    stiffness[-1, -1] = TOWER.stiffness
    squares, vectors = np.linalg.eigh(stiffness / TOWER.mass)
    damping = TOWER.mass * (vectors * (2 * TOWER.damping_ratio * np.sqrt(squares))) @ vectors.T
    link = np.zeros(TOWER.n_storeys + 1)
    link[-2:] = -1.0, 1.0
    mass = np.diag([*[TOWER.mass] * TOWER.n_storeys, TOWER.tuned_mass])
    damping = np.pad(damping, (0, 1)) + TOWER.tuned_damping * np.outer(link, link)
    stiffness = np.pad(stiffness, (0, 1)) + TOWER.tuned_stiffness * np.outer(link, link)
    force_map = np.zeros((TOWER.n_storeys + 1, len(TOWER.pushed)))
    force_map[TOWER.pushed, range(len(TOWER.pushed))] = 1.0
    return mass, damping, stiffness, force_map


def demo_truth() -> DemoTruth:
    """True frequencies, damping ratios and shapes, from the eigenvalue problem of the equations of motion.

    Example:
        >>> demo_truth().frequencies.round(2).tolist()
        [1.68, 1.82, 5.12, 8.07, 10.37, 11.83]
    """
    A, _, C, _ = _first_order_form()
    poles, vectors = np.linalg.eig(A)
    order = [i for i in np.argsort(np.abs(poles)) if poles[i].imag > 0]
    shapes = C @ vectors[:, order]
    return DemoTruth(
        frequencies=np.abs(poles[order]) / (2 * np.pi),
        damping_ratios=-poles[order].real / np.abs(poles[order]),
        shapes=shapes / shapes[np.abs(shapes).argmax(axis=0), range(len(order))],
        output_names=OUTPUT_NAMES,
        heights=TOWER.height * np.array([1, 2, 3, 4, 5, 5]),
    )


def demo_record(rng: np.random.Generator, *, n_samples: int = 9000, noise: float = 0.03) -> Record:
    """Simulate the test of the tower.

    Args:
        rng: where forces, initial state, noise and lost samples come from.
        n_samples: length of the record, 50 a second.
        noise: standard deviation of the white noise of each sensor as a share of what it measures.

    Returns:
        Two forces [N]; five accelerations [m/s^2] and the position of the tuned mass relative to the roof [m].

    Example:
        >>> record = demo_record(np.random.default_rng(1), n_samples=500)
        >>> record.n_samples, record.input_units, record.output_units[-1]
        (500, ('N', 'N'), 'm')
    """
    forces = _coloured_forces(rng, n_samples)
    swinging = np.concatenate(
        [0.002 * rng.standard_normal(TOWER.n_storeys + 1), 0.02 * rng.standard_normal(TOWER.n_storeys + 1)]
    )
    outputs = _integrate(forces, swinging)
    size = outputs.std(axis=0)
    outputs += size * (noise * rng.standard_normal(outputs.shape) + 0.5 * rng.uniform(-1, 1, outputs.shape[1]))
    for channel in rng.permutation(outputs.shape[1])[:3]:  # a loose plug: a few samples of three channels are lost
        start = rng.integers(n_samples // 4, 3 * n_samples // 4)
        outputs[start : start + 4, channel] = np.nan
    return Record(
        forces,
        outputs,
        TOWER.dt,
        input_names=INPUT_NAMES,
        output_names=OUTPUT_NAMES,
        input_units=("N", "N"),
        output_units=OUTPUT_UNITS,
        input_hold="zero_order",
        name="demo: five-storey tower",
    )


def compare_with_truth(truth: DemoTruth, modes: ModalModel) -> tuple[ModeComparison, ...]:
    """Pair true and found modes one to one, the nearest in frequency first, at most 5 % apart.

    Args:
        truth: of the demo.
        modes: as identified; those called noise and those that do not oscillate are left out.
    """
    found = [mode for mode in modes if mode.kind == "oscillatory" and mode.verdict != "noise"]
    distance = {
        (i, j): abs(mode.frequency / frequency - 1)
        for i, frequency in enumerate(truth.frequencies)
        for j, mode in enumerate(found)
    }
    pairs: dict[int, int] = {}
    for i, j in sorted(distance, key=lambda pair: (found[pair[1]].verdict != "system", distance[pair])):
        if distance[i, j] < 0.05 and i not in pairs and j not in pairs.values():
            pairs[i] = j
    rows = []
    for i, (frequency, damping_ratio) in enumerate(zip(truth.frequencies, truth.damping_ratios, strict=True)):
        mode = found[pairs[i]] if i in pairs else None
        rows.append(
            ModeComparison(
                frequency=float(frequency),
                damping_ratio=float(damping_ratio),
                found_frequency=mode.frequency if mode else np.nan,
                found_damping_ratio=mode.damping_ratio if mode else np.nan,
                assurance=_assurance(truth.shapes[:, i], mode.shape) if mode else np.nan,
                verdict=mode.verdict if mode else None,
            )
        )
    return tuple(rows)


def _first_order_form() -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """State (positions, velocities): A, B, and the sensors C, D."""
    mass, damping, stiffness, force_map = tower_matrices()
    n = len(mass)
    inverse = np.linalg.inv(mass)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ stiffness, -inverse @ damping]])
    B = np.vstack([np.zeros_like(force_map), inverse @ force_map])
    C, D = np.zeros((n, 2 * n)), np.zeros((n, B.shape[1]))
    C[: TOWER.n_storeys], D[: TOWER.n_storeys] = A[n : n + TOWER.n_storeys], B[n : n + TOWER.n_storeys]
    C[-1, TOWER.n_storeys - 1 : n] = -1.0, 1.0
    return A, B, C, D


def _integrate(forces: FloatArray, state: FloatArray, *, n_parts: int = 4, n_terms: int = 10) -> FloatArray:
    """Outputs at the start of each interval; within it the force is constant and so x'' = A x', x''' = A x'' ..."""
    A, B, C, D = _first_order_form()
    outputs = np.empty((len(forces), len(C)))
    step = TOWER.dt / n_parts
    factors = step / np.arange(1, n_terms + 1)
    for k, force in enumerate(forces):
        outputs[k] = C @ state + D @ force
        drive = B @ force
        for _ in range(n_parts):
            term = factors[0] * (A @ state + drive)
            state = state + term
            for factor in factors[1:]:
                term = factor * (A @ term)
                state = state + term
    return outputs


def _coloured_forces(rng: np.random.Generator, n_samples: int) -> FloatArray:
    """Two low-passed forces of 40 and 25 N root mean square with different spectra; n_samples values each."""
    white = rng.standard_normal((n_samples, 2))
    forces = np.empty_like(white)
    memory, level = np.array([0.6, 0.4]), np.zeros(2)
    for k, value in enumerate(white):
        level = memory * level + value
        forces[k] = level
    size: FloatArray = np.array([40, 25]) * np.sqrt(1 - memory**2)
    return forces * size


def _assurance(first: ComplexArray, second: ComplexArray) -> float:
    return float(abs(np.vdot(first, second)) ** 2 / (np.vdot(first, first).real * np.vdot(second, second).real))


def demo_geometry() -> Geometry:
    """Six levels of four corners, from the ground up; each floor moves as one, the ground stands still.

    Example:
        >>> geometry = demo_geometry()
        >>> geometry.n_nodes, [sensor.name for sensor in geometry.sensors]
        (24, ['floor_1', 'floor_2', 'floor_3', 'floor_4', 'roof'])
    """
    corners = TOWER.half_width * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    levels = [tuple(range(4 * level, 4 * level + 4)) for level in range(TOWER.n_storeys + 1)]
    return Geometry(
        node_names=tuple(f"{level}{corner}" for level in range(TOWER.n_storeys + 1) for corner in range(1, 5)),
        positions=np.array([[x, y, level * TOWER.height] for level in range(TOWER.n_storeys + 1) for x, y in corners]),
        lines=(*(tuple(column) for column in zip(*levels, strict=True)), *((*floor, floor[0]) for floor in levels[1:])),
        surfaces=tuple(levels[1:]),
        sensors=tuple(
            Sensor(name=name, node=floor[0], direction=np.array([1.0, 0.0, 0.0]))
            for name, floor in zip(OUTPUT_NAMES[: TOWER.n_storeys], levels[1:], strict=True)
        ),
        fixed=levels[0],
        rigid=tuple(levels[1:]),
    )
