"""What a result rests on: files from which it can be made again, the test of its model, its intervals, its set-up."""

import hashlib
import math
import os
import shlex
from collections.abc import Iterable
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from modal.identification.result import Identification
from modal.wording.text import GOOD_FIT, LEAST_FIT, NINETY_FIVE, fit_text, whole_percent
from okid.errors import InvalidDataError
from okid.residuals import NOT_WHITE

if TYPE_CHECKING:
    from modal.acceptance.test_file import SensorNote, Specification
    from modal.quality import DataQuality
    from modal.quality.check import ChannelQuality, ChannelStatistics


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SourceFile:
    """One file as it was when it was read.

    Attributes:
        name: path as it was given.
        size: in bytes.
        sha256: of its bytes, in hexadecimal.
    """

    name: str
    size: int
    sha256: str


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Provenance:
    """What a report says about where its result comes from; whoever calls the library knows, the result does not.

    Attributes:
        command: command line that made the result, "" where there was none.
        sources: paths of the files with the records (and the model of a comparison), as they were given.
        besides: paths of the other files that were read, such as a test file or a geometry.
        dt: time step that was given with them [s], None where the files have their own.
        remarks: what the reader did to the data, such as units that it converted, in words.
        files: size and hash of each file that was read; see `fingerprints`.
    """

    command: str = ""
    sources: tuple[str, ...] = ()
    besides: tuple[str, ...] = ()
    dt: float | None = None
    remarks: tuple[str, ...] = ()
    files: tuple[SourceFile, ...] = ()


def fingerprints(paths: Iterable[str | os.PathLike[str]]) -> tuple[SourceFile, ...]:
    """Size and SHA-256 of each file, so that a reader can tell years later whether it is the same.

    Raises:
        InvalidDataError: a file that cannot be read.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "a.csv"
        >>> _ = path.write_bytes(b"abc")
        >>> [(file.size, file.sha256[:8]) for file in fingerprints([path])]
        [(3, 'ba7816bf')]
    """
    return tuple(_fingerprint(path) for path in paths)


def _fingerprint(path: str | os.PathLike[str]) -> SourceFile:
    try:
        with Path(path).open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
            size = file.tell()
    except OSError as error:
        raise InvalidDataError(
            f"{str(path)!r} cannot be read again for its hash ({error.strerror or error}); keep the file in its place "
            "until the report is written."
        ) from error
    return SourceFile(name=str(path), size=size, sha256=digest)


def installed_version() -> str:
    """Version of the installed distribution, "not installed" when the packages run from a bare source tree."""
    try:
        return metadata.version("okid-modal")
    except metadata.PackageNotFoundError:
        return "not installed"


class BandLimits:
    """What is said of the bands of inputs and of intervals."""

    COHERENT: Final = 0.8
    """Multiple coherence from which the inputs explain most of an output at a frequency."""
    FEW_FACTOR: Final = 2.1
    """Warn of few degrees of freedom above this factor of Student's for 95 %, at which there are 17."""
    MOST_BANDS: Final = 6
    """Bands of an input that are written out."""


def validation_sentences(result: Identification) -> tuple[str, ...]:
    """How the fit on held-out rows was found, and how far it lies below that on all rows."""
    if result.response is not None:
        halves = (
            "Tested on halves of the averages: an error as large as theirs is drawn, added for one table and taken off "
            "for the other, as two halves of the blocks would differ. The model of each was compared with the other, "
            "every line in units of its standard deviation."
        )
        return (halves,)
    n_folds = int(np.size(result.fit.folds))
    inputs = result.channels.n_inputs
    run = "a free run from the inputs alone" if inputs else "a prediction one step ahead, because no input was measured"
    sentences = [
        f"Tested by {run}: in {_folds(n_folds)} part of the data was kept aside, the model fitted to the rest and run "
        "over that part."
        if n_folds
        else f"Tested by {run}; no rows were held out."
    ]
    held_out, whole = result.fit.mean, float(np.mean(result.fit.whole))
    if np.isfinite(held_out) and np.isfinite(whole):
        drop = whole - held_out
        if drop > 0.05:
            sentences.append(
                f"On all data the fit is {whole:.2f}, {drop:.2f} more than on data kept aside: a sign that the model "
                "follows the noise of the data that it was fitted to."
            )
        else:
            sentences.append(
                f"On all data the fit is {whole:.2f}, on data kept aside {held_out:.2f}: no sign that the model "
                "follows the noise of the data that it was fitted to."
            )
    low = [
        name
        for name, fit in zip(result.channels.output_names, result.fit.cross_validated, strict=True)
        if fit < LEAST_FIT
    ]
    if low:
        sentences.append(
            f"{len(low)} of {result.channels.n_outputs} outputs {'has' if len(low) == 1 else 'have'} a fit below "
            f"{LEAST_FIT}: what the modes say about {'it' if len(low) == 1 else 'them'} is not proved."
        )
    return tuple(sentences)


def coherence_sentence(quality: "DataQuality | None") -> str:
    """In how much of the band the inputs explain the outputs, without any model; "" where that is not known."""
    if quality is None or quality.coherence is None:
        return ""
    coherence = quality.coherence.multiple_coherence[1:]
    known = coherence[np.isfinite(coherence)]
    if not known.size:
        return ""
    share = float(np.mean(known >= BandLimits.COHERENT))
    return (
        f"Without any model, the inputs explain at least {100 * BandLimits.COHERENT:.0f} % of an output's power "
        f"(coherence) at {whole_percent(share)} of all frequencies and outputs."
    )


def gap_sentence(result: Identification) -> str:
    """That no simulation was compared, and what it takes."""
    if result.response is not None:
        return "No simulation was compared: that takes the records themselves, and these are frequency responses."
    if not result.channels.n_inputs:
        return (
            "No simulation was compared with these records, and none can be: without a measured input there is nothing "
            "to drive it with."
        )
    if len(result.records) < 2:
        return (
            "No simulation was compared with this record. To learn what a simulation is missing, and where, give it "
            "with this record and a second one that is held out:"
        )
    return (
        "No simulation was compared with these records. To learn what a simulation is missing, and where, give it with "
        "some of the records and hold the others out:"
    )


def gap_command(result: Identification, provenance: Provenance) -> str:
    """The command that compares a simulation with the files of this result; "" where there is no input."""
    if result.response is not None or not result.channels.n_inputs:
        return ""
    record = result.records[0]
    files = list(provenance.sources) or ["FIRST.csv"]
    one_each = len(files) == len(result.records) > 1  # else the files are the channels of one record
    fit, held_out = (files[:-1], files[-1:]) if one_each else (files, ["SECOND.csv"])
    words = ["modal-report", "gap", "MODEL.toml", "--fit", *fit, "--held-out", *held_out]
    words += [] if provenance.dt is None else ["--dt", repr(provenance.dt)]
    return shlex.join([*words, "--hold", record.input_hold, "-o", "gap"])


def _folds(n_folds: int) -> str:
    return "the only fold" if n_folds == 1 else f"each of {n_folds} folds"


_RESTS_ON = {
    "responses": (
        "They rest on how sharply the misfit of the responses rises when a pole is moved, and on the noise that "
        "coherence (where it is known) and the scatter about the model show, with what finite blocks leave over."
    ),
    "output error": (
        "They rest on how sharply the free-run error of the refined model rises when a parameter is moved, and on the "
        "noise that this model leaves."
    ),
    "propagation": (
        "They rest on the noise that the observer leaves, carried to first order through the observer, the Markov "
        "parameters and the realisation to the modes."
    ),
}


def has_intervals(result: Identification) -> bool:
    """True when the standard deviation of at least one mode's frequency is known."""
    return bool(np.isfinite([mode.frequency_std for mode in result.modes]).any())


def uncertainty_sentences(result: Identification) -> tuple[str, ...]:
    """What the intervals are, what they rest on, and what they leave out; one sentence where there are none."""
    known = result.uncertainty
    if (known is None and result.response is None) or not has_intervals(result):
        return ("No standard deviations are known for this result, so no interval is given.",)
    meaning = (
        f"± is half of a 95 % interval, {NINETY_FIVE} standard deviations: if the test were repeated with other "
        "noise, about 95 of 100 such intervals would hold the true value, as long as the model has the form of the "
        "system."
    )
    if known is None:
        return meaning, _RESTS_ON["responses"], _left_out(result)
    sentences = [meaning, _RESTS_ON[known.method]]
    factor = known.interval_factor(0.95)
    if factor > BandLimits.FEW_FACTOR:
        sentences.append(
            f"The noise is known from {known.degrees_of_freedom:.0f} degrees of freedom only: widen each interval by "
            f"{100 * (factor / NINETY_FIVE - 1):.0f} %."
        )
    elif math.isfinite(known.degrees_of_freedom):
        sentences.append(f"The noise is known from {known.degrees_of_freedom:,.0f} degrees of freedom.")
    sentences.append(_left_out(result))
    ratio = math.nan if result.innovations is None else result.innovations.whiteness_ratio
    if ratio > NOT_WHITE:
        sentences.append(
            f"The one-step errors of the model are not white (statistic {ratio:.2g} times its degrees of freedom, "
            "where 1 is white): the noise has a memory, or the model lacks something."
        )
    return tuple(sentences)


def _left_out(result: Identification) -> str:
    fit = result.fit.mean
    calibration = "the calibration of the sensors, the clock, and what the article does on another day"
    if not math.isfinite(fit):
        return (
            "They leave out the error of the model itself, and no fit on held-out data tells how large that is. They "
            f"leave out {calibration} as well."
        )
    if fit < GOOD_FIT:
        return (
            f"They leave out the error of the model itself: its fit on held-out rows is {fit_text(fit)}, below "
            f"{GOOD_FIT}. As far as the rest is noise, they hold; as far as the model lacks something, they are too "
            f"narrow. They leave out {calibration} as well."
        )
    return f"They leave out {calibration}."


LEVELS_FIRST = {"bad": 0, "doubtful": 1, "good": 2}
"""Order channels by these, the worst first."""

_COLUMNS = (
    ("dof", "place"),
    ("kind", "sensor"),
    ("maker", "maker"),
    ("model", "type"),
    ("serial", "serial"),
    ("sensitivity", "sensitivity"),
    ("calibrated", "calibrated"),
    ("note", "note"),
)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ChannelRow:
    """One row of the table of channels.

    Attributes:
        name: of the channel.
        role: "input" or "output".
        unit: "" where unknown.
        notes: one an entry of `sensor_columns`.
        bands: where an input moves, in words; "" for an output.
        fit: of an output, on data kept aside; nan for an input.
        level: "bad", "doubtful" or "good" by its data; "" where they were not looked at.
        statistics: of its data; None where they were not looked at.
    """

    name: str
    role: str
    unit: str
    notes: tuple[str, ...]
    bands: str
    fit: float
    level: str
    statistics: "ChannelStatistics | None"


def about_lines(specification: "Specification | None") -> tuple[tuple[str, str], ...]:
    """(heading, text) of what the test file says of the test as a whole; nothing for what it leaves out."""
    if specification is None:
        return ()
    said = (
        ("Article", specification.article),
        ("Operator", specification.operator),
        ("Place", specification.place),
        ("Date", "" if specification.date is None else specification.date.isoformat()),
        ("Notes", specification.notes),
    )
    return tuple((what, text) for what, text in said if text)


def sensor_columns(specification: "Specification | None") -> tuple[str, ...]:
    """Headings of what is known of at least one sensor."""
    return tuple(heading for _, heading in _used(specification))


def channel_rows(
    result: Identification, specification: "Specification | None" = None, quality: "DataQuality | None" = None
) -> tuple[ChannelRow, ...]:
    """Every channel with what is known of its sensor, its data and its fit: the worst first, then in their order."""
    record, used = result.channels, _used(specification)
    notes = {} if specification is None else {note.channel: note for note in specification.sensors}
    excited = () if result.excitation is None else result.excitation.excited_bands
    bands = [_bands_text(bands) for bands in excited] or [""] * record.n_inputs
    channels = () if quality is None else quality.channels
    looked_at: dict[tuple[str, str], ChannelQuality] = {(one.role, one.name): one for one in channels}
    rows = []
    for role, names, units in (
        ("input", record.input_names, record.input_units),
        ("output", record.output_names, record.output_units),
    ):
        for number, (name, unit) in enumerate(zip(names, units, strict=True)):
            seen = looked_at.get((role, name))
            rows.append(
                ChannelRow(
                    name=name,
                    role=role,
                    unit=unit,
                    notes=tuple(_said(notes.get(name), key) for key, _ in used),
                    bands=bands[number] if role == "input" else "",
                    fit=float(result.fit.cross_validated[number]) if role == "output" else math.nan,
                    level="" if seen is None else seen.level,
                    statistics=None if seen is None else seen.statistics,
                )
            )
    return tuple(sorted(rows, key=lambda row: (LEVELS_FIRST.get(row.level, 3), row.role == "input", row.fit)))


def _used(specification: "Specification | None") -> tuple[tuple[str, str], ...]:
    notes = () if specification is None else specification.sensors
    return tuple((key, heading) for key, heading in _COLUMNS if any(getattr(note, key) for note in notes))


def _said(note: "SensorNote | None", key: str) -> str:
    said = None if note is None else getattr(note, key)
    return str(said) if said else "–"


def _bands_text(bands: tuple[tuple[float, float], ...]) -> str:
    if not bands:
        return "nowhere"
    more = f" and {len(bands) - BandLimits.MOST_BANDS} more bands" if len(bands) > BandLimits.MOST_BANDS else ""
    return ", ".join(f"{low:.3g} to {high:.3g}" for low, high in bands[: BandLimits.MOST_BANDS]) + more
