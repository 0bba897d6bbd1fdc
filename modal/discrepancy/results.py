"""What a diagnosis says: the missing effects, how sure that is, and the gap before and after.

A model that lacks nothing may still explain nothing: where an output is noise only, or has nothing to do with the
inputs, no effect can be missing that the data could show. "Nothing missing" must not read like praise then.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, Literal

import numpy as np

from modal.effects.catalogue import effects_at
from modal.simulation import FOLLOWED, UNLIKELY, explained
from modal.simulation.plant import MASS
from modal.structure.structural_model import StructuralModel
from modal.structure.structural_plant import places_in_words
from modal.wording.text import listed, percent, times_floor_text
from okid.arrays import FloatArray
from okid.display import Displayed
from okid.record import Record

EVEN = 10.0
"""Count a model with no more effects as explaining the data as well where its criterion is within this: odds of 150."""
NOTHING = 0.1
"""Say that a model explains nothing of an output where it explains less than this share of its variance."""
MOST_NAMED = 4
"""Name at most so many outputs in a sentence."""


def explained_shares(diagnosis: "Diagnosis") -> FloatArray:
    """(n_outputs,) share of each output's held-out variance that the updated model explains.

    1 - mean square of measured minus simulated over the variance of the measured output, over all held-out records;
    negative where the output would be nearer to its own mean; nan where the output rests.
    """
    counts = np.array([np.isfinite(record.outputs).sum(axis=0) for record in diagnosis.held_out], dtype=float)
    variance = np.array([np.nanvar(record.outputs, axis=0) for record in diagnosis.held_out])
    total = (counts * variance).sum(axis=0)
    left = (counts * np.square(np.asarray(diagnosis.gap_after))).sum(axis=0)
    shares: FloatArray = np.where(total > 0.0, 1.0 - left / np.where(total > 0.0, total, 1.0), np.nan)
    return shares


def unexplained_outputs(diagnosis: "Diagnosis") -> tuple[str, ...]:
    """Names of the outputs of which the updated model explains nothing."""
    names = diagnosis.held_out[0].output_names
    return tuple(name for name, share in zip(names, explained_shares(diagnosis), strict=True) if share < NOTHING)


def explained_words(diagnosis: "Diagnosis") -> str:
    """The warning that the model explains nothing of some outputs; "" where it explains something of each."""
    outputs = unexplained_outputs(diagnosis)
    if not outputs:
        return ""
    rest = [f"{len(outputs) - MOST_NAMED} more"] if len(outputs) > MOST_NAMED else []
    shares = explained_shares(diagnosis)
    best = max(float(share) for share in shares if share < NOTHING)
    it = "it is" if len(outputs) == 1 else "they are"
    channel = "the channel is" if len(outputs) == 1 else "the channels are"
    no_proof = "; that nothing is missing there does not say that the model is right"
    proof = no_proof if diagnosis.status != "unresolved" else ""
    names, most = listed([*outputs[:MOST_NAMED], *rest]), percent(max(best, 0.0))
    return (
        f"the simulation explains nothing of {names} ({most} of the variance on held-out data): {it} noise, or "
        f"unrelated to the inputs, or {channel} dead or wrong{proof}"
    )


def changed_masses(diagnosis: "Diagnosis") -> tuple[str, ...]:
    """Names of the masses that the records ask to be others than those given."""
    return tuple(one.name for one in diagnosis.calibrated if one.name.startswith(MASS) and one.value != one.nominal)


def other_masses(diagnosis: "Diagnosis") -> str:
    """What explains the records where other masses do and no effect is found: "another mass of dof_0"; else ""."""
    changed = changed_masses(diagnosis)
    explains = not diagnosis.findings and explained(diagnosis.steps[-1].held_out_level)
    return masses_text(changed) if changed and explains else ""


def masses_text(names: Sequence[str]) -> str:
    """Masses that are not those given, by their names.

    Example:
        >>> masses_text([]), masses_text(["mass of lower"]), masses_text(["mass of lower", "mass of upper"])
        ('', 'another mass of lower', 'other masses of lower and upper')
    """
    if len(names) < 2:
        return "".join(f"another {name}" for name in names)
    return f"other masses of {listed([name.removeprefix(MASS) for name in names])}"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Parameter(Displayed):
    """A parameter of an effect, as found.

    Attributes:
        name: Its name.
        value: The estimate, in `unit`.
        std: Standard deviation of the estimate, in `unit`.
        unit: Unit, "" for none.
        meaning: What it is, in a few words.
    """

    name: str
    value: float
    std: float
    unit: str
    meaning: str = ""

    def __str__(self) -> str:
        width = f" +- {self.std:.2g}" if np.isfinite(self.std) else ""
        return f"{self.name} = {self.value:.6g}{width} {self.unit}".rstrip()


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Hypothesis(Displayed):
    """A set of effects that was fitted.

    Attributes:
        effects: (effect key, place) of each effect, in the order in which they were found.
        fit_level: Mean square of the residual on the records to fit, in units of the noise floor.
        held_out_level: Likewise on the held-out records.
        log_likelihood: 2 ln L of all records against the calibrated linear model.
        masses: Names of the masses that are not those of the model as given.
    """

    effects: tuple[tuple[str, str], ...]
    fit_level: float
    held_out_level: float
    log_likelihood: float
    masses: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Evidence(Displayed):
    """What speaks for a finding.

    Attributes:
        closed: Share of the held-out mean square above the floor that the effect takes away, from the model that has
            all other findings.
        log_likelihood: 2 ln L that it gains on all records.
        margin: 2 ln L by which it leads the runner-up; infinite where there is none.
        words: The same in a sentence.
    """

    closed: float
    log_likelihood: float
    margin: float
    words: str


ResidualKind = Literal["displacement", "velocity", "time", "input", "output"]
"""What a residual depends on."""
Follows = Literal["", "past", "other output"]
"""What a residual of an output follows where that is no law of a signal: its own past, or what another one leaves."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class LackOfFit(Displayed):
    """A test of what the model still leaves, against laws of no particular form at one place.

    Attributes:
        kind: What they depend on.
        where: Name of the place, the input or the output.
        p_value: Probability that noise alone leaves as much, all tests of the diagnosis counted.
        share: Size of what is left as a share of the least named effect's force, both by what they do to the outputs
            beyond all that the model can make up for; infinite where that is all, nan where nothing is named.
        size: Size of what is left as a share of the measured outputs, root mean square.
        follows: Of an output's residual: "past", its own, or "other output", both named by `where`; else "".
    """

    kind: ResidualKind
    where: str
    p_value: float
    share: float
    size: float
    follows: Follows = ""


def beyond_noise(tests: Sequence[LackOfFit]) -> Iterator[LackOfFit]:
    """The tests that noise alone hardly fails, where what is left is larger than errors of a simulation."""
    return (one for one in tests if one.p_value < UNLIKELY and one.size > FOLLOWED)


def worst_left(tests: Sequence[LackOfFit]) -> LackOfFit | None:
    """The test that noise alone fails least likely; None where noise may be all."""
    return next(beyond_noise(tests), None)


def something(test: LackOfFit) -> str:
    """What is left, in words."""
    if test.follows == "other output":
        return f"something that {test.where} share, as a force that nobody measured or a common cable makes it,"
    if test.follows == "past":
        return f"something of {test.where} that follows its own past, as a force that nobody measured or hum does,"
    at = test.where if test.kind in {"input", "output"} else f"at {test.where}"
    return f"something that depends on the {test.kind} {at}"


def worst_text(test: LackOfFit) -> str:
    """The same with its size; but the filter that makes noise white takes most of what no law describes."""
    size = "" if test.follows else f", {percent(test.size)} of the outputs"
    return f"{something(test)} is left{size}"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class LawCurve(Displayed):
    """A law as found, over what the data say of it without any law.

    Attributes:
        effect: Key in the catalogue.
        where: Name of the place.
        against: What it is drawn against.
        motion: (n,) grid of it, in `motion_unit`.
        force: (n,) the law.
        deviation: (n,) standard deviation of the law from that of its parameters. Of a law of unknown form it is
            that of law and linear part together, which are known better than each by itself: also from the chance of
            the linear part, and what both still move between the points with more of them; and so much wider that 1.96
            of it hold the whole curve, not each point by itself, in 95 of 100 cases.
        points_motion: (m,) centres of bins of the motion.
        points_force: (m,) force in each bin, free of the law's form, from the data.
        points_deviation: (m,) standard deviation of each.
        loop_motion: (k,) motion of a stretch of record, for laws with memory; empty for others.
        loop_force: (k,) their force along it.
        motion_unit: Unit of the motion.
        force_unit: Unit of the force.
    """

    effect: str
    where: str
    against: Literal["displacement", "velocity", "time", "input", "output"]
    motion: FloatArray
    force: FloatArray
    deviation: FloatArray
    points_motion: FloatArray
    points_force: FloatArray
    points_deviation: FloatArray
    loop_motion: FloatArray
    loop_force: FloatArray
    motion_unit: str
    force_unit: str

    @property
    def unit(self) -> str:
        """Unit of the force."""
        return self.force_unit

    @property
    def learned_on(self) -> tuple[float, float]:
        """Range of the motion in the records to fit: the law says nothing beyond it."""
        return float(self.motion.min()), float(self.motion.max())


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Finding(Displayed):
    """An effect that the model lacked.

    Attributes:
        effect: Key in the catalogue.
        where: Name of the place.
        parameters: Its parameters.
        law: The law in one line.
        signature: How it shows in the data.
        evidence: What speaks for it.
        runner_up: The best hypothesis with another effect or place instead of it, None if there is none.
        ambiguous_with: Effects that cannot be told from it in these data: by a fixed table of what is the same by
            structure or in records such as these, and all others with no more effects for which the evidence is even.
        curve: The law of a form-free effect; None for effects with a name.
    """

    effect: str
    where: str
    parameters: tuple[Parameter, ...]
    law: str
    signature: str
    evidence: Evidence
    runner_up: Hypothesis | None
    ambiguous_with: tuple[str, ...]
    curve: LawCurve | None = None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Calibrated(Displayed):
    """A linear parameter after the fit.

    Attributes:
        name: What it is ("stiffness of element_1").
        unit: Its unit.
        nominal: Value in the model as given.
        value: The estimate.
        std: Its standard deviation.
        at_bound: Whether it sits on a hard bound.
    """

    name: str
    unit: str
    nominal: float
    value: float
    std: float
    at_bound: bool


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class DetectionLimit(Displayed):
    """The largest size of an effect that the data could still hide: a smaller one would not count as found.

    Attributes:
        effect: Key in the catalogue.
        where: Name of the place.
        parameter: Name of the amplitude.
        value: The limit, in `unit`.
        unit: Its unit.
    """

    effect: str
    where: str
    parameter: str
    value: float
    unit: str


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Step(Displayed):
    """One step from the model as given to the model as found.

    Attributes:
        name: "as given", "calibrated", or the effect added ("cubic_stiffness at element_0").
        fit_level: Mean square of the residual on the records to fit, in units of the floor.
        held_out_level: Likewise on the held-out records.
        simulated: Simulated outputs of each held-out record, (n_samples, n_outputs) each.
    """

    name: str
    fit_level: float
    held_out_level: float
    simulated: tuple[FloatArray, ...]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Diagnosis(Displayed):
    """What a simulation lacks against measured records.

    Attributes:
        status: "named": within 1.5 of the noise floor on held-out data, with a lead over every other hypothesis;
            "unresolved": a gap remains or no hypothesis leads (the findings are the best guess, no more); "none": no
            effect is needed, with `detection_limits`.
        findings: The effects found, in the order in which they were found.
        model: The model with calibrated parameters and the effects, of the type that was given where that can hold
            them; simulates, saves and loads.
        noise_floor: The noise floor of the records to fit, then of the held-out ones (`NoiseFloor`).
        gap_before: (n_held_out, n_outputs) RMSE of the model as given on the held-out records.
        gap_after: (n_held_out, n_outputs) RMSE of `model`.
        closed: Share of the held-out mean square above the floor that calibration and effects took away.
        calibrated: The linear parameters, then the masses; of those that the records do not ask to be others, the
            nominal value and the tolerance.
        bounds_hit: Names of linear parameters that sit on a hard bound.
        detection_limits: What the data could still hide.
        advice: What to measure next, in words.
        location: Where the two disagree, before any effect was tried (`Location`).
        steps: From the model as given to the model as found.
        hypotheses: All sets of effects that were fitted to the end, best first.
        laws: The laws found, each over the data.
        fit: The records to fit.
        held_out: The held-out records.
        warnings: What the reader must know, a sentence each.
        lack_of_fit: Tests of what `model` still leaves, the least probable first; empty where none could be made.
    """

    status: Literal["named", "unresolved", "none"]
    findings: tuple[Finding, ...]
    model: Any
    noise_floor: Any
    gap_before: FloatArray
    gap_after: FloatArray
    closed: float
    calibrated: tuple[Calibrated, ...]
    bounds_hit: tuple[str, ...]
    detection_limits: tuple[DetectionLimit, ...]
    advice: tuple[str, ...]
    location: Any
    steps: tuple[Step, ...]
    hypotheses: tuple[Hypothesis, ...]
    laws: tuple[LawCurve, ...]
    fit: tuple[Record, ...]
    held_out: tuple[Record, ...]
    warnings: tuple[str, ...]
    lack_of_fit: tuple[LackOfFit, ...] = ()

    def display_rows(self) -> list[tuple[str, str]]:
        """The verdict, each effect with its parameters, and what the reader must know."""
        told = in_words(self)
        found = [(f"{one.effect} at {one.where}", "; ".join(map(str, one.parameters))) for one in told.findings]
        rows = [("verdict", self.verdict), *found, ("closed", f"{percent(self.closed)} of the gap above the floor")]
        rows += [("records", f"{len(self.fit)} to fit, {len(self.held_out)} held out")]
        rows += [("hypotheses", f"{len(self.hypotheses)} fitted to the end")]
        return rows + [("warning", text) for text in told.warnings]

    @property
    def verdict(self) -> str:
        """The result in one sentence."""
        told = in_words(self)
        names = effects_at([(finding.effect, finding.where) for finding in told.findings]) or other_masses(told)
        left = f"{times_floor_text(self.steps[-1].held_out_level)} times the noise floor remain on held-out data"
        blind = unexplained_outputs(self)
        if self.status == "none" and len(blind) == len(self.held_out[0].output_names):
            return f"These data tell nothing of the model, which explains nothing of {listed(list(blind))}: {left}."
        if self.status == "none":
            but = f", with {names}" if names else ""
            but += f", but the model explains nothing of {listed(list(blind))}" if blind else ""
            return f"No effect is missing that these data could show{but}: {left}."
        if self.status == "named":
            return f"Missing: {names}; {left}."
        if not names:
            return f"Something is left that no effect that was tried explains: {left}."
        if self.warnings and explained(self.steps[-1].held_out_level):
            return f"Unresolved: the best guess is {names}; {left}, but {told.warnings[-1]}."
        return f"Unresolved: the best guess is {names}, which the data do not prove: {left}."


def in_words(diagnosis: Diagnosis) -> Diagnosis:
    """The diagnosis as it is told: what nobody named is called by what it joins (`places_in_words`).

    Only the words change. `with_effect` and the updated model know the places by the names of the diagnosis itself.
    """
    words = places_in_words(diagnosis.model) if isinstance(diagnosis.model, StructuralModel) else {}
    if not words:
        return diagnosis
    names = "|".join(sorted(map(re.escape, words), key=len, reverse=True))
    pattern = re.compile(rf"(?<![\w-])({names})(?![\w-])")

    def told(value: Any) -> Any:
        if isinstance(value, str):
            return pattern.sub(lambda found: words[found.group()], value)
        if isinstance(value, tuple):
            return tuple(map(told, value))
        if is_dataclass(value) and not isinstance(value, type):
            return replace(value, **{one.name: told(getattr(value, one.name)) for one in fields(value)})
        return value

    kept = {"model", "fit", "held_out", "location", "noise_floor"}
    said = {one.name: told(getattr(diagnosis, one.name)) for one in fields(diagnosis) if one.name not in kept}
    return replace(diagnosis, **said)
