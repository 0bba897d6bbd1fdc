"""Roving sensors: several set-ups, each of which measured some of the outputs, as one modal model.

Each set-up is identified by itself. What it did not measure is simulated by the model of a set-up that did, driven by
its own inputs and started from its own references, so that a level of its own costs nothing; then one model is fitted
to all records with all channels. What is simulated brings no new information, but makes the errors look small, so the
deviations of the joint model are those of the set-ups together: information adds,

    1 / var = sum over set-ups of 1 / var_s
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from era.simulation import estimate_initial_state, simulate
from modal.identification.result import Identification
from modal.modes.choice import Choice
from modal.modes.mode import Mode
from modal.modes.shape_sets import assurance
from modal.preparation.band import coherent_band
from okid.arrays import FloatArray
from okid.errors import InvalidDataError
from okid.record import Record

__all__ = ["has_absent_outputs", "identify_setups"]

SAME_FREQUENCY = 6.0
"""Take a pole of a set-up for a mode of the joint model within so many of its standard deviations,"""
SAME_SHAPE = 0.8
"""and from this assurance on over the outputs of the set-up."""


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


def has_absent_outputs(records: Sequence[Record]) -> bool:
    """Whether an output that other records have holds no number in some record."""
    return any(not np.isfinite(record.outputs).any(axis=0).all() for record in records)


def identify_setups(
    records: Sequence[Record], again: Callable[[Sequence[Record], int], Identification], *, decimation: int | None
) -> Identification:
    """One modal model of all set-ups.

    Args:
        records: on the union of the channels (`okid.join_setups`), an absent output NaN throughout.
        again: identifies records that have all their channels, with a decimation.
        decimation: as given, None to choose one for all set-ups.

    Raises:
        InvalidDataError: no input was measured, or an output that no set-up with the same inputs has.
    """
    if not records[0].n_inputs:
        raise InvalidDataError(
            "set-ups of roving sensors are joined by what the inputs make of them, but no input was measured; identify "
            "each set-up by itself, or measure an input."
        )
    setups = _setups(records)
    if decimation is None:
        centred = [_own_channels(records, one) for one in setups]
        decimation = min(coherent_band([record.detrended() for record in own]).factor for own in centred)
    records = [record.decimated(decimation).detrended() for record in records]
    results = [again(_own_channels(records, one), 1) for one in setups]
    filled = list(records)
    for one in setups:
        absent = [o for o in range(records[0].n_outputs) if o not in one.outputs]
        for member in one.members:
            filled[member] = _completed(records[member], one, absent, setups, results)
    joint = again(filled, 1)
    return _with_joint_deviations(joint, records, setups, results)


def _setups(records: Sequence[Record]) -> list[_SetUp]:
    groups: dict[tuple[tuple[int, ...], tuple[int, ...]], list[int]] = {}
    for index, record in enumerate(records):
        moving = np.flatnonzero(np.nanmax(record.inputs, axis=0) > np.nanmin(record.inputs, axis=0))
        seen = np.flatnonzero(np.isfinite(record.outputs).any(axis=0))
        groups.setdefault((tuple(moving.tolist()), tuple(seen.tolist())), []).append(index)
    return [_SetUp(members=tuple(own), inputs=key[0], outputs=key[1]) for key, own in groups.items()]


def _own_channels(records: Sequence[Record], one: _SetUp) -> list[Record]:
    return [records[i].select(inputs=one.inputs, outputs=one.outputs) for i in one.members]


def _completed(
    record: Record,
    own: _SetUp,
    absent: Sequence[int],
    setups: Sequence[_SetUp],
    results: Sequence[Identification],
) -> Record:
    """The record with every absent output simulated by a model that has it, the one with most outputs in common."""
    outputs = np.array(record.outputs)
    left = set(absent)
    alike = sorted(range(len(setups)), key=lambda k: -len(set(setups[k].outputs) & set(own.outputs)))
    for k in alike:
        other = setups[k]
        wanted = left.intersection(other.outputs)
        if not wanted or not set(own.inputs) <= set(other.inputs):
            continue
        model = results[k].realisation
        seen = record.select(inputs=other.inputs, outputs=other.outputs)
        shared = np.isfinite(seen.outputs).any()
        state = estimate_initial_state(model, seen) if shared else None
        run = simulate(model, seen, initial_state=state).outputs
        for o in wanted:
            outputs[:, o] = run[:, other.outputs.index(o)]
        left -= wanted
    if left:
        names = ", ".join(repr(record.output_names[o]) for o in sorted(left))
        raise InvalidDataError(
            f"no set-up measured {names} with the inputs of {record.name or 'each record'} at work; rove sensors or "
            "hammer, not both at once, or keep one input through all set-ups."
        )
    return replace(record, outputs=outputs)


def _with_joint_deviations(
    joint: Identification, records: Sequence[Record], setups: Sequence[_SetUp], results: Sequence[Identification]
) -> Identification:
    modes = tuple(_with_deviations(mode, setups, results) for mode in joint.modes)
    uncertainty = joint.uncertainty
    if uncertainty is not None:
        n_outputs = records[0].n_outputs
        shapes = [np.full(n_outputs, np.nan) if mode.shape_std is None else mode.shape_std for mode in modes]
        uncertainty = replace(
            uncertainty,
            frequency_std=np.array([mode.frequency_std for mode in modes]),
            damping_ratio_std=np.array([mode.damping_ratio_std for mode in modes]),
            shape_std=np.array(shapes).reshape(len(modes), n_outputs),
            markov_std=np.full(uncertainty.markov_std.shape, np.nan),
        )
    said = [
        f"{', '.join(records[i].name or str(i) for i in one.members)}: "
        + ", ".join(records[0].output_names[o] for o in one.outputs)
        for one in setups
    ]
    choice = Choice(
        what="set-ups",
        value=f"{len(setups)}: {'; '.join(said)}",
        reason="outputs that a set-up lacks are simulated by the model of one that has them; deviations are those of "
        "all set-ups together",
    )
    warning = (
        f"Not every set-up measured every output: {'; '.join(said)}. What is missing was simulated, so fits and "
        "residuals look better than the measured samples alone allow; intervals are those of all set-ups together."
    )
    return replace(
        joint,
        modes=replace(joint.modes, modes=modes),
        uncertainty=uncertainty,
        choices=(joint.choices[0], choice, *joint.choices[1:]),
        warnings=(warning, *joint.warnings),
    )


def _with_deviations(mode: Mode, setups: Sequence[_SetUp], results: Sequence[Identification]) -> Mode:
    """Deviations of a mode of the joint model from those of the same mode in the set-ups; nan where none has it."""
    information = np.zeros(2)
    shape_information = np.zeros(mode.shape.size)
    for one, result in zip(setups, results, strict=True):
        own = _same(mode, one, result)
        if own is None:
            continue
        for k, std in enumerate((own.frequency_std, own.damping_ratio_std)):
            information[k] += 1.0 / std**2 if std > 0.0 else 0.0
        if own.shape_std is not None:
            outputs = list(one.outputs)
            # a set-up's largest component is 1 by definition: on the joint scale it is as uncertain as the others
            deviation = np.where(own.shape_std > 0.0, own.shape_std, own.shape_std.max())
            deviation = deviation * np.abs(mode.shape[outputs[int(np.abs(own.shape).argmax())]])
            shape_information[outputs] += np.where(deviation > 0.0, deviation, np.inf) ** -2.0
    deviations = _deviation(information)
    shape = _deviation(shape_information)
    shape[np.abs(mode.shape).argmax()] = 0.0
    return replace(
        mode,
        frequency_std=float(deviations[0]),
        damping_ratio_std=float(deviations[1]),
        shape_std=shape if np.isfinite(shape).all() else None,
    )


def _deviation(information: FloatArray) -> FloatArray:
    with np.errstate(divide="ignore"):
        result: FloatArray = np.where(information > 0.0, information**-0.5, np.nan)
    return result


def _same(mode: Mode, one: _SetUp, result: Identification) -> Mode | None:
    """The mode of a set-up that this one is; None where it has none."""
    near = [
        other
        for other in result.modes
        if other.kind == mode.kind
        and other.verdict != "noise"
        and abs(other.frequency - mode.frequency) <= SAME_FREQUENCY * other.frequency_std
        and assurance(other.shape[:, np.newaxis], mode.shape[list(one.outputs)][:, np.newaxis])[0, 0] >= SAME_SHAPE
    ]
    return min(near, key=lambda other: abs(other.pole - mode.pole), default=None)
