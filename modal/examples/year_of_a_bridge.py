"""A year of a bridge, an identification every hour: which change is the weather, and which is damage?

The frequencies of a bridge move by some three percent between winter and summer, because its asphalt and its bearings
soften with temperature. On day 240 a bearing loses two percent of its stiffness; no frequency moves by more than a
half percent, a sixth of what the weather does, and hidden in it. A thermometer hangs on the bridge, so that the part of
each frequency that follows it can be taken off (by regression, its form chosen on months that were held out), and what
is left is watched in all modes together: an alarm comes only from what chance does in one month of 400.

`modal-report batch` writes the table of modes of such a year, `modal-report track` follows it. Here the table comes
from the eigenvalue problem of six masses on springs, hour by hour (`numpy.linalg.eigh`), with errors as identified
records have them, modes that are missed, and poles of no mode; nothing of the packages takes part.

Run `python -m modal.examples.year_of_a_bridge [-o DIR]`; with a folder it writes the page, a recording and the table
with its tracks.

References:
    Peeters, De Roeck, One-year monitoring of the Z24-Bridge: environmental effects versus damage events, Earthquake
    Engineering & Structural Dynamics 30(2), 2001.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from modal.examples.story import command_line, print_written
from modal.tracking.page import tracks_headline, write_tracks
from modal.tracking.tracks import Tracks, track
from okid.arrays import FloatArray
from okid.readers.clock import DAY

N_HOURS, N_MASSES, N_MODES = 8760, 6, 5
DAMAGE_DAY, LOSS = 240, 0.02
"""A spring softens by this share, that of the third bearing."""
FOUND, ERROR, SPURIOUS = 0.93, 1e-3, 0.1
"""Chance that a mode is found in a record, relative deviation of its frequency, poles of no mode a record."""


def temperatures(rng: np.random.Generator) -> FloatArray:
    """(n_hours,) [deg C]: a year, a day, and weather that lasts for some days."""
    hours = np.arange(N_HOURS)
    weather = np.empty(N_HOURS)
    state = 0.0
    for hour, push in enumerate(rng.standard_normal(N_HOURS)):
        state = 0.985 * state + 0.7 * push
        weather[hour] = state
    return 10.0 - 11.0 * np.cos(2 * np.pi * hours / N_HOURS) - 4.0 * np.cos(2 * np.pi * hours / 24) + weather


def true_modes(temperature: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Frequencies (n_hours, n_modes) [Hz] and shapes (n_hours, n_modes, n_masses), by the eigenvalue problem.

    Args:
        temperature: (n_hours,) [deg C].
    """
    springs = (2 * np.pi * 4.0) ** 2 * (1.0 - 0.003 * (temperature[:, np.newaxis] - 10.0)) * np.ones(N_MASSES)
    springs[24 * DAMAGE_DAY :, 2] *= 1.0 - LOSS
    matrix = np.zeros((N_HOURS, N_MASSES, N_MASSES))
    for e in range(N_MASSES):  # spring e joins mass e - 1, or the ground, and mass e
        matrix[:, e, e] += springs[:, e]
        if e:
            matrix[:, e - 1, e - 1] += springs[:, e]
            matrix[:, e, e - 1] -= springs[:, e]
            matrix[:, e - 1, e] -= springs[:, e]
    squares, vectors = np.linalg.eigh(matrix)
    return np.sqrt(squares[:, :N_MODES]) / (2 * np.pi), vectors[:, :, :N_MODES].transpose(0, 2, 1)


def table_of_modes(rng: np.random.Generator, temperature: FloatArray) -> Any:
    """What `modal-report batch` would write of a year with this temperature [deg C], as a pyarrow.Table."""
    import pyarrow as pa

    frequencies, shapes = true_modes(temperature)
    hour, mode = np.nonzero(rng.random(frequencies.shape) < FOUND)
    false = np.repeat(np.arange(N_HOURS), rng.poisson(SPURIOUS, N_HOURS))
    values = frequencies[hour, mode] * (1.0 + ERROR * rng.standard_normal(hour.size))
    seen = shapes[hour, mode] + 0.02 * rng.standard_normal((hour.size, N_MASSES))
    values = np.concatenate([values, rng.uniform(0.5, 8.0, false.size)])
    seen = np.concatenate([seen, rng.standard_normal((false.size, N_MASSES))])
    hours, right = np.concatenate([hour, false]), np.arange(values.size) < hour.size
    order = np.lexsort((values, hours))
    return pa.table(
        {
            "record": [f"hour_{k:04d}" for k in hours[order]],
            "start_time": 3600.0 * hours[order],
            "frequency": values[order],
            "verdict": np.where(right, "system", "doubtful")[order].tolist(),
            "shape": seen[order].tolist(),
        }
    )


def study(rng: np.random.Generator) -> Tracks:
    """The year, followed."""
    temperature = temperatures(rng)
    table = table_of_modes(rng, temperature)
    seen = sorted({int(name.removeprefix("hour_")) for name in table.column("record").to_pylist()})
    measured = temperature + 0.2 * rng.standard_normal(N_HOURS)
    return track(table, causes={"temperature": measured[seen]})


def summary(tracks: Tracks) -> str:
    """What was found, beside what was hidden."""
    seen = [
        f"  since day {alarm.since / DAY:.1f}, seen on day {alarm.time / DAY:.1f}: {alarm.reason}"
        for alarm in tracks.alarms
    ]
    hidden = f"hidden: a bearing lost {100 * LOSS:.0f} % of its stiffness on day {DAMAGE_DAY}"
    return "\n".join([tracks_headline(tracks), *(f"  causes: {cause}" for cause in tracks.causes), *seen, hidden])


def main(arguments: Sequence[str] | None = None) -> int:
    """Follow the year.

    Returns:
        0 where a change was found, 1 otherwise.
    """
    what = "A year of a bridge, an identification every hour: which change is the weather, and which is damage?"
    given = command_line(what, arguments, written="the page, a recording and the table with its tracks")
    tracks = study(np.random.default_rng(given.seed))
    print(summary(tracks))
    if given.output is not None:

        def write() -> Sequence[Any]:
            given.output.mkdir(parents=True, exist_ok=True)
            return write_tracks(tracks, given.output)

        print_written(write)
    return 0 if tracks.alarms else 1


if __name__ == "__main__":
    raise SystemExit(main())
