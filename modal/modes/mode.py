"""One mode and the set of them, with everything that is known about how far each can be trusted.

How far every number of an identification can be trusted: standard deviations, and intervals from them.

Two ways lead to the same type: the curvature of the output error at a refined model, and first-order propagation
through OKID and ERA (`modal.estimation.propagation`).

One number a mode, the same on every page: in the report, in the recording, in the table for programs.

Beside them what a step of an identification decided and why, and how well a model repeats its records.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
import scipy

from modal.wording.text import NINETY_FIVE, ratio_text, with_interval
from okid.arrays import ComplexArray, FloatArray, frozen_with_gaps
from okid.display import Displayed
from okid.errors import InvalidDataError
from okid.record import InputHold

if TYPE_CHECKING:
    import pyarrow as pa

ModeKind = Literal["oscillatory", "real", "nyquist", "unstable"]
Verdict = Literal["system", "doubtful", "noise"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Mode(Displayed):
    """A pole of the realisation (one of a conjugate pair) with its shape and every indicator; nan means not known.

    Attributes:
        pole: continuous-time pole s = ln(lambda) / dt [1/s], imaginary part >= 0.
        kind: "oscillatory" (a pair), "real" (overdamped, drift), "nyquist" (negative real discrete pole: at half the
            sampling frequency, no mode of the system) or "unstable" (grows in time).
        frequency: |pole| / (2 pi) [Hz].
        damping_ratio: -Re(pole) / |pole|, negative for an unstable pole.
        frequency_std: standard deviation of the frequency [Hz].
        damping_ratio_std: standard deviation of the damping ratio.
        shape_std: (n_outputs,) root mean square distance of each complex component from its own mean; None: not known.
        mass_std: (n_outputs, n_inputs) relative standard deviation of the modal mass with that output and input as
            driving point; None: not known.
        modal_mass: [kg] of the shape whose largest component is 1; nan until a driving point is named.
        modal_mass_std: [kg]; nan likewise.
        shape: (n_outputs,) complex, output units; largest component 1.
        participation: (n_inputs,) complex; the residue matrix of the pulse response is outer(shape, participation), so
            system[k] = 2 Re(shape participation' lambda^(k-1)) for a pair (without the 2 Re for a real pole).
        amplitude_coherence: Juang-Pappa modal amplitude coherence, in [0, 1].
        phase_collinearity: modal phase collinearity, in [0, 1]; 1 for a real shape.
        emac_output: extended modal amplitude coherence over outputs.
        emac_input: the same over inputs.
        emac: their product.
        cmi: consistent-mode indicator, emac * phase_collinearity.
        msv: mode singular value relative to the largest of the model.
        mpd: mean phase deviation [deg].
        repeatability: mean overlap with the same mode identified again from other data and orders, in [0, 1].
        reappears: (what was changed, overlap) of each kind of change that the mean is taken over; empty where unknown.
        gain: share of the squared free-run error, whitened, that its answer removes (`modal.verdict.excitation`).
        probability: that the mode belongs to the system.
        verdict: "system", "doubtful" or "noise".
        doubts: (what raises it, "pole" or "data"; in words) of each doubt but for which this were a mode of the system.
        damping_resolved: False where the mode may exist but its damping ratio is not to be quoted.
        reason: why this verdict, in words.
    """

    pole: complex
    kind: ModeKind
    frequency: float
    damping_ratio: float
    shape: ComplexArray
    participation: ComplexArray
    frequency_std: float = np.nan
    damping_ratio_std: float = np.nan
    shape_std: FloatArray | None = None
    mass_std: FloatArray | None = None
    modal_mass: float = np.nan
    modal_mass_std: float = np.nan
    amplitude_coherence: float = np.nan
    phase_collinearity: float = np.nan
    emac_output: float = np.nan
    emac_input: float = np.nan
    emac: float = np.nan
    cmi: float = np.nan
    msv: float = np.nan
    mpd: float = np.nan
    repeatability: float = np.nan
    reappears: tuple[tuple[str, float], ...] = ()
    gain: float = np.nan
    probability: float = np.nan
    verdict: Verdict = "doubtful"
    doubts: tuple[tuple[str, str], ...] = ()
    damping_resolved: bool = True
    reason: str = ""

    def __repr__(self) -> str:
        return f"Mode({self.in_words()})"

    def in_words(self) -> str:
        """One line: frequency and damping ratio with their 95 % intervals, verdict and probability."""
        frequency = with_interval(self.frequency, NINETY_FIVE * self.frequency_std)
        damping = ratio_text(self.damping_ratio, self.damping_ratio_std)
        return f"{frequency} Hz, damping {damping}, {self.verdict}, probability {self.probability:.2f}"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class ModalModel(Displayed):
    """All modes of one realisation, by frequency.

    Attributes:
        modes: every pole, one of each conjugate pair, whatever its verdict, by rising frequency.
        dt: time step of the realisation [s].
        indicator_caution: n / (p q): model order over observer order times number of outputs. Above about 0.3 the
            indicators test how well a mode repeats the observer rather than the data.
        indicators_missing: why the indicators are nan, "" when they are not.
        output_names: of the channels of the shapes; empty where only a realisation is known.
        output_units: likewise.
        input_names: of the channels of the participations; empty without inputs.
        input_units: likewise.
        input_hold: what the inputs did between samples; "zero_order" where only a realisation is known.
    """

    modes: tuple[Mode, ...]
    dt: float
    indicator_caution: float
    indicators_missing: str = ""
    output_names: tuple[str, ...] = ()
    output_units: tuple[str, ...] = ()
    input_names: tuple[str, ...] = ()
    input_units: tuple[str, ...] = ()
    input_hold: InputHold = "zero_order"

    def display_rows(self) -> list[tuple[str, str]]:
        """Every mode with its number."""
        return [(f"mode {number}", mode.in_words()) for number, mode in numbered(self.modes)]

    def display_title(self) -> str:
        """How many modes there are of each verdict."""
        verdicts = [mode.verdict for mode in self.modes]
        counts = ", ".join(f"{verdicts.count(each)} {each}" for each in get_args(Verdict))
        return f"ModalModel of {counts}"

    def __iter__(self) -> Iterator[Mode]:
        return iter(self.modes)

    def __len__(self) -> int:
        return len(self.modes)

    @property
    def system(self) -> tuple[Mode, ...]:
        """The modes whose verdict is "system"."""
        return tuple(mode for mode in self.modes if mode.verdict == "system")

    @property
    def frequencies(self) -> FloatArray:
        """(n_system,) frequencies of the system modes [Hz]."""
        return np.array([mode.frequency for mode in self.system])

    @property
    def damping_ratios(self) -> FloatArray:
        """(n_system,) damping ratios of the system modes."""
        return np.array([mode.damping_ratio for mode in self.system])

    @property
    def shapes(self) -> ComplexArray:
        """(n_outputs, n_system) shapes of the system modes, one a column."""
        n_outputs = self.modes[0].shape.size if self.modes else 0
        columns = [mode.shape for mode in self.system]
        return np.array(columns, dtype=np.complex128).reshape(len(columns), n_outputs).T

    def to_table(self) -> "pa.Table":
        """Every mode as a row, for pandas, polars or a file: `.to_pandas()`, `polars.from_arrow(table)`.

        Returns:
            Columns mode (its number), frequency [Hz], damping_ratio, their standard deviations, probability, verdict,
            kind, the indicators, reason, and shape: a list of {real, imaginary}, one a channel in the order of
            `output_names`, which stand in the metadata of the column.
        """
        import pyarrow as pa

        rows = numbered(self.modes)
        columns: dict[str, Any] = {"mode": [number for number, _ in rows]}
        columns |= {name: [getattr(mode, name) for _, mode in rows] for name in TABLE_COLUMNS}
        pair = pa.struct([("real", pa.float64()), ("imaginary", pa.float64())])
        shapes = [[{"real": z.real, "imaginary": z.imag} for z in mode.shape.tolist()] for _, mode in rows]
        table = pa.table(columns)
        names = pa.field("shape", pa.list_(pair), metadata={"output_names": "\n".join(self.output_names)})
        return table.append_column(names, pa.array(shapes, pa.list_(pair)))


TABLE_COLUMNS = (
    *("frequency", "frequency_std", "damping_ratio", "damping_ratio_std", "probability", "verdict", "kind"),
    *("damping_resolved", "modal_mass", "modal_mass_std", "repeatability", "gain", "amplitude_coherence"),
    *("phase_collinearity", "emac", "cmi", "msv", "mpd", "reason"),
)
"""Fields of a mode that are columns of its table."""

UncertaintyMethod = Literal["output error", "propagation"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Uncertainty(Displayed):
    """Standard deviations of modes and Markov parameters; nan where one is not known.

    Attributes:
        method: "output error" or "propagation".
        frequency_std: (n_modes,) [Hz], in the order of the modes that were asked for.
        damping_ratio_std: (n_modes,); 0 for a real pole, whose damping ratio is 1 by definition.
        shape_std: (n_modes, n_outputs) root of the mean square distance of each complex component from its own mean, of
            shapes normalised as `Mode.shape`: the largest component is 1 and has none.
        markov_std: (n_lags + 1, n_outputs, n_inputs) of the system Markov parameters, in their unit.
        degrees_of_freedom: of the residuals that the noise was estimated from; infinite where it is known.
        found: (n_modes,) share of replicas in which the mode was found again; 1 for methods without replicas.
        mass_std: (n_modes, n_outputs, n_inputs) relative, of modal masses with that output and input as driving point,
            of the shape whose largest component is 1; None where not known.

    Raises:
        InvalidDataError: arrays that do not fit together, or no positive number of degrees of freedom.

    Example:
        >>> known = Uncertainty(method="propagation", frequency_std=[0.1], damping_ratio_std=[0.01],
        ...                     shape_std=[[0.0]], markov_std=[[[0.1]]])
        >>> round(known.interval_factor(0.95), 3)
        1.96
    """

    method: UncertaintyMethod
    frequency_std: FloatArray
    damping_ratio_std: FloatArray
    shape_std: FloatArray
    markov_std: FloatArray
    degrees_of_freedom: float = np.inf
    found: FloatArray = None  # type: ignore[assignment]  # ones once constructed
    mass_std: FloatArray | None = None

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "frequency_std", frozen_with_gaps(self.frequency_std, name="frequency_std", shape=(None,)))
        n_modes = self.frequency_std.size
        shapes: dict[str, tuple[int | None, ...]] = {
            "damping_ratio_std": (n_modes,),
            "shape_std": (n_modes, None),
            "markov_std": (None, None, None),
        }
        for name, shape in shapes.items():
            set_(self, name, frozen_with_gaps(getattr(self, name), name=name, shape=shape))
        set_(self, "found", _found(self.found, n_modes))
        if self.mass_std is not None:
            set_(self, "mass_std", frozen_with_gaps(self.mass_std, name="mass_std", shape=(n_modes, None, None)))
        if not self.degrees_of_freedom > 0:
            raise InvalidDataError(f"degrees_of_freedom must be positive, but is {self.degrees_of_freedom}.")

    def wider(self, times: float) -> "Uncertainty":
        """With every deviation so many times as large."""
        return replace(
            self,
            frequency_std=times * self.frequency_std,
            damping_ratio_std=times * self.damping_ratio_std,
            shape_std=times * self.shape_std,
            markov_std=times * self.markov_std,
            mass_std=None if self.mass_std is None else times * self.mass_std,
        )

    def interval_factor(self, level: float = 0.95) -> float:
        """Half the width of the symmetric interval that covers with probability `level`, in standard deviations.

        Student's t with the residuals' degrees of freedom; the normal quantile where these are infinite.

        Raises:
            InvalidDataError: a level that does not lie between 0 and 1.
        """
        if not 0.0 < level < 1.0:
            raise InvalidDataError(f"a level must lie between 0 and 1, but is {level!r}; 0.95 is usual.")
        tail = 0.5 * (1.0 + level)
        # scipy's quantile of the t distribution is not defined at infinity
        if np.isinf(self.degrees_of_freedom):
            return float(scipy.special.ndtri(tail))
        return float(scipy.special.stdtrit(self.degrees_of_freedom, tail))


def _found(values: FloatArray | None, n_modes: int) -> FloatArray:
    return frozen_with_gaps(np.ones(n_modes) if values is None else values, name="found", shape=(n_modes,))


_RANK = {"system": 0, "doubtful": 1, "noise": 2}


def numbered(modes: Iterable[Mode]) -> tuple[tuple[int, Mode], ...]:
    """Every mode with its number, counted from 1: those of the system first, then the doubtful, then noise.

    Within a verdict the lower frequency comes first. What a reader quotes thus has the small numbers, and a pole that
    joins or leaves the noise does not move them.

    Example:
        >>> numbered(())
        ()
    """
    return tuple(enumerate(sorted(modes, key=lambda mode: (_RANK[mode.verdict], mode.frequency)), start=1))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Choice(Displayed):
    """One decision: what was chosen, and why, in words with numbers.

    Attributes:
        what: e.g. "observer order", "ridge", "model order", "frequency band".
        value: as it reads in a report, e.g. "40" or "0 to 25 Hz".
        reason: one sentence with its numbers.
    """

    what: str
    value: str
    reason: str


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Fit(Displayed):
    """How well the model, fed with the inputs alone, repeats the outputs: 1 - |y - y_sim| / |y - mean(y)|.

    Attributes:
        cross_validated: (n_outputs,) on rows that the model was not fitted to (folds of interleaved blocks).
        folds: (n_folds,) mean over outputs on each fold.
        whole: (n_outputs,) of the final model on all rows: reported, never used to choose.
        one_step: (n_outputs,) of the one-step prediction: looks perfect even for a bad model.
    """

    cross_validated: FloatArray
    folds: FloatArray
    whole: FloatArray
    one_step: FloatArray

    def __post_init__(self) -> None:
        for name in ("cross_validated", "folds", "whole", "one_step"):
            object.__setattr__(self, name, frozen_with_gaps(getattr(self, name), name=name, shape=(None,)))

    @property
    def mean(self) -> float:
        """Cross-validated fit, mean over outputs."""
        return float(self.cross_validated.mean())
