"""Which mode of one result is which of another, and how far each shifted: standard deviations, tests and verdicts.

The modes are matched by the assignment of least cost over all of them at once. The cost of a pair is how far its poles
and its shapes lie apart, in units of what a change of the structure may do:

    cost = |s_a - s_b| / (d |s|) + (1 - assurance) / m + doubts,    |s| = sqrt(|s_a| |s_b|),  d = 0.3,  m = 0.5

A pair is worth no more than 1: a mode whose best partner costs more has none. So a frequency may shift by 30 % where
the shape stays, and among modes of close frequency the shape decides. A doubtful pole is a worse partner than a mode of
the system (0.2 each), so that a second pole beside a mode does not take its place; noise poles are no partners at all.
All pairs are chosen together (Hungarian method), not each mode its nearest. Where the outputs have several units, each
is counted in units of its own root mean square over the modes, else the largest numbers alone would decide.

A result is known by its summary, from memory or from the file that keeps it (`ResultSummary`).

References:
    Crouse, "On implementing 2D rectangular assignment algorithms", IEEE Transactions on Aerospace and Electronic
    Systems 52(4), 2016, doi 10.1109/TAES.2016.140952.
"""

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import scipy

from modal.identification.result import Identification, load, read_part
from modal.identification.words import trust_of
from modal.modes.mode import Choice, Mode
from modal.modes.shape_comparison import assurance
from modal.wording.text import shorten
from okid.arrays import ComplexArray, FloatArray
from okid.display import Displayed
from okid.errors import UnreadableFileError, visible

PART = "summary"
"""Name of a summary in the file of a result."""

MOST_MODES = 2000
"""Refuse a file with more modes than any identification has: each is weighed against every one of the other result."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class ChannelName(Displayed):
    """A channel of the records.

    Attributes:
        name: of the channel.
        unit: of its values.
    """

    name: str
    unit: str


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class ResultSummary(Displayed):
    """A result without its time histories and matrices.

    Attributes:
        name: for a reader, e.g. the folder it came from.
        modes: every mode, whatever its verdict.
        inputs: channels of the records.
        outputs: channels of the records, in the order of the shapes' components.
        dt: time step of the identified records [s].
        n_samples: of each record.
        choices: every setting, chosen or given.
        fit: cross-validated fit, mean over outputs.
        trust: "carried", "with care" or "not carried".
        degrees_of_freedom: of the residuals behind the standard deviations; infinite where not known.
        data: "file" or "samples", and the SHA-256 of each measured file or of each record's samples; empty where
            neither is known.
    """

    name: str
    modes: tuple[Mode, ...]
    inputs: tuple[ChannelName, ...]
    outputs: tuple[ChannelName, ...]
    dt: float
    n_samples: tuple[int, ...]
    choices: tuple[Choice, ...]
    fit: float
    trust: str
    degrees_of_freedom: float
    data: tuple[str, ...]


def summary_of(result: Identification, *, name: str = "", files: Sequence[str] = ()) -> ResultSummary:
    """The summary of a result in memory.

    Args:
        result: of `modal.identify` or `modal.load`.
        name: for a reader; that of its first record unless given.
        files: SHA-256 of each measured file, where it comes from files.
    """
    record = result.channels
    known, table = result.uncertainty, result.response
    return ResultSummary(
        name=name or record.name or "result",
        modes=result.modes.modes,
        inputs=_channel_names(record.input_names, record.input_units),
        outputs=_channel_names(record.output_names, record.output_units),
        dt=result.realisation.dt,
        n_samples=tuple(one.n_samples for one in result.records)
        or (() if result.response is None else (result.response.n_lines,)),
        choices=result.choices,
        fit=result.fit.mean,
        trust=trust_of(result).trust,
        degrees_of_freedom=math.inf if known is None else known.degrees_of_freedom,
        data=tuple(f"file {one}" for one in files)
        or tuple(f"samples {_digest(one.inputs, one.outputs)}" for one in result.records)
        or (() if table is None else (f"lines {_digest(table.frequencies, table.response)}",)),
    )


def read_result(path: str | Path) -> ResultSummary:
    """The summary of a result in a file or folder.

    Args:
        path: a folder that `modal-report run` wrote, or a saved result (.npz).

    Raises:
        UnreadableFileError: no such file, damaged, or no result.
    """
    path = Path(path)
    name, shown = _shown(path.resolve().name if path.name in ("", "..") else path.name), _shown(path)
    try:
        file = path / "result.npz" if path.is_dir() else path
        if not file.is_file():
            what = f"there is no {shown!r}" if file is path else f"{shown!r} holds no {file.name}"
            raise UnreadableFileError(f"{what}; give a folder that modal-report run wrote.")
    except OSError as error:
        raise UnreadableFileError(f"{shown!r} cannot be read ({error.strerror or error}).") from error
    try:
        kept: ResultSummary | None = read_part(file, PART, ResultSummary)
        summary = summary_of(load(file)) if kept is None else kept
        _check(summary)
    except ValueError as error:
        raise UnreadableFileError(
            f"{shown!r} is damaged or no result of modal-report run ({_shown(error).rstrip('.')}); give its folder or "
            "a saved result (.npz)."
        ) from error
    return replace(summary, name=name)


def _check(summary: ResultSummary) -> None:
    """Raise ValueError for what no identification has: a sound file of a stranger may hold anything."""
    n_outputs, n_modes = len(summary.outputs), len(summary.modes)
    if n_modes > MOST_MODES:
        raise ValueError(f"it has {n_modes} modes, more than {MOST_MODES}")
    if not all(np.isfinite([mode.pole, mode.frequency]).all() for mode in summary.modes):
        raise ValueError("a pole is not finite")
    shapes = [shape for mode in summary.modes for shape in (mode.shape, mode.shape_std) if shape is not None]
    if any(shape.shape != (n_outputs,) for shape in shapes):
        raise ValueError("a shape has not one component an output")


def _shown(text: object) -> str:
    return shorten(visible(str(text)), 200)


def _channel_names(names: Sequence[str], units: Sequence[str]) -> tuple[ChannelName, ...]:
    return tuple(ChannelName(name=name, unit=unit) for name, unit in zip(names, units, strict=True))


def _digest(*arrays: Any) -> str:
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


POLE_SCALE = 0.3
"""Call two modes different ones from this relative distance of their poles alone."""

SHAPE_SCALE = 0.5
"""Call them so from this loss of assurance alone."""

DOUBT = 0.2
"""Add this cost for each pole of a pair that is doubtful."""

TOO_FAR = 1.0


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Matching:
    """Pairs of modes, as indices into the modes of the two results.

    Attributes:
        pairs: (index before, index after) by rising frequency before.
        lost: indices before that have no partner; noise poles are not among them.
        new: indices after that have no partner.
        assurance: (n_before, n_after) of the shapes over the outputs that both results have; nan with fewer than two.
    """

    pairs: tuple[tuple[int, int], ...]
    lost: tuple[int, ...]
    new: tuple[int, ...]
    assurance: FloatArray


def match_modes(before: ResultSummary, after: ResultSummary) -> Matching:
    """The pairs of least cost among the modes of two results; see the module for the cost."""
    similarity = _assurance(before, after)
    costs = pair_costs(before.modes, after.modes, similarity)
    rows = [index for index, mode in enumerate(before.modes) if mode.verdict != "noise"]
    columns = [index for index, mode in enumerate(after.modes) if mode.verdict != "noise"]
    capped = np.minimum(costs[np.ix_(rows, columns)], TOO_FAR)
    chosen = zip(*scipy.optimize.linear_sum_assignment(capped), strict=True)
    pairs = [(rows[i], columns[j]) for i, j in chosen if capped[i, j] < TOO_FAR]
    return Matching(
        pairs=tuple(sorted(pairs, key=lambda pair: before.modes[pair[0]].frequency)),
        lost=tuple(sorted(set(rows) - {row for row, _ in pairs})),
        new=tuple(sorted(set(columns) - {column for _, column in pairs})),
        assurance=similarity,
    )


def pair_costs(before: Sequence[Mode], after: Sequence[Mode], similarity: FloatArray) -> FloatArray:
    """(n_before, n_after) cost of every pair; infinite where an oscillation would meet an overdamped pole."""
    poles_before = np.array([mode.pole for mode in before], dtype=np.complex128)[:, np.newaxis]
    poles_after = np.array([mode.pole for mode in after], dtype=np.complex128)
    size = np.sqrt(np.abs(poles_before) * np.abs(poles_after))
    distance = np.abs(poles_before - poles_after) / np.where(size > 0, size, 1.0)
    doubts = np.add.outer(_doubts(before), _doubts(after))
    loss = np.nan_to_num(1.0 - similarity)  # without shapes to compare, the poles decide
    same_kind = np.array([[one.kind == other.kind for other in after] for one in before], dtype=bool)
    costs = distance / POLE_SCALE + loss / SHAPE_SCALE + doubts
    return np.where(same_kind.reshape(costs.shape), costs, np.inf)


def common_outputs(before: ResultSummary, after: ResultSummary) -> tuple[list[int], list[int]]:
    """Indices of the outputs that both results have, with the same unit, in the order of the first."""
    where = {channel: index for index, channel in enumerate(after.outputs)}
    both = [(index, where[channel]) for index, channel in enumerate(before.outputs) if channel in where]
    return [first for first, _ in both], [second for _, second in both]


def _doubts(modes: Sequence[Mode]) -> FloatArray:
    return DOUBT * np.array([mode.verdict == "doubtful" for mode in modes], dtype=np.float64)


def shared_shapes(before: ResultSummary, after: ResultSummary) -> tuple[ComplexArray, ComplexArray, FloatArray]:
    """Shapes of both results over the outputs that both have, in columns, and the (n_shared,) unit of each output."""
    first, second = common_outputs(before, after)
    shapes = _shapes(before.modes, first), _shapes(after.modes, second)
    several_units = len({before.outputs[index].unit for index in first}) > 1
    size = np.sqrt(np.mean(np.abs(np.hstack(shapes)) ** 2, axis=1)) if several_units else np.ones(len(first))
    unit = np.where(size > 0, size, 1.0)
    return shapes[0] / unit[:, np.newaxis], shapes[1] / unit[:, np.newaxis], unit


def _assurance(before: ResultSummary, after: ResultSummary) -> FloatArray:
    first, second, unit = shared_shapes(before, after)
    if unit.size < 2:  # one component alone says nothing of a shape
        return np.full((len(before.modes), len(after.modes)), np.nan)
    return assurance(first, second)


def _shapes(modes: Sequence[Mode], outputs: Sequence[int]) -> ComplexArray:
    columns = [mode.shape[list(outputs)] for mode in modes]
    return np.array(columns, dtype=np.complex128).reshape(len(modes), len(outputs)).T


ShiftVerdict = Literal["beyond chance", "perhaps chance", "within its interval", "not known"]

LEVEL = 0.05
"""Call anything beyond chance with this chance at most in a comparison of a thing with itself."""

INTERVAL = 1.0 - LEVEL

SURE_FROM = 1.5364
"""Use P(chi^2_1 > q / T) from this ratio q / T: there it bounds P(Q > q) for every correlation (Szekely, Bakirov)."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Shift(Displayed):
    """How far one number of a mode moved.

    Attributes:
        what: the number.
        before: its value in the first result.
        after: its value in the second.
        change: relative to the first value, as a share; of a shape: the lost assurance, 1 - assurance.
        half_width: half the 95 % interval of the change; of a shape: the change up to which it is within its interval.
        p_value: chance of a shift of this size or more where nothing changed; nan where not known.
        verdict: "beyond chance" for the comparison as a whole; "perhaps chance": outside its own 95 % interval, but
            not remarkable among so many; "within its interval"; or "not known".
        remark: why it is not known.
    """

    what: Literal["frequency", "damping ratio", "shape"]
    before: float
    after: float
    change: float
    half_width: float
    p_value: float
    verdict: ShiftVerdict = "not known"
    remark: str = ""


def frequency_shift(before: Mode, after: Mode, freedom: tuple[float, float]) -> Shift:
    """Shift of the frequency.

    Args:
        before: the mode in the first result.
        after: the same in the second.
        freedom: degrees of freedom behind the standard deviations of the two.
    """
    return _shift(
        "frequency", (before.frequency, after.frequency), (before.frequency_std, after.frequency_std), freedom
    )


def damping_shift(before: Mode, after: Mode, freedom: tuple[float, float]) -> Shift:
    """Shift of the damping ratio; not known where one of the two is not resolved, or for an overdamped pole."""
    remark = ""
    if before.kind != "oscillatory":
        remark = "an overdamped pole has no damping ratio of its own"
    elif not (before.damping_resolved and after.damping_resolved):
        remark = "the damping is not resolved in one of the results"
    deviations = (math.nan, math.nan) if remark else (before.damping_ratio_std, after.damping_ratio_std)
    shift = _shift("damping ratio", (before.damping_ratio, after.damping_ratio), deviations, freedom)
    return replace(shift, remark=remark) if remark else shift


def shape_shift(
    before: ResultSummary,
    after: ResultSummary,
    pair: tuple[int, int],
    shapes: tuple[ComplexArray, ComplexArray, FloatArray],
    assurance: float,
) -> Shift:
    """Change of the shape, tested for the worst correlation of its components.

    Args:
        before: the first result.
        after: the second.
        pair: indices of the mode in the two.
        shapes: of both results over the shared outputs, and the unit of each output.
        assurance: of the pair.
    """
    (i, j), (first, second, unit) = pair, shapes
    deviations = [
        None if mode.shape_std is None else mode.shape_std[outputs] / unit
        for mode, outputs in zip((before.modes[i], after.modes[j]), common_outputs(before, after), strict=True)
    ]
    blank = Shift(
        what="shape", before=1.0, after=assurance, change=1.0 - assurance, half_width=math.nan, p_value=math.nan
    )
    if not math.isfinite(assurance):
        return replace(blank, remark="fewer than two outputs are in both results")
    if deviations[0] is None or deviations[1] is None:
        return replace(blank, remark="the uncertainty of a shape is not known")
    a, b = first[:, i], second[:, j]
    scale = np.vdot(b, a) / np.vdot(b, b).real
    distance = float(np.sum(np.abs(a - scale * b) ** 2))
    spread = float(np.sum(deviations[0] ** 2) + abs(scale) ** 2 * np.sum(deviations[1] ** 2))
    if not spread > 0.0:
        return replace(blank, remark="the uncertainty of a shape is not known")
    ratio = distance / spread
    p_value = float(scipy.special.chdtrc(1.0, ratio)) if ratio >= SURE_FROM else 1.0
    # |a - scale b|^2 = |a|^2 (1 - assurance), so the interval of the distance is one of the lost assurance
    most = float(scipy.special.chdtri(1.0, 1.0 - INTERVAL)) * spread / float(np.vdot(a, a).real)
    return replace(blank, half_width=most, p_value=p_value)


def of_modes(shifts: tuple[Shift, Shift, Shift], before: Mode, after: Mode) -> tuple[Shift, Shift, Shift]:
    """The shifts of a pair, no chance of them known where one of the two poles may itself be no mode.

    What a doubt of the data as a whole makes doubtful (a record hardly explained, a close line) is a mode but for that,
    and its deviation holds. A pole that does not come back at other orders, or that may be the colour of the forces, is
    another thing in each record: two modes as one in this, one of them in that.
    """
    if _stands_by_itself(before) and _stands_by_itself(after):
        return shifts
    remark = "one of the two poles may be no mode, so where it lies tells nothing of the structure"
    frequency, damping, shape = (replace(shift, p_value=math.nan, remark=shift.remark or remark) for shift in shifts)
    return frequency, damping, shape


def _stands_by_itself(mode: Mode) -> bool:
    """Whether it is a mode of the system, or would be one in better data."""
    return mode.verdict == "system" or {what for what, _ in mode.doubts} == {"data"}


def with_verdicts(
    several: Sequence[tuple[Shift, ...]], together: float, *, level: float
) -> tuple[list[tuple[Shift, ...]], bool]:
    """The same shifts with their verdicts, and whether they are beyond chance together: Holm's test over all of this.

    Args:
        several: the shifts of each pair.
        together: chance of the frequency shifts of all pairs, nan for no such test.
        level: chance of a false "beyond chance" among all of them.
    """
    flat = [shift.p_value for shifts in several for shift in shifts]
    *each, all_beyond = holm([*flat, together], level=level)
    rejected = iter(each)
    judged = [
        tuple(replace(shift, verdict=_verdict(shift, beyond=next(rejected))) for shift in shifts) for shifts in several
    ]
    return judged, all_beyond


def chance_together(scores: FloatArray, correlation: FloatArray, freedom: float) -> float:
    """Chance of shifts so large in all modes together where none moved, by Hotelling's T^2 = t' R^-1 t.

    With nu degrees of freedom behind the deviations of m shifts, (nu - m + 1) / (nu m) T^2 is F(m, nu - m + 1).

    Args:
        scores: (m,) shifts over their standard deviations, t.
        correlation: (m, m) of their errors, R.
        freedom: nu, at least m; infinite where the deviations are known.

    References:
        Hotelling, The Annals of Mathematical Statistics 2(3), 1931, 360-378, doi 10.1214/aoms/1177732979.

    Example:
        >>> two = np.array([2.2, -2.2])
        >>> [round(chance_together(two[:m], np.eye(m), math.inf), 4) for m in (1, 2)]
        [0.0278, 0.0079]
    """
    m, squared = scores.size, float(scores @ np.linalg.lstsq(correlation, scores, rcond=1e-10)[0])
    if not math.isfinite(freedom):
        return float(scipy.special.chdtrc(m, squared))
    rest = freedom - m + 1.0
    return float(scipy.special.fdtrc(m, rest, squared * rest / (freedom * m)))


def holm(p_values: Sequence[float], *, level: float) -> list[bool]:
    """Which hypotheses are rejected so that any false rejection at all has a chance of at most `level`.

    The k-th smallest of m p-values is compared with level / (m - k + 1), up to the first that is not below it; nan is
    no test.

    Example:
        >>> holm([0.04, 0.001, 0.02, float("nan")], level=0.05)
        [True, True, True, False]
        >>> holm([0.04, 0.001, 0.03], level=0.05)
        [False, True, False]
    """
    tested = sorted((p, index) for index, p in enumerate(p_values) if math.isfinite(p))
    rejected = [False] * len(p_values)
    for rank, (p, index) in enumerate(tested):
        if p > level / (len(tested) - rank):
            break
        rejected[index] = True
    return rejected


def _verdict(shift: Shift, *, beyond: bool) -> ShiftVerdict:
    if not math.isfinite(shift.p_value):
        return "not known"
    if beyond:
        return "beyond chance"
    return "within its interval" if shift.p_value >= 1.0 - INTERVAL else "perhaps chance"


def _shift(
    what: Literal["frequency", "damping ratio"],
    values: tuple[float, float],
    deviations: tuple[float, float],
    freedom: tuple[float, float],
) -> Shift:
    before, after = values
    size = abs(before) or math.nan
    variances = deviations[0] ** 2, deviations[1] ** 2
    std = math.sqrt(sum(variances))
    shift = Shift(
        what=what, before=before, after=after, change=(after - before) / size, half_width=math.nan, p_value=math.nan
    )
    if not (math.isfinite(std) and std > 0.0):
        return replace(shift, remark=f"the uncertainty of the {what} is not known")
    joint = _joint_freedom(variances, freedom)
    statistic = abs(after - before) / std
    return replace(shift, half_width=_t_quantile(joint) * std / size, p_value=_t_tail(statistic, joint))


def _joint_freedom(variances: tuple[float, float], freedom: tuple[float, float]) -> float:
    """Welch-Satterthwaite."""
    parts = sum(variance**2 / number for variance, number in zip(variances, freedom, strict=True))
    return sum(variances) ** 2 / parts if parts > 0 else math.inf


def _t_quantile(freedom: float) -> float:
    tail = 0.5 * (1.0 + INTERVAL)
    return float(scipy.special.ndtri(tail) if math.isinf(freedom) else scipy.special.stdtrit(freedom, tail))


def _t_tail(statistic: float, freedom: float) -> float:
    """Two-sided."""
    one = scipy.special.ndtr(-statistic) if math.isinf(freedom) else scipy.special.stdtr(freedom, -statistic)
    return float(2.0 * one)
