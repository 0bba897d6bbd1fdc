"""Set-ups of roving sensors, each of which measured some of the outputs, as one modal model.

**With inputs.** Each set-up is identified by itself, which tells how late its inputs act there (two starts of a
recorder are no one instant) and, at the references, how much it moves for its force. Delays are taken out of the
records, and a set-up whose references answer otherwise than those of the first one has its inputs scaled to it. Then
one model is fitted to all records with all channels, each output in the rows in which it was measured, each record by
its own noise (`modal.identification.refined_search`): poles, shapes, their deviations and the verdict are those of one
likelihood, as if one record had measured it all. Noise that is not white is another one in every set-up, and what was
not measured has none: there poles and shapes are means of what the set-ups give with models of their own noise, by
information, 1 / var = sum over set-ups of 1 / var_s.

**Without inputs.** What drives the structure is another force in every set-up, so neither levels nor innovations can be
shared: only poles and shapes are common. Each set-up is identified by its outputs alone; a part of a shape is scaled to
the others by the references, alpha_s = (phi_ref,s^H phi_ref) / |phi_ref,s|^2, and poles and scaled parts are averaged
with their information. To first order that is what one fit of common poles and shapes to all set-ups gives. The joint
pole is what the verdict asks for its doubts: what one set-up alone cannot tell from an undamped line, all may.

References:
    Reynders, Magalhaes, De Roeck, Cunha, Merging strategies for multi-setup operational modal analysis, 27th
    International Modal Analysis Conference, 2009 (PoSER, PreGER).
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from modal.estimation.fits import mean_fit
from modal.identification.information import mean_by_information
from modal.identification.result import Identification
from modal.identification.synthesis import output_model, with_absent_outputs
from modal.identification.words import NOISE_UNKNOWN, has_noise_model
from modal.modes.mode import Choice, ModalModel, Mode, Uncertainty
from modal.modes.shape_comparison import assurance
from modal.preparation.band import coherent_band
from modal.preparation.delay import LONGEST_SHARE, delay_between, late_inputs
from modal.preparation.faults import living
from modal.verdict.excitation import undriven_doubt
from modal.verdict.judgement import DOUBTED
from modal.verdict.probability import SPREAD, pole_doubts, probability
from okid.arrays import ComplexArray, FloatArray
from okid.errors import IdentificationError, InvalidDataError
from okid.markov import MarkovParameters
from okid.record import Record

SAME_FREQUENCY = 6.0
"""Take a pole of a set-up for a mode of the joint model within so many of its standard deviations,"""
SAME_SHAPE = 0.8
"""and from this assurance on over the outputs of the set-up."""

Again = Callable[[Sequence[Record], Sequence[int] | None], Identification]
"""Identifies records, of which some may lack outputs, with these input delays or None for those that the data tell."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _SetUp:
    """Records that measured the same outputs with the same inputs at work.

    Attributes:
        members: indices of the records.
        inputs: indices of the inputs that moved in any of them.
        outputs: indices of the outputs that were measured.
    """

    members: tuple[int, ...]
    inputs: tuple[int, ...]
    outputs: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Agreement:
    """How the answer of one set-up to an input relates to that of the set-up before it.

    Attributes:
        delay: samples by which the input acts later here, over and above what both were corrected by.
        gain: of the answer at the references.
        gain_std: relative standard deviation of that.
        apart: names of references whose gains differ from that of the others, with their gains.
    """

    delay: int
    gain: float
    gain_std: float
    apart: tuple[str, ...]


def has_absent_outputs(records: Sequence[Record]) -> bool:
    """Whether an output that other records have holds no number in some record."""
    measured = np.array([np.isfinite(record.outputs).any(axis=0) for record in records])
    return bool((measured.any(axis=0) & ~measured).any())


def identify_setups(
    records: Sequence[Record], again: Again, *, decimation: int | None, input_delay: Sequence[int] | None = None
) -> Identification:
    """One modal model of all set-ups.

    Args:
        records: on the union of the channels (`okid.join_setups`), an absent output NaN throughout.
        again: identifies records at the time step that they have.
        decimation: as given, None to choose one for all set-ups.
        input_delay: (n_inputs,) samples of the records, None where the data tell.

    Raises:
        InvalidDataError: an output that no set-up with the same inputs has, or set-ups without inputs whose references
            do not connect them or which share no mode.
    """
    records, dead = living(records)
    setups = _setups(records)
    if records[0].n_inputs:
        _refuse_what_nobody_measured(records, setups)
    told = {} if decimation is not None else {"frequency band": "the widest band that a set-up asks for"}
    if input_delay is None and records[0].n_inputs:
        told["input delay"] = "the earliest that a set-up asks for; before, the inputs of each were moved by its own"
    if decimation is None:
        centred = [_own_channels(records, one) for one in setups]
        decimation = min(coherent_band([record.detrended() for record in own]).factor for own in centred)
    records = [record.decimated(decimation).detrended() for record in records]
    given = [None if input_delay is None else [input_delay[i] // decimation for i in one.inputs] for one in setups]
    results = [again(_own_channels(records, one), delays) for one, delays in zip(setups, given, strict=True)]
    if not records[0].n_inputs:
        found = _ambient(records, setups, results)
        return replace(found, choices=_told(found.choices, told), warnings=(*dead, *found.warnings))
    aligned, of_each, said, warnings = _aligned(records, setups, results)
    joint = again(aligned, _early(setups, results, records[0].n_inputs))
    reason = "one model of all, fitted to each output where it was measured and to each record by its own noise"
    if any(map(has_noise_model, results)):
        joint = _at_means(joint, setups, of_each)
        reason += "; poles and shapes are means of what set-ups tell, which have models of their own noise"
    measured = _measured(records, setups)
    reason += "; what a set-up did not measure was filled by a model, for residuals and pictures alone"
    choice = Choice(what="set-ups", value=f"{len(setups)}: {measured}", reason=reason)
    return replace(
        joint,
        choices=(joint.choices[0], choice, *said, *_told(joint.choices[1:], told)),
        warnings=(*dead, *warnings, *joint.warnings),
    )


def _told(choices: Sequence[Choice], reasons: Mapping[str, str]) -> tuple[Choice, ...]:
    """The choices, with the reasons of those that all set-ups made together: one identification was given them."""
    return tuple(replace(one, reason=reasons.get(one.what, one.reason)) for one in choices)


def _early(setups: Sequence[_SetUp], results: Sequence[Identification], n_inputs: int) -> list[int]:
    """(n_inputs,) delays below zero, the least that any set-up asks for: one model looks ahead in all of them."""
    asked = [dict(zip(one.inputs, own.input_delay, strict=True)) for one, own in zip(setups, results, strict=True)]
    return [min(0, *(own.get(i, 0) for own in asked)) for i in range(n_inputs)]


def _aligned(
    records: Sequence[Record], setups: Sequence[_SetUp], results: Sequence[Identification]
) -> tuple[list[Record], list[ModalModel], tuple[Choice, ...], tuple[str, ...]]:
    """Records whose inputs act at once and with one gain, and what such inputs drive in each set-up."""
    aligned, modes = list(records), [result.modes for result in results]
    choices: list[str] = []
    warnings: list[str] = []
    farthest = int(LONGEST_SHARE * min(run.n_samples for result in results for run in result.records))
    for k, one in enumerate(setups):
        found = [max(0, delay) for delay in results[k].input_delay]
        delays, gains = list(found), [1.0] * len(one.inputs)
        names = [records[0].input_names[i] for i in one.inputs]
        who = _named(records, one)
        for at, i in enumerate(one.inputs):
            agreed = _agreement(i, k, setups, modes, records[0].output_names, farthest=farthest)
            if agreed is None:
                continue
            partner, agreement = agreed
            delays[at] = max(0, delays[at] + agreement.delay)
            if abs(np.log(abs(agreement.gain))) > SAME_FREQUENCY * agreement.gain_std or agreement.gain < 0.0:
                gains[at] = agreement.gain
                warnings.append(
                    f"{who} answers {names[at]} {agreement.gain:.4g} times as much at the references as "
                    f"{_named(records, setups[partner])} does; its input was scaled by that. Look for a gain that was "
                    "changed: shapes are right, modal masses only if the first set-up's are."
                )
            if agreement.apart:
                warnings.append(
                    f"the references of {who} do not agree on its gain against {_named(records, setups[partner])}: "
                    f"{', '.join(agreement.apart)}. A sensor's gain or place was changed, so the parts of the shapes "
                    "are scaled wrong by as much; correct the records."
                )
        if any(delays):
            late = [f"{name} {d} samples" for name, d in zip(names, delays, strict=True) if d]
            choices.append(f"{who}: {', '.join(late)}")
        for member, record in zip(one.members, _corrected(records, one, delays, gains), strict=True):
            aligned[member] = record
        modes[k] = _driven_by_aligned(modes[k], np.subtract(delays, found, dtype=float), np.array(gains))
    if not choices:
        return aligned, modes, (), tuple(warnings)
    choice = Choice(
        what="input delays of set-ups",
        value="; ".join(choices),
        reason="taken out of each set-up's records, so that one model answers all of them",
    )
    return aligned, modes, (choice,), tuple(warnings)


def _driven_by_aligned(modes: ModalModel, later: FloatArray, gains: FloatArray) -> ModalModel:
    """The modes as inputs drive them that act so many samples later and are so many times as large."""
    driven = tuple(
        replace(mode, participation=mode.participation * np.exp(mode.pole * modes.dt * later) / gains)
        for mode in modes.modes
    )
    return replace(modes, modes=driven)


def _corrected(records: Sequence[Record], one: _SetUp, delays: Sequence[int], gains: Sequence[float]) -> list[Record]:
    whole, factors = [0] * records[0].n_inputs, np.ones(records[0].n_inputs)
    for i, delay, gain in zip(one.inputs, delays, gains, strict=True):
        whole[i], factors[i] = delay, gain
    late = late_inputs([records[member] for member in one.members], whole)
    return [replace(record, inputs=record.inputs * factors) for record in late]


def _agreement(
    i: int,
    k: int,
    setups: Sequence[_SetUp],
    modes: Sequence[ModalModel],
    output_names: Sequence[str],
    *,
    farthest: int,
) -> tuple[int, _Agreement] | None:
    """How input i acts in set-up k against the earlier one with most references; None where there is none."""
    shared = [(len(set(setups[p].outputs) & set(setups[k].outputs)), -p) for p in range(k) if i in setups[p].inputs]
    if not shared or max(shared)[0] == 0:
        return None
    partner = -max(shared)[1]
    references = [o for o in setups[k].outputs if o in setups[partner].outputs]
    quotients, variances, angular = [], [], []
    for mode in modes[k].system:
        rows, others = _places(setups[k], references), _places(setups[partner], references)
        own = _same(mode, rows, modes[partner], others)
        if own is None or mode.kind != "oscillatory" or own.mass_std is None or mode.mass_std is None:
            continue
        here, there = setups[k].inputs.index(i), setups[partner].inputs.index(i)
        quotients.append(mode.shape[rows] * mode.participation[here] / (own.shape[others] * own.participation[there]))
        variances.append(mode.mass_std[rows, here] ** 2 + own.mass_std[others, there] ** 2)
        angular.append(mode.pole.imag * modes[k].dt)
    if not quotients:
        return None
    delay, sign, level, spread = delay_between(
        np.array(quotients), np.array(variances), np.array(angular), longest=farthest
    )
    middle = float(np.median(level))
    apart = tuple(
        f"{output_names[o]} {np.exp(own):.4g} times"
        for o, own, std in zip(references, level, spread, strict=True)
        if abs(own - middle) > SAME_FREQUENCY * np.hypot(std, float(spread.min()))
    )
    gain_std = float((spread**-2.0).sum() ** -0.5)
    agreement = _Agreement(delay=delay, gain=sign * float(np.exp(middle)), gain_std=gain_std, apart=apart)
    return partner, agreement


def _setups(records: Sequence[Record]) -> list[_SetUp]:
    groups: dict[tuple[tuple[int, ...], tuple[int, ...]], list[int]] = {}
    for index, record in enumerate(records):
        moving = np.flatnonzero(np.nanmax(record.inputs, axis=0) > np.nanmin(record.inputs, axis=0))
        seen = np.flatnonzero(np.isfinite(record.outputs).any(axis=0))
        groups.setdefault((tuple(moving.tolist()), tuple(seen.tolist())), []).append(index)
    return [_SetUp(members=tuple(own), inputs=key[0], outputs=key[1]) for key, own in groups.items()]


def _refuse_what_nobody_measured(records: Sequence[Record], setups: Sequence[_SetUp]) -> None:
    for one in setups:
        known = {o for other in setups if set(one.inputs) <= set(other.inputs) for o in other.outputs}
        left = [repr(name) for o, name in enumerate(records[0].output_names) if o not in known]
        if left:
            raise InvalidDataError(
                f"no set-up measured {', '.join(left)} with the inputs of {_named(records, one)} at work; rove sensors "
                "or hammer, not both at once, or keep one input through all set-ups."
            )


def _named(records: Sequence[Record], one: _SetUp) -> str:
    return ", ".join(records[i].name or f"record {i}" for i in one.members)


def _measured(records: Sequence[Record], setups: Sequence[_SetUp]) -> str:
    names = records[0].output_names
    return "; ".join(f"{_named(records, one)}: {', '.join(names[o] for o in one.outputs)}" for one in setups)


def _places(one: _SetUp, outputs: Sequence[int]) -> list[int]:
    """Where outputs stand among those of a set-up."""
    return [one.outputs.index(o) for o in outputs]


def _own_channels(records: Sequence[Record], one: _SetUp) -> list[Record]:
    return [records[i].select(inputs=one.inputs, outputs=one.outputs) for i in one.members]


def _at_means(joint: Identification, setups: Sequence[_SetUp], of_each: Sequence[ModalModel]) -> Identification:
    """The joint result with its modes at the means of what the set-ups give."""
    modes = tuple(_at_mean(mode, setups, of_each) for mode in joint.modes)
    uncertainty, n_outputs = joint.uncertainty, len(joint.modes.output_names)
    if uncertainty is not None:
        shapes = [np.full(n_outputs, np.nan) if mode.shape_std is None else mode.shape_std for mode in modes]
        uncertainty = replace(
            uncertainty,
            frequency_std=np.array([mode.frequency_std for mode in modes]),
            damping_ratio_std=np.array([mode.damping_ratio_std for mode in modes]),
            shape_std=np.array(shapes).reshape(len(modes), n_outputs),
            markov_std=np.full(uncertainty.markov_std.shape, np.nan),
        )
    warnings = tuple(text for text in joint.warnings if not text.startswith(NOISE_UNKNOWN))
    return replace(joint, modes=replace(joint.modes, modes=modes), uncertainty=uncertainty, warnings=warnings)


def _at_mean(mode: Mode, setups: Sequence[_SetUp], of_each: Sequence[ModalModel]) -> Mode:
    """A mode of the joint model at the mean of what the set-ups give, by information; its own where none has it.

    The joint participations bring the parts of the shape to one scale.
    """
    gained, sums = np.zeros(mode.shape.size), np.zeros(mode.shape.size, dtype=np.complex128)
    pairs = zip(setups, of_each, strict=True)
    found = [_same(mode, one.outputs, modes, range(len(one.outputs))) for one, modes in pairs]
    for one, own in zip(setups, found, strict=True):
        joint = mode.participation[list(one.inputs)]
        if own is None or own.shape_std is None or not joint.any():
            continue
        outputs = list(one.outputs)
        scale = complex(np.vdot(joint, own.participation) / np.vdot(joint, joint))
        weight = (abs(scale) * np.maximum(_spread(own), np.finfo(np.float64).tiny)) ** -2.0
        gained[outputs] += weight
        sums[outputs] += weight * scale * own.shape
    sure = [own for own in found if own is not None and own.frequency_std > 0.0 and own.damping_ratio_std > 0.0]
    frequency, frequency_std = mean_by_information([own.frequency for own in sure], [own.frequency_std for own in sure])
    damping, damping_std = mean_by_information(
        [own.damping_ratio for own in sure], [own.damping_ratio_std for own in sure]
    )
    if not sure:
        frequency, damping = mode.frequency, mode.damping_ratio
    known = bool((gained > 0.0).all())
    shape = sums / gained if known else mode.shape
    largest = int(np.abs(shape).argmax())
    shape_std = gained**-0.5 / abs(shape[largest]) if known else np.zeros(0)
    shape_std[largest : largest + 1] = 0.0
    pole = 2.0 * np.pi * frequency * complex(-damping, np.sqrt(max(0.0, 1.0 - damping**2)))
    return replace(
        mode,
        pole=pole if sure and mode.kind == "oscillatory" else mode.pole,
        frequency=frequency,
        damping_ratio=damping,
        frequency_std=frequency_std,
        damping_ratio_std=damping_std,
        shape=shape / shape[largest],
        participation=mode.participation * shape[largest],
        shape_std=shape_std if known else None,
    )


def _same(mode: Mode, rows: Sequence[int], modes: Iterable[Mode], others: Sequence[int]) -> Mode | None:
    """The mode of another result that this one is, by frequency and the shapes at the same outputs.

    Args:
        mode: of another result.
        rows: its outputs that both measured.
        modes: among which it is looked for.
        others: the same outputs there.
    """
    near = []
    for other in modes:
        std = np.hypot(other.frequency_std, np.nan_to_num(mode.frequency_std))
        # without an interval: within the half-power band
        reach = SAME_FREQUENCY * std if np.isfinite(std) else other.damping_ratio * other.frequency
        alike = assurance(other.shape[list(others)][:, np.newaxis], mode.shape[list(rows)][:, np.newaxis])[0, 0]
        known = other.kind == mode.kind and other.verdict != "noise"
        if known and abs(other.frequency - mode.frequency) <= reach and alike >= SAME_SHAPE:
            near.append(other)
    return min(near, key=lambda other: abs(other.pole - mode.pole), default=None)


def _ambient(records: Sequence[Record], setups: Sequence[_SetUp], results: Sequence[Identification]) -> Identification:
    """The modes that all set-ups found, their parts scaled by the references."""
    joined: list[Mode] = []
    alone: list[str] = []
    free = [list(result.modes) for result in results]  # the surest choose first, and no mode is another's too
    for mode in sorted(results[0].modes, key=lambda mode: -mode.probability):
        if mode.kind != "oscillatory" or mode.verdict == "noise":
            continue
        found = _followed(mode, records, setups, free)
        if isinstance(found, Mode):
            joined.append(found)
        else:
            alone.append(f"{mode.frequency:.4g} Hz (not in {found})")
    for one, result in zip(setups[1:], results[1:], strict=True):
        rows, seen = _places(one, one.outputs), list(one.outputs)
        own = [mode for mode in result.modes.system if _same(mode, rows, joined, seen) is None]
        alone += [f"{mode.frequency:.4g} Hz (only in {_named(records, one)})" for mode in own]
    if not joined:
        raise IdentificationError(
            f"the {len(setups)} set-ups have no mode in common ({'; '.join(alone) or 'the first has none'}); record "
            "each for longer, or identify each set-up by itself."
        )
    first = results[0]
    modes = ModalModel(
        modes=tuple(sorted(joined, key=lambda mode: mode.frequency)),
        dt=first.modes.dt,
        indicator_caution=first.modes.indicator_caution,
        indicators_missing="each set-up has its own: those of the first are shown",
        output_names=records[0].output_names,
        output_units=records[0].output_units,
    )
    measured = _measured(records, setups)
    warnings = []
    if alone:
        warnings.append(f"Modes that not every set-up found were left out: {'; '.join(alone)}.")
    everywhere = [text for text in first.warnings if all(text in result.warnings for result in results)]
    warnings += everywhere
    for one, result in zip(setups, results, strict=True):
        warnings += [f"{_named(records, one)}: {text}" for text in result.warnings if text not in everywhere]
    choice = Choice(
        what="set-ups",
        value=f"{len(setups)}: {measured}",
        reason="each was identified by its outputs alone, poles and shapes are averages, and the references scale what "
        "the others saw; what a set-up did not measure was made of its own modal states, so it tells nothing new",
    )
    model = output_model(modes)
    placed = [with_absent_outputs(result, modes, one.outputs) for one, result in zip(setups, results, strict=True)]
    predicted = tuple(record for _, some in placed for record in some)
    return replace(
        first,
        records=tuple(record for some, _ in placed for record in some),
        simulated=predicted,
        predicted=predicted,
        observer=None,
        residuals=None,
        excitation=None,
        markov=MarkovParameters(system=np.zeros((2, model.n_outputs, 0)), dt=model.dt),
        realisation=model,
        fitted_model=model,
        modes=modes,
        choices=(first.choices[0], choice, *first.choices[1:]),
        fit=mean_fit([result.fit for result in results], [one.outputs for one in setups], model.n_outputs),
        warnings=tuple(warnings),
        uncertainty=Uncertainty(
            method="output error",
            frequency_std=np.array([mode.frequency_std for mode in modes]),
            damping_ratio_std=np.array([mode.damping_ratio_std for mode in modes]),
            shape_std=np.array(
                [np.full(model.n_outputs, np.nan) if mode.shape_std is None else mode.shape_std for mode in modes]
            ),
            markov_std=np.zeros((2, model.n_outputs, 0)),
        ),
        innovations=None,
        innovation_covariance=None,
    )


def _followed(
    mode: Mode, records: Sequence[Record], setups: Sequence[_SetUp], free: Sequence[list[Mode]]
) -> Mode | str:
    """The mode through all set-ups, taken out of the free modes of each, or the name of a set-up that has none."""
    n_outputs = records[0].n_outputs
    shape = np.zeros(n_outputs, dtype=np.complex128)
    information = np.zeros(n_outputs)
    seen: dict[int, Mode] = {}
    left = list(range(len(setups)))
    while left:
        k = max(left, key=lambda k: (int((information[list(setups[k].outputs)] > 0).sum()), -k))
        references = [o for o in setups[k].outputs if information[o] > 0]
        one, rows = setups[k], list(setups[k].outputs)
        if not seen:
            own, scale, scale_std = mode, 1.0 + 0.0j, 0.0
        else:
            if not references:
                raise InvalidDataError(
                    f"{_named(records, one)} shares no sensor with the other set-ups, so its parts of the shapes "
                    "cannot be scaled to theirs; keep a reference sensor in its place."
                )
            known = replace(mode, shape=shape)
            found = _same(known, references, free[k], _places(one, references))
            if found is None:
                return _named(records, one)
            own = found
            here = own.shape[_places(one, references)]
            weight = 1.0 / (_spread(own)[_places(one, references)] ** 2 + 1.0 / information[references])
            norm = (weight * np.abs(here) ** 2).sum()
            scale = complex((weight * here.conj() * shape[references]).sum() / norm)
            scale_std = float(norm**-0.5)
        seen[k] = own
        part = own.shape * scale
        variance = (abs(scale) * _spread(own)) ** 2 + np.abs(own.shape * scale_std) ** 2
        gained = 1.0 / np.maximum(variance, np.finfo(float).tiny)
        shape[rows] = (shape[rows] * information[rows] + part * gained) / (information[rows] + gained)
        information[rows] += gained
        left.remove(k)
    for k, own in seen.items():
        free[k].remove(own)
    together = sum(max(records[member].duration for member in setups[k].members) for k in seen)
    return _averaged(mode, list(seen.values()), shape, information, dt=records[0].dt, duration=together)


def _spread(mode: Mode) -> FloatArray:
    """(n_outputs,) deviation of the components, also of the largest; one for all where none is known."""
    if mode.shape_std is None or not np.isfinite(mode.shape_std).all() or not mode.shape_std.any():
        return np.full(mode.shape.size, 1.0 / np.sqrt(mode.shape.size))
    largest = float(mode.shape_std.max())
    spread: FloatArray = np.where(mode.shape_std > 0.0, mode.shape_std, largest)
    return spread


def _averaged(
    mode: Mode, found: Sequence[Mode], shape: ComplexArray, information: FloatArray, *, dt: float, duration: float
) -> Mode:
    """One mode of those of all set-ups: pole by information, and the verdict that half of them reach at least.

    Their log-odds are not added: what makes a false pole in one set-up, such as the colour of the forces, makes it in
    all, so they are no independent evidence; and on 34 chains that found 163 of 170 modes instead of 162.

    Doubts that a pole raises by itself are asked of the joint pole over the `duration` of all set-ups [s]: of its
    damping they tell as much as one record so long.
    """
    frequency, frequency_std = mean_by_information(
        [one.frequency for one in found], [one.frequency_std for one in found]
    )
    # each deviation at its own estimate: a mean of 1 / damping, as one fit of all gives, and not drawn up by short ones
    damping, damping_std = mean_by_information(
        [one.damping_ratio for one in found], [one.damping_ratio_std for one in found]
    )
    largest = int(np.abs(shape).argmax())
    by_certainty = sorted(map(_by_data, found), key=lambda one: one.probability)
    weakest, middle = by_certainty[0], by_certainty[(len(found) - 1) // 2]
    shape_std = information**-0.5 / abs(shape[largest])
    shape_std[largest] = 0.0
    told = [one.damping_resolved or one.damping_ratio_std > SPREAD * one.damping_ratio for one in found]
    joint = replace(
        mode,
        pole=2.0 * np.pi * frequency * complex(-damping, np.sqrt(max(0.0, 1.0 - damping**2))),
        frequency=frequency,
        damping_ratio=damping,
        frequency_std=frequency_std,
        damping_ratio_std=damping_std,
        shape=shape / shape[largest],
        shape_std=shape_std if all(one.shape_std is not None for one in found) else None,
        mass_std=None,
        probability=middle.probability,
        verdict=middle.verdict,
        doubts=middle.doubts,
        damping_resolved=all(told) and damping_std <= SPREAD * damping,
        repeatability=min(one.repeatability for one in found),
    )
    words = [f"found in all {len(found)} set-ups"]
    doubts = (*undriven_doubt(joint, np.nan, duration), *pole_doubts(joint, dt))
    if joint.verdict == "system" and doubts:
        words += doubts
        joint = replace(
            joint,
            verdict="doubtful",
            probability=min(joint.probability, DOUBTED),
            doubts=tuple(("pole", doubt) for doubt in doubts),
        )
    elif weakest.verdict != "system":
        words.append(f"the least sure of them: {weakest.reason}")
    return replace(joint, reason="; ".join(words))


def _by_data(mode: Mode) -> Mode:
    """The mode of a set-up without the doubts that its pole alone raises."""
    left = tuple(doubt for doubt in mode.doubts if doubt[0] == "data")
    if left or not mode.doubts:
        return replace(mode, doubts=left)
    return replace(mode, verdict="system", probability=probability(mode.repeatability), doubts=())
