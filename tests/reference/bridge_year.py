"""A year of a bridge as a table of modes: hourly frequencies and shapes with their errors, made without the packages.

Two chains of six masses that do not feel each other (bending and torsion, seen by the same sensors with different
signs); every spring softens with temperature, that of torsion more, so that modes of the two cross. Temperature is a
year, a day, and weather (an autoregression). What is identified has an error of known deviation; modes are missed,
poles of no mode come and go.
"""

from dataclasses import dataclass

import numpy as np
import scipy

HOUR, DAY = 3600.0, 86400.0
N_MASSES = 6


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class BridgeYear:
    """Columns of a table of modes, the truth beside it.

    Attributes:
        columns: by name, as a table of modes has them; shapes are lists of complex numbers.
        truth: (n_rows,) number of the true mode of each row, -1 for a pole of no mode.
        temperature: (n_records,) as measured [deg C].
        change: time of the loss of stiffness [s]; nan for none.
    """

    columns: dict
    truth: np.ndarray
    temperature: np.ndarray
    change: float

    @property
    def causes(self):
        """Of the records that the table names: one in which no mode was found is not in it."""
        named = np.unique(self.columns["start_time"])
        return {"temperature": self.temperature[np.round(named / HOUR).astype(int)]}


def weather(rng, n_records):
    """(n_records,) temperature [deg C]."""
    hours = np.arange(n_records)
    phase = rng.uniform(0.0, 2 * np.pi)
    innovations = rng.standard_normal(n_records) * 4.0 * np.sqrt(1.0 - 0.985**2)
    slow = np.empty(n_records)
    state = 4.0 * rng.standard_normal()
    for k, push in enumerate(innovations):
        state = 0.985 * state + push
        slow[k] = state
    return 10.0 + 11.0 * np.sin(2 * np.pi * hours / 8766 + phase) + 4.0 * np.sin(2 * np.pi * hours / 24) + slow


def delayed(values, hours):
    """A body that follows the values within so many hours."""
    body = np.empty(values.size)
    state = values[0]
    for k, value in enumerate(values):
        state += (value - state) / hours
        body[k] = state
    return body


def stiffness_of(springs):
    """(n, N, N) of chains with one end held; springs (n, N)."""
    matrix = np.zeros((springs.shape[0], N_MASSES, N_MASSES))
    for e in range(N_MASSES):
        matrix[:, e, e] += springs[:, e]
        if e:
            matrix[:, e - 1, e - 1] += springs[:, e]
            matrix[:, e, e - 1] -= springs[:, e]
            matrix[:, e - 1, e] -= springs[:, e]
    return matrix


def as_table(year):
    """The columns as a pyarrow.Table, shapes as lists of real and imaginary parts."""
    import pyarrow as pa

    shapes = year.columns["shape"]
    parts = pa.StructArray.from_arrays([shapes.real.ravel(), shapes.imag.ravel()], ["real", "imag"])
    offsets = np.arange(shapes.shape[0] + 1, dtype=np.int32) * shapes.shape[1]
    return pa.table({**year.columns, "shape": pa.ListArray.from_arrays(offsets, parts)})


def true_modes(temperature, *, loss=0.0, spring=0, curved=0.2, slow=0.5, n_modes=6):
    """(n, n_modes) frequencies [Hz] and (n, n_modes, N_MASSES) shapes of length 1, bending first.

    Args:
        temperature: (n,) hourly [deg C].
        loss: (n,) or one share of its stiffness that a spring of the bending chain has lost.
        spring: which one.
        curved: as in `bridge_year`.
        slow: likewise.
        n_modes: likewise.
    """
    felt = (1.0 - slow) * temperature + slow * delayed(temperature, 10.0)
    swing = (felt - 10.0) / 20.0
    soft = 1.0 - 0.06 * swing * (1.0 + curved * swing)  # 20 degrees soften by 6 %, a frequency by 3 %
    families = []
    for base, more in ((1.0, 1.0), (1.13, 1.7)):
        springs = base * (1.0 + (soft - 1.0)[:, np.newaxis] * more) * np.ones(N_MASSES)
        if base == 1.0:
            springs[:, spring] *= 1.0 - np.asarray(loss)
        squared, vectors = np.linalg.eigh(stiffness_of((2 * np.pi * 4.0) ** 2 * springs))
        families.append((np.sqrt(squared) / (2 * np.pi), vectors.transpose(0, 2, 1)))
    signs = np.array([1.0, -1.0] * (N_MASSES // 2))
    half = n_modes // 2
    frequency = np.hstack([families[0][0][:, :half], families[1][0][:, : n_modes - half]])
    shape = np.concatenate(
        [families[0][1][:, :half], signs * families[1][1][:, : n_modes - half]], axis=1
    )  # torsion is seen with another sign on either side
    return frequency, shape


def ambient_record(rng, frequency, shape, *, n_samples, dt=0.05, damping=0.01, noise=0.05):
    """(n_samples, N_MASSES) velocities of a bridge under white forces on all its masses that nobody measured.

    Shapes of length 1 over equal masses feel white forces of one size as independent modal forces of one size. Every
    mode runs by its own recursion, exact for forces held over each sample, from a state that is long forgotten.

    Args:
        rng: of forces and noise.
        frequency: (n_modes,) [Hz].
        shape: (n_modes, N_MASSES).
        n_samples: of the record.
        dt: time step [s].
        damping: ratio of every mode.
        noise: standard deviation of each sensor's error, as a share of its signal's.
    """
    sizes = 2 * np.pi * frequency
    before = int(8.0 / (damping * sizes.min() * dt))
    velocity = np.zeros((n_samples, frequency.size))
    for mode, size in enumerate(sizes):
        pole = size * complex(-damping, np.sqrt(1.0 - damping**2))
        discrete = np.exp(pole * dt)
        force = rng.standard_normal(before + n_samples).astype(complex)
        state = scipy.signal.lfilter([0, (discrete - 1.0) / pole], [1, -discrete], force)[before:]
        velocity[:, mode] = (pole * state).imag / pole.imag  # of q'' + 2 z w q' + w^2 q = f
    clean = velocity @ shape
    return clean + noise * clean.std(axis=0) * rng.standard_normal(clean.shape)


def bridge_year(
    rng,
    *,
    n_records=8760,
    loss=0.0,
    change_at=np.nan,
    error=1e-3,
    found=0.93,
    spurious=0.15,
    curved=0.2,
    slow=0.5,
    sensor=0.2,
    n_modes=6,
):
    """A table of modes.

    Args:
        rng: of everything.
        n_records: hourly.
        loss: share of its stiffness that one spring of the bending chain loses.
        change_at: share of the time that is over then.
        error: relative standard deviation of a frequency.
        found: chance that a mode is found in a record.
        spurious: poles of no mode a record, on average.
        slow: share of the stiffness that follows the temperature with 10 hours.
        sensor: standard deviation of the measured temperature [deg].
        curved: how much the stiffness bends with temperature, as a share of its slope at 20 deg.
        n_modes: lowest ones that are identified.
    """
    temperature = weather(rng, n_records)
    times = HOUR * np.arange(n_records)
    change = np.nan if np.isnan(change_at) else float(times[int(change_at * n_records)])
    weakened = rng.integers(N_MASSES) if loss else 0
    frequency, shape = true_modes(
        temperature, loss=loss * (times >= change), spring=weakened, curved=curved, slow=slow, n_modes=n_modes
    )
    deviation = error * frequency * rng.uniform(0.7, 1.4, frequency.shape)
    there = rng.random(frequency.shape) < found
    row, mode = np.nonzero(there)
    seen = shape[row, mode] + 0.03 * (rng.standard_normal((row.size, N_MASSES, 2)) @ (1.0, 1j))
    seen *= np.exp(1j * rng.uniform(0, 0.05, (row.size, 1)))
    n_false = rng.poisson(spurious, n_records)
    false_row = np.repeat(np.arange(n_records), n_false)
    false_shape = rng.standard_normal((false_row.size, N_MASSES, 2)) @ (1.0, 1j)
    rows = np.concatenate([row, false_row])
    values = np.concatenate(
        [
            (frequency + deviation * rng.standard_normal(frequency.shape))[row, mode],
            rng.uniform(0.5, 8.0, false_row.size),
        ]
    )
    stds = np.concatenate([deviation[row, mode], np.full(false_row.size, 0.01)])
    shapes = np.concatenate([seen, false_shape])
    shapes /= shapes[np.arange(rows.size), np.abs(shapes).argmax(axis=1)][:, np.newaxis]
    order = np.lexsort((values, rows))
    truth = np.concatenate([mode, np.full(false_row.size, -1)])[order]
    rows, values, stds, shapes = rows[order], values[order], stds[order], shapes[order]
    number = np.arange(rows.size) - np.searchsorted(rows, rows) + 1
    columns = {
        "record": [f"hour_{k:05d}" for k in rows],
        "start_time": times[rows],
        "mode": number,
        "frequency": values,
        "frequency_std": stds,
        "damping_ratio": np.full(rows.size, 0.01),
        "damping_ratio_std": np.full(rows.size, 0.002),
        "probability": np.where(truth >= 0, 0.99, 0.4),
        "verdict": np.where(truth >= 0, "system", "doubtful").tolist(),
        "shape": shapes,
    }
    measured = temperature + sensor * rng.standard_normal(n_records)
    return BridgeYear(columns=columns, truth=truth, temperature=measured, change=change)
