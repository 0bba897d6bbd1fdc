"""A diagnosis put together from what the search found: findings, evidence and rivals, advice, limits, cautions."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from modal.discrepancy.fitting.estimation import Estimate, Problem, covariance
from modal.discrepancy.fitting.nodes import SMALLEST_FALL, SMALLEST_GAIN, Node, Task, grid_error, log_likelihood_gain
from modal.discrepancy.results import (
    Calibrated,
    DetectionLimit,
    Diagnosis,
    Evidence,
    Finding,
    Hypothesis,
    LawCurve,
    Parameter,
    Step,
    explained_words,
)
from modal.discrepancy.selection.decision import Decision
from modal.discrepancy.selection.form_free import split_at_rest, unsettled
from modal.discrepancy.selection.screening import Candidate, screen_candidates
from modal.discrepancy.selection.smaller_models import GAINS, doubted_gain
from modal.discrepancy.setup import Setup, circumstances_of, simulated_outputs
from modal.discrepancy.validation.law_curves import law_curves
from modal.discrepancy.validation.other_hold import half_a_sample, hold_words
from modal.effects.ambiguity import Circumstance, ambiguous_with
from modal.effects.catalogue import effect_name, one_of, parameter_units
from modal.effects.effect import ForceEffect, is_form_free
from modal.localisation.evidence import Location
from modal.preparation.faults import spoiled_channels
from modal.simulation.plant import Plant, with_masses
from modal.structure.given import returned_model
from modal.structure.reciprocity import INTERNAL_FORCE
from modal.wording.text import listed, number, quantity, times_floor_text
from okid.arrays import FloatArray
from okid.readers.units import unit_error
from okid.record import Record


def hypothesis_of(node: Node, root: Node, task: Task) -> Hypothesis:
    """A fitted set of effects, as the diagnosis shows it."""
    return Hypothesis(
        effects=node.effects,
        fit_level=node.fit_level,
        held_out_level=node.held_out_level,
        log_likelihood=0.0 if node is root else log_likelihood_gain(root, node, task),
        masses=node.masses,
    )


def findings_of(
    decision: Decision,
    root: Node,
    task: Task,
    plant: Plant,
    *,
    deviations: FloatArray,
    circumstances: frozenset[Circumstance],
    laws: Sequence[LawCurve] = (),
) -> tuple[Finding, ...]:
    """What was found.

    Args:
        decision: The decision.
        root: The calibrated linear model.
        task: Records and catalogue.
        plant: The plant.
        deviations: (n_common,) standard deviations of the common unknowns.
        circumstances: For the table of ambiguities.
        laws: Of all effects of the model, where one has an unknown form.

    Returns:
        One finding an effect that the root does not have.
    """
    found = []
    for i in range(len(root.effects), len(decision.node.effects)):
        runner, margin = decision.runners[i], decision.margins[i]
        item = decision.node.fitted.assembly.placements[i]
        curve = laws[i] if laws and is_form_free(item.effect) else None
        found.append(
            Finding(
                effect=item.effect.key,
                where=item.where,
                parameters=_parameters(decision.node, plant, deviations, i),
                law=item.effect.law if curve is None else _form(curve),
                signature=item.effect.signature,
                evidence=_evidence(decision, root, task, margin),
                runner_up=None if runner is None else hypothesis_of(runner, root, task),
                ambiguous_with=_others(item.effect.key, circumstances, _even(decision, i)),
                curve=curve,
            )
        )
    return tuple(found)


def _form(curve: LawCurve) -> str:
    """A law of unknown form in words, by what it does at both ends of its motion."""
    ends = [float(np.sign(curve.motion[k] * curve.force[k])) for k in (0, -1)]
    opposed = {2.0: "hardening ", -2.0: "softening "} if curve.against == "displacement" else {2.0: "rising "}
    form = opposed.get(sum(ends), "")
    return f"f = a smooth {form}law of the {curve.against} at {curve.where}, through points"


def _parameters(node: Node, plant: Plant, deviations: FloatArray, i: int) -> tuple[Parameter, ...]:
    assembly = node.fitted.assembly
    item = assembly.placements[i]
    values = node.fitted.unknowns.values(assembly, i)
    spread = dict(zip(item.common, deviations[assembly.common_of(i)], strict=False))
    units = parameter_units(plant, item.effect, item.where)
    return tuple(
        Parameter(
            name=kind.name,
            value=float(np.mean(value)),
            std=float(spread.get(j, np.nan)),
            unit=unit,
            meaning=kind.meaning + (" (mean over the records)" if kind.local else ""),
        )
        for j, (kind, value, unit) in enumerate(zip(item.effect.parameters, values, units, strict=True))
    )


def _evidence(decision: Decision, root: Node, task: Task, margin: float) -> Evidence:
    node = decision.node
    gain = log_likelihood_gain(root, node, task)
    before, after = max(root.held_out_level - 1.0, 1e-12), max(node.held_out_level - 1.0, 0.0)
    closed = 1.0 - after / before if np.isfinite(before) else 1.0
    also = ", with the other effects" if len(node.effects) - len(root.effects) > 1 else ""
    levels = " to ".join(times_floor_text(level) for level in (root.held_out_level, node.held_out_level))
    words = f"the held-out gap falls from {levels} times the noise floor{also}"
    return Evidence(closed=float(np.clip(closed, -np.inf, 1.0)), log_likelihood=gain, margin=margin, words=words)


def _even(decision: Decision, i: int) -> tuple[str, ...]:
    """Keys of the effects that explain the data as well as effect number i of the chosen model.

    Two laws of one motion at one place are one law: any other of the same shape would do.
    """
    placements = decision.node.fitted.assembly.placements
    item = placements[i]
    found = [key for key, _ in decision.even[i]] if decision.even else []
    if isinstance(item.effect, ForceEffect) and not item.effect.n_memory:
        like = [
            other
            for other in placements
            if other.where == item.where
            and isinstance(other.effect, ForceEffect)
            and other.effect.needs == item.effect.needs
        ]
        free = {frozenset({"displacement"}): "smooth_stiffness", frozenset({"velocity"}): "smooth_damping"}
        found += [free[item.effect.needs]] if len(like) > 1 and item.effect.needs in free else []
    return tuple(dict.fromkeys(found))


def _others(effect: str, circumstances: frozenset[Circumstance], even: tuple[str, ...]) -> tuple[str, ...]:
    """What an effect cannot be told from, by the evidence and by the table, nor what is like these from anything else.

    A sensor's zero is like a constant force, and that like friction where the motion never reverses.
    """
    rows = ambiguous_with(effect, circumstances=circumstances, even_with=even)
    every = dict.fromkeys([*even, *(other for row in rows for other in row.others(effect))])
    for other in list(every):
        every |= dict.fromkeys(
            key for row in ambiguous_with(other, circumstances=circumstances) for key in row.others(other)
        )
    return tuple(other for other in every if other != effect)


def detection_limits(current: Estimate, task: Task, plant: Plant) -> tuple[DetectionLimit, ...]:
    """The size of each effect at each place below which it would not count, beside the model as found.

    What counts takes away a tenth of what is left, and 30 of 2 ln L: of the two the larger amplitude. An effect with a
    shape (a gap, a frequency) is hidden best at its least visible shape; the limit is the largest over the shapes that
    the screen tries. Effects without an amplitude (a delay) are left out.

    One limit for each effect and place, in the order of the catalogue.
    """
    candidates = screen_candidates(current, task.fit, task.catalogue, signs="free")
    largest: dict[tuple[str, str], Candidate] = {}
    for candidate in candidates:
        known = largest.get((candidate.key, candidate.where))
        if np.isfinite(candidate.deviation) and (known is None or candidate.deviation > known.deviation):
            largest[candidate.key, candidate.where] = candidate
    n_values = int(task.fit.drive.present.sum())
    deviations = np.sqrt(max(SMALLEST_GAIN, SMALLEST_FALL * n_values))
    found = []
    for key, effect in task.catalogue.items():
        amplitudes = [j for j, kind in enumerate(effect.parameters) if kind.role == "amplitude"]
        for (other, where), candidate in largest.items():
            if other != key or not amplitudes:
                continue
            first = amplitudes[0]
            found.append(
                DetectionLimit(
                    effect=key,
                    where=where,
                    parameter=effect.parameters[first].name,
                    value=float(deviations * candidate.deviation),
                    unit=parameter_units(plant, effect, where)[first],
                )
            )
    return tuple(found)


def advise(decision: Decision, fits: Sequence[Record], circumstances: frozenset[Circumstance]) -> tuple[str, ...]:
    """What to measure next."""
    words: list[str] = []
    by_level = False
    for i, ((effect, where), runner) in enumerate(zip(decision.node.effects, decision.runners, strict=False)):
        rows = ambiguous_with(effect, circumstances=circumstances, even_with=_even(decision, i))
        by_level |= any(row.circumstance == "one_level" for row in rows)
        words += [_apart(effect, where, row.others(effect), row.separates) for row in rows]
        if runner is not None and decision.status == "unresolved":
            rest = [row for row in ambiguous_with(effect, circumstances=_ANY_RECORDS) if row not in rows]
            near = sorted({key for key, _ in runner.effects} - {key for key, _ in decision.node.effects})
            words += [
                _apart(effect, where, (key,), row.separates) for key in near for row in rest if key in row.effects
            ]
    if "one_level" in circumstances and not by_level:
        words.append("Measure at a second level, two or three times as strong: most effects are told apart by level.")
    if decision.status == "unresolved" and not decision.node.effects:
        words.append(
            "Nothing that was tried explains the gap: measure at more places, look at the time windows and bands in "
            "which it is greatest, or register an effect of your own."
        )
    if decision.status == "none":
        highest = max(fits, key=lambda record: float(np.nanvar(record.inputs)) if record.n_inputs else 0.0)
        words.append(
            f"A stronger level than that of {highest.name or 'the loudest record'} would show effects that these data "
            "hide."
        )
    return tuple(dict.fromkeys(words))


def _apart(effect: str, where: str, others: Sequence[str], separates: str) -> str:
    return f"To tell {effect_name(effect)} at {where} from {one_of(others)} you need {separates}."


_ANY_RECORDS: frozenset[Circumstance] = frozenset({"one_level", "one_way", "small_motion", "large_motion"})
"""What other records would change; the plant stays what it is."""


def diagnosis_of(
    setup: Setup,
    as_given: Node,
    nodes: Sequence[Node],
    decision: Decision,
    *,
    location: Location,
    notes: tuple[str, ...],
) -> Diagnosis:
    """Put a decision into words, numbers and an updated model."""
    root, best, task = nodes[0], decision.node, setup.task
    decision = with_findings(decision, root, setup)
    circumstances = _circumstances(best, setup)
    _, spread, deviations = _spread(best, task)
    calibrated = calibrated_parameters(best.fitted, deviations)
    known = with_masses(setup.given.plant, best.masses)
    hits = tuple(item.name for item in calibrated if item.at_bound)
    found = nodes if any(node is best for node in nodes) else [*nodes, best]
    ranked = sorted(found, key=lambda node: node.held_out_level)
    before, after = _rmse(as_given, setup), _rmse(best, setup)
    return Diagnosis(
        status=decision.status,
        findings=decision.findings,
        model=returned_model(setup.given, best.fitted.assembly, best.fitted.unknowns, deviations),
        noise_floor=setup.floor,
        gap_before=before,
        gap_after=after,
        closed=_closed(as_given, best),
        calibrated=calibrated,
        bounds_hit=hits,
        detection_limits=detection_limits(best.coarse, task, setup.given.plant),
        advice=advise(decision, setup.fit, circumstances),
        location=location,
        steps=_steps(as_given, root, nodes, best, setup.held_out),
        hypotheses=tuple(hypothesis_of(node, root, task) for node in ranked),
        laws=decision.laws,
        fit=setup.fit,
        held_out=setup.held_out,
        warnings=(
            *notes,
            *setup.said,
            *_bound_words(hits),
            *_beyond_words(calibrated, known),
            *_mass_words(calibrated, best),
            *_gain_words(decision, circumstances),
            *_split_words(best, spread),
            *decision.notes,
            *decision.reasons,
        ),
        lack_of_fit=decision.lack_of_fit,
    )


def with_findings(decision: Decision, root: Node, setup: Setup) -> Decision:
    """The decision with the effects that it found beyond those of a first model, and all laws of the model."""
    best, plant = decision.node, setup.given.plant
    problem, spread, deviations = _spread(best, setup.task)
    laws = law_curves(best.fitted, problem, plant, spread)
    if laws and is_form_free(best.fitted.assembly.placements[-1].effect):
        moves = unsettled(best, setup.task, laws[-1].motion)
        laws = (*laws[:-1], replace(laws[-1], deviation=np.hypot(laws[-1].deviation, moves)))
    found = findings_of(
        decision, root, setup.task, plant, deviations=deviations, circumstances=_circumstances(best, setup), laws=laws
    )
    return replace(decision, findings=found, laws=laws)


def _circumstances(best: Node, setup: Setup) -> frozenset[Circumstance]:
    """What holds of the plant and its records, by the motion of the model chosen."""
    return circumstances_of(setup.given.plant, setup.fit, best) | _of_the_delay(best, setup.fit[0].dt)


def _spread(best: Node, task: Task) -> tuple[Problem, FloatArray, FloatArray]:
    """The records on the grid of the fit, the covariance of all unknowns, and deviations of the common ones.

    These hold what the grid may have left, and what only the smoothness of a curve tells from its linear part.
    """
    problem = task.fine_fit if best.fitted.trajectory.drive.dt < task.fit.drive.dt else task.fit
    spread = covariance(best.fitted, problem)
    chance = np.sqrt(np.maximum(np.diag(spread)[: best.fitted.assembly.n_common], 0.0))
    moves, _ = split_at_rest(best.fitted, spread)
    return problem, spread, np.hypot(np.hypot(chance, grid_error(best)), moves)


def calibrated_parameters(fitted: Estimate, deviations: FloatArray) -> tuple[Calibrated, ...]:
    """The linear parameters of an estimate, then the masses that it takes as right, with the user's tolerance.

    Args:
        fitted: The estimate.
        deviations: (n_common,) standard deviations of its common unknowns.
    """
    held = [one.parameter for one in fitted.assembly.plant.masses]
    found = tuple(
        Calibrated(
            name=parameter.name,
            unit=parameter.unit,
            nominal=parameter.nominal,
            value=float(fitted.unknowns.common[j]),
            std=float(deviations[j]),
            at_bound=bool(fitted.at_bounds[j]),
        )
        for j, parameter in enumerate(fitted.assembly.plant.parameters)
    )
    return found + tuple(
        Calibrated(
            name=one.name, unit=one.unit, nominal=one.nominal, value=one.nominal, std=one.deviation, at_bound=False
        )
        for one in held
    )


def _beyond_words(calibrated: Sequence[Calibrated], plant: Plant) -> tuple[str, ...]:
    """Linear parameters that came out beyond the tolerance of the model that was given."""
    beyond = [
        f"{one.name} ({quantity(one.nominal, one.unit)} given, {quantity(one.value, one.unit)} found)"
        for one, given in zip(calibrated, plant.parameters, strict=False)
        if not given.lower <= one.value <= given.upper
    ]
    if not beyond:
        return ()
    return (f"{listed(beyond)} lies beyond the tolerance of the model that was given: check the nominal values",)


def _split_words(best: Node, spread: FloatArray) -> tuple[str, ...]:
    """Linear parts of which the curve beside them takes a share that only its smoothness at rest decides."""
    return tuple(
        f"the {name} and the smooth law beside it are known better together than each by itself: the law bends more "
        f"sharply near rest than its points follow, so how much of the slope there is {name.split(' of ')[0]} is known "
        "only within the deviation that is stated for it"
        for name in split_at_rest(best.fitted, spread)[1]
    )


def _mass_words(calibrated: Sequence[Calibrated], best: Node) -> tuple[str, ...]:
    """Masses that the records say are wrong, to as many digits as it takes to see it."""
    words = []
    for one in calibrated:
        if one.name in best.masses:
            alike = (digits for digits in range(3, 9) if number(one.value, digits) != number(one.nominal, digits))
            digits = next(alike, 3)
            found, given = (f"{number(value, digits)} {one.unit}".rstrip() for value in (one.value, one.nominal))
            words.append(f"the {one.name} is {found}, not the {given} of the model that was given")
    return tuple(words)


def _of_the_delay(best: Node, dt: float) -> frozenset[Circumstance]:
    """What a delay that was found adds to the circumstances."""
    assembly, common = best.coarse.assembly, best.coarse.unknowns.common
    delays = [
        common[assembly.common_of(i).start]
        for i, item in enumerate(assembly.placements)
        if item.effect.key == "input_delay"
    ]
    return frozenset({"half_a_sample"}) if any(half_a_sample(delay, dt) for delay in delays) else frozenset()


def _gain_words(decision: Decision, circumstances: frozenset[Circumstance]) -> tuple[str, ...]:
    """A gain that stands for the scale of the whole model scales every force found beside it."""
    gains = [key for key, _ in decision.node.effects if key in GAINS]
    if "one_drive" in circumstances and "input_gain" in gains:
        words = (
            "input gain cannot be told from the scale of all masses, stiffnesses and dampings: what is found beside it "
            "is right only up to that factor; weigh one of the masses"
        )
        return (words,)
    if not gains or "one_dof" not in circumstances:
        return ()
    words = (
        f"{effect_name(gains[0])} cannot be told from a wrong mass or inertia: forces and stiffnesses found beside it "
        "are right only up to that factor; check the mass"
    )
    return (words,)


def _bound_words(hits: tuple[str, ...]) -> tuple[str, ...]:
    if not hits:
        return ()
    words = (
        f"{', '.join(hits)} sits on its bound: the model that was given is further off than its tolerances allow, or "
        "what is missing is not in the catalogue; check the nominal values"
    )
    return (words,)


def _rmse(node: Node, setup: Setup) -> FloatArray:
    floor = setup.floor.variance[len(setup.fit) :]
    if node.held_out is None:
        return np.full(floor.shape, np.inf)
    return np.asarray(np.sqrt(node.held_out.mean_square * floor))


def _closed(before: Node, after: Node) -> float:
    """Share of the held-out mean square above the floor that is gone."""
    if before.held_out is None or after.held_out is None:
        return 1.0 if after.held_out is not None else 0.0
    gap = float(np.nansum(np.maximum(before.held_out.mean_square - 1.0, 0.0)))
    left = float(np.nansum(np.maximum(after.held_out.mean_square - 1.0, 0.0)))
    return 1.0 - left / gap if gap > 0.0 else 0.0


def _steps(
    as_given: Node, root: Node, nodes: Sequence[Node], best: Node, held_out: Sequence[Record]
) -> tuple[Step, ...]:
    path = [("as given", as_given), ("calibrated", root)]
    known = len(root.effects)
    for count in range(known + 1, len(best.effects) + 1):
        wanted = best.effects[:count]
        node = best if count == len(best.effects) else next((one for one in nodes if one.effects == wanted), None)
        if node is not None:
            path.append((f"{wanted[-1][0]} at {wanted[-1][1]}", node))
    if path[-1][1] is not best and best.masses:
        path.append((listed(list(best.masses)), best))
    return tuple(
        Step(
            name=name,
            fit_level=node.fit_level,
            held_out_level=node.held_out_level,
            simulated=() if node.held_out is None else simulated_outputs(node.held_out, held_out),
        )
        for name, node in path
    )


def with_cautions(found: Diagnosis) -> Diagnosis:
    """The diagnosis with a warning more for what its records get wrong, and advice where a hold is in doubt."""
    warnings = [words for words in (explained_words(found), early_words(found)) if words]
    units, vague = unit_words(found)
    warnings += spoiled_words(found) + free_words(found) + units
    hold = hold_words(found)
    return replace(
        found,
        warnings=(*warnings, *(words for words in found.warnings if words not in vague)),
        advice=(*found.advice, *((hold,) if hold else ())),
    )


def spoiled_words(found: Diagnosis) -> list[str]:
    """What spoils the records themselves: a clipped output, spikes, a dead output.

    No effect of a model explains these, and one may be found that only stands for them; friction does hold a mass
    still, and play takes away coherence.
    """
    sentences: dict[tuple[str, tuple[str, ...]], str] = {}
    for name, records in (("to fit", found.fit), ("held out", found.held_out)):
        for one in spoiled_channels(_alike(records)):
            if one.level == "bad" and set(one.channels) <= set(records[0].output_names):
                sentences.setdefault((one.what, one.channels), f"the records {name} are spoiled: {one.sentence}")
    return list(sentences.values())


def free_words(found: Diagnosis) -> list[str]:
    """What a calibration may take up that is free in every force between the states of a state space."""
    free = [one for one in found.calibrated if one.name.startswith(INTERNAL_FORCE)]
    gains = any(one.effect in GAINS for one in found.findings)
    if not free or gains:
        return []
    words = (
        f"the state space is not recognised as a structure, so its calibration is free in {len(free)} numbers, which "
        "can take up the gain of a sensor or an input: whether a gain is wrong is not known; pass M, C and K to know"
    )
    return [words]


def unit_words(found: Diagnosis) -> tuple[list[str], list[str]]:
    """Sentences on gains that look like a certain conversion of units, and those of the decision that say less."""
    sentences, vague = [], []
    for one, words in wrong_units(found):
        gain = one.parameters[0].value
        reads = "the output {} reads {} times what the model expects"
        acts = "the input {} acts as {} times its numbers"
        sentences.append(
            f"{(reads if one.effect == 'sensor_gain' else acts).format(one.where, number(gain, 4))}, which looks like "
            f"{words}; look at the units of this channel, in the file and in the model, before anything else"
        )
        vague.append(doubted_gain(gain, one.where))
    return sentences, vague


def wrong_units(found: Diagnosis) -> list[tuple[Finding, str]]:
    """Gains that look like a certain conversion of units, each with its words.

    An output reads a gain times what moves it, an input acts as a gain times its numbers.
    """
    sizes = []
    for one in found.findings:
        if one.effect in GAINS and (gain := one.parameters[0].value):
            power = -1 if one.effect == "sensor_gain" else 1
            sizes.append((one, unit_error(gain**power, one.parameters[0].std * abs(gain) ** (power - 1))))
    return [(one, words) for one, words in sizes if words]


def _alike(records: Sequence[Record]) -> list[Record]:
    """The records with the channel names and units of the first: a diagnosis goes by the order of the channels."""
    first = records[0]
    return [
        replace(
            record,
            input_names=first.input_names,
            output_names=first.output_names,
            input_units=first.input_units,
            output_units=first.output_units,
            input_hold=first.input_hold,
        )
        for record in records
    ]


def early_words(found: Diagnosis) -> str:
    """What a negative delay means: no effect answers before its cause; "" where there is none."""
    delays = [(one.where, one.parameters[0].value) for one in found.findings if one.effect == "input_delay"]
    early = [(where, -delay) for where, delay in delays if delay < 0.0]
    if not early:
        return ""
    where, lead = early[0]
    samples = number(lead / found.fit[0].dt, 3)
    return (
        f"the outputs answer {where} {number(lead, 3)} s ({samples} samples) before it is recorded: no physical effect "
        "does, so the channels are skewed, or the outputs were written down a step after their inputs"
    )
