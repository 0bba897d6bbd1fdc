"""From records to modes in one call, every choice made by the data and explained.

Prepare (means, band) -> search (observer order, ridge, model order by held-out free run) -> fit all rows -> recover ->
realise -> modes -> judge by repeatability -> say in words what the data do not carry.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np

from era.kalman import check_innovations
from era.realisation import Realisation
from era.simulation import simulate
from modal.estimation.cross_validation import WITHIN, Folds, Trial
from modal.estimation.feedback import FALSE_ALARMS, from_outside
from modal.estimation.fits import measure_fit, model_runs
from modal.identification.final_model import FinalModel, fit_all_rows, lack_outputs, with_deviations, with_forces
from modal.identification.more_modes import with_undriven
from modal.identification.noise_model import with_feedback
from modal.identification.order_search import MOST_STEPS, Search, choose_orders, given_orders
from modal.identification.refined_search import refined_search
from modal.identification.response_road import identify_response
from modal.identification.result import Identification
from modal.identification.set_ups import has_absent_outputs, identify_setups
from modal.identification.white_noise import White, in_white
from modal.identification.words import (
    blows_apart,
    explain_filter,
    explain_gain,
    explain_noise,
    explain_scoring,
    explain_search,
    noise_words,
    order_evidence,
    records_apart,
    warnings_in_words,
)
from modal.modes.extraction import extract_modes
from modal.preparation.amplitude import distortion_at_modes
from modal.preparation.band import chance_at_modes, missed_share
from modal.preparation.delay import (
    LONGEST_SHARE,
    check_delay_word,
    delay_of_phases,
    given_input_delay,
    late_and_early,
    loop_p_value,
)
from modal.preparation.faults import Mended, free_of_clipping, living, mended
from modal.preparation.filling import refilled
from modal.preparation.kind import GivenKind, KindFound, RecordKind, acting_in, find_kind, given_kind
from modal.preparation.quick_model import left_alone_and_together
from modal.preparation.rest import RELEASED, released
from modal.preparation.steps import Preparation, prepare
from modal.verdict.constancy import fading, unsteady_drive, with_changes
from modal.verdict.excitation import between_lines, beyond_inputs, by_chance, driven_gain, ringing
from modal.verdict.filled import filled_words, seen_alone, told_where_measured
from modal.verdict.judgement import Answer, judge
from modal.verdict.linearity import Powers, powers_of_motion
from modal.verdict.probability import FILTER_EDGE
from modal.verdict.repeatability import repeat
from modal.verdict.resonance import standing_out, told_of_lines_beside, told_of_steady_lines
from modal.verdict.ring_down import told_of_ring_down
from okid.arrays import BoolArray, FloatArray, listener, one_blas_thread, whole_number
from okid.errors import IdentificationError, InvalidDataError
from okid.excitation import check_excitation
from okid.frequency_response import FrequencyResponse
from okid.readers.guard import MEMORY_SHARE, memory_budget
from okid.record import Record
from okid.residuals import ResidualCheck, check_residuals
from okid.rows import as_records, bytes_in_memory, refuse_copies, spread_stretches

ITEM = np.dtype(float).itemsize
COPIES = 14
"""Expect a peak of so many copies of the records used (a whole run took 14.4 on 1e7 samples of 8 channels); while all
rows are looked at, records stay where they are, in memory or in a mapped file."""
BEFORE_RECORDS = 0.6 * 2**30
"""Add so many bytes of libraries and report: 0.62 GiB in all at 1e5 x 8, 1.28 at 1e6 x 8."""
SECONDS_A_VALUE = (4e-6, 8e-5)
"""Expect so many CPU seconds a value used: 26 s at 1e6 x 8 in white noise, 1041 s at 1.6e6 x 8 with states of noise."""
FITTING, FITTED, WHITENED = 0.4, 0.8, 0.85
"""Tell so much as behind before and after the fit to all rows, which takes half of the time of a long record, and after
what is done where its noise is white."""
MOST_MEMORY = 1.5e9
"""Bytes above which stretches stand for the records, whatever the machine has: all machines give the same result."""


def expected_work(records: Sequence[Record]) -> tuple[tuple[float, float], float]:
    """CPU seconds, least and most, and bytes that `identify` will take, about.

    Example:
        >>> seconds, n_bytes = expected_work([Record([], np.zeros((4000, 2)), 0.01)])
        >>> seconds[1] < 1.0, f"{n_bytes / 2**30:.2f} GiB"
        (True, '0.60 GiB')
    """
    a_copy = sum(one.n_samples for one in records) * (records[0].n_inputs + records[0].n_outputs) * ITEM
    used = min(a_copy, MOST_MEMORY / COPIES)
    least, most = (seconds * used / ITEM for seconds in SECONDS_A_VALUE)
    return (least, most), BEFORE_RECORDS + COPIES * used + max(0.0, bytes_in_memory(records) - used)


def identify(
    records: Record | Sequence[Record] | FrequencyResponse,
    *,
    observer_order: int | Literal["auto"] = "auto",
    ridge: float | Literal["auto"] = "auto",
    order: int | Literal["auto"] = "auto",
    decimation: int | Literal["auto"] = "auto",
    refinement: Literal["auto", "none"] = "auto",
    missing: Literal["fill", "leave"] = "fill",
    integrators: int | Literal["auto"] = "auto",
    input_delay: int | Sequence[int] | Literal["auto"] = "auto",
    drift: int | Literal["auto", "none", "linear"] = "auto",
    kind: GivenKind = "auto",
    progress: Callable[[str, float], None] | None = None,
) -> Identification:
    """Identify the modes of one system from one record or several; nothing needs to be chosen.

    Observer order, ridge and model order are chosen together by the error of a free run on held-out rows; what is
    given as an argument is kept.

    Args:
        records: one `Record` or several of one system (same channels, units and time step; set-ups with other sensors
            or hammers come from `okid.join_setups`), or one table of frequency responses (`okid.FrequencyResponse`): of
            the other arguments only `order` and `progress` concern one.
        observer_order: number of past samples that the observer uses.
        ridge: regularisation relative to the unit diagonal of the Gram matrix of the scaled channels.
        order: number of states of the model.
        decimation: keep every so-manieth sample after an anti-alias filter; "auto" keeps the band in which the outputs
            follow the inputs.
        refinement: "auto" refines by output error as far as held-out rows gain by it; "none" leaves the model as OKID
            and ERA give it.
        missing: "fill" missing outputs by a model of the rest where they leave too few whole rows, or "leave" them.
        integrators: number of times that the system sums its inputs (0, 1 or 2).
        input_delay: samples by which inputs act late, one number or one an input; below zero early, for inputs that
            move between their samples.
        drift: "none", "linear", or a number of slow functions taken off each channel (1 a line, 2 a parabola, more:
            half-waves).
        kind: "driven" (inputs move throughout), "transient" (they act in short events), "decay" (no input, each record
            rings down) or "ambient" (no input); "auto" lets the data say it.
        progress: called as `progress(what, share_done)` while it works.

    Returns:
        Every stage from the prepared records to the judged modes, and why each choice was made.

    Raises:
        InvalidDataError: records that do not belong together or are not of one kind, an argument outside its range, or
            records too large for the memory that this process may have.
        InsufficientDataError: a constant channel, or records too short to fit any observer.

    References:
        Juang, Phan, Horta, Longman, J. Guidance, Control, and Dynamics 16(2), 1993, doi 10.2514/3.21006 (OKID).
        Juang, Pappa, J. Guidance, Control, and Dynamics 8(5), 1985, doi 10.2514/3.20031 (ERA).

    Example:
        >>> import numpy as np, scipy.signal
        >>> from okid.record import Record
        >>> rng = np.random.default_rng(1)
        >>> force = rng.standard_normal(2000)
        >>> pole = np.exp((-0.02 + 1j) * 2 * np.pi * 5.0 * 0.02)  # 5 Hz, 2 % damping, 50 samples a second
        >>> tip = scipy.signal.lfilter([0, 1.0], [1, -2 * pole.real, abs(pole) ** 2], force)
        >>> result = identify(Record(force, tip + 0.01 * rng.standard_normal(2000), 0.02, output_names=["tip"]))
        >>> [f"{mode.frequency:.2f} Hz, {mode.verdict}" for mode in result.modes.system]
        ['5.00 Hz, system']
    """
    if isinstance(records, FrequencyResponse):
        if given_kind(kind) not in {"auto", "response"}:
            raise InvalidDataError(
                f'kind="{kind}" is for records in time, but frequency responses were given; leave it out.'
            )
        return identify_response(records, order=order, progress=progress)
    given_orders(observer_order, ridge, order)
    if refinement not in ("auto", "none"):
        raise InvalidDataError(f'refinement must be "auto" or "none", but is {refinement!r}.')
    if decimation != "auto":
        decimation = whole_number(decimation, name="decimation", least=1, otherwise='or "auto"')
    check_delay_word(input_delay)
    several = as_records(records)
    refuse_copies(several)
    once = partial(
        _with_delays,
        observer_order=observer_order,
        ridge=ridge,
        order=order,
        refinement=refinement,
        missing=missing,
        integrators=integrators,
        drift=drift,
    )
    if has_absent_outputs(several):

        def again(parts: Sequence[Record], delays: Sequence[int] | None) -> Identification:
            gaps = "fill" if has_absent_outputs(parts) else missing  # else no row is whole, and no observer starts
            own = partial(once, parts, decimation=1, kind=kind, progress=None, missing=gaps)
            return _of_one_system(parts, own) if delays is None else own(input_delay=delays)

        given = None if isinstance(input_delay, str) else given_input_delay(input_delay, several[0]).samples
        return identify_setups(
            several, again, decimation=None if decimation == "auto" else decimation, input_delay=given
        )
    own = partial(once, several, decimation=decimation, kind=kind, progress=progress)
    result = _of_one_system(several, own) if isinstance(input_delay, str) else own(input_delay=input_delay)
    if order != "auto":
        return result
    itself = partial(once, observer_order="auto", ridge="auto", integrators=0, decimation=1, input_delay=0)
    return with_undriven(result, partial(itself, kind="ambient", progress=None))


def _of_one_system(records: Sequence[Record], once: Callable[..., Identification]) -> Identification:
    """From records that have all their channels, with the input delays that the modes show."""
    result = once(input_delay="auto")
    if not records[0].n_inputs:
        return result
    factor = round(result.records[0].dt / records[0].dt)
    return _with_real_modes(
        result, lambda delays: once(input_delay=[factor * delay for delay in delays], progress=None)
    )


def _with_delays(
    records: Sequence[Record],
    *,
    observer_order: int | Literal["auto"],
    ridge: float | Literal["auto"],
    order: int | Literal["auto"],
    decimation: int | Literal["auto"],
    refinement: Literal["auto", "none"],
    missing: Literal["fill", "leave"],
    integrators: int | Literal["auto"],
    input_delay: int | Sequence[int] | Literal["auto"],
    drift: int | Literal["auto", "none", "linear"],
    kind: GivenKind,
    progress: Callable[[str, float], None] | None,
) -> Identification:
    several, kind_found, mend = _within_memory(records, given_kind(kind))
    if kind_found.kind == "decay":
        several, mend = released(several, kind_found.starts), None
    with one_blas_thread():
        tell = listener(progress)
        tell("looking at the data", 0.0)
        preparation = prepare(
            several,
            decimation=decimation,
            missing=missing,
            integrators=integrators,
            input_delay=input_delay,
            drift=drift,
            kind=kind_found.kind,
            mend=mend,
        )
        measured = preparation.measured_if_filled
        found = choose_orders(
            preparation.records,
            observer_order=observer_order,
            ridge=ridge,
            order=order,
            folds=_folds(kind_found),
            measured=measured,
            progress=lambda done: tell("choosing observer, ridge and model order on held-out rows", 0.05 + 0.2 * done),
        ).evidence
        struck = acting_in(preparation.records) if kind_found.kind == "transient" else ()
        if refinement == "auto" and several[0].n_inputs:
            found = refined_search(
                found,
                acting=struck,
                at_rest=preparation.white_at_rest,
                progress=lambda done: tell("refining on held-out rows", 0.25 + 0.15 * done),
            )
        tell("fitting all rows", FITTING)
        # a few blows are no stationary input, of which the test could be asked
        alive = living(several)[0]
        suspected = kind_found.kind == "driven" and loop_p_value(alive) < FALSE_ALARMS

        def fitted(records: Sequence[Record]) -> tuple[Search, FinalModel]:
            return fit_all_rows(
                records,
                found,
                n_rest=sum(preparation.n_rest),
                refinement=refinement,
                feedback=suspected,
                measured=measured,
                acting=struck,
                at_rest=preparation.white_at_rest,
                progress=lambda done: tell("fitting all rows", FITTING + (FITTED - FITTING) * done),
            )

        taken, final = fitted(preparation.records)
        if measured:
            again = refilled(preparation.records, preparation.measured, final.realisation)
            preparation = replace(preparation, records=again)
            # a model of its noise needs every sample, as the model leaves it
            if not (final.leaves_nearly_white or lack_outputs(measured)):
                taken, final = fitted(again)
        preparation, final = with_forces(preparation, final)
        asked = refinement == "auto" and kind_found.kind == "driven" and not suspected
        asked = asked and not (measured and final.leaves_nearly_white)
        white, final = _in_white(
            preparation.records, taken, final, asked=asked, grows=order == "auto", measured=measured, tell=tell
        )
        return _identified(
            several,
            kind_found,
            preparation,
            taken,
            final=final,
            wanted=found.chosen,
            white=white,
            free=from_outside(alive) if suspected else (),
            tell=tell,
        )


def _in_white(
    records: Sequence[Record],
    found: Search,
    final: FinalModel,
    *,
    asked: bool,
    grows: bool,
    measured: Sequence[BoolArray],
    tell: Callable[[str, float], None],
) -> tuple[White | None, FinalModel]:
    """Where the noise of the model is white, if that was asked for and can be told, and the model that stands there."""
    if not asked or not records[0].n_inputs:
        return None, final
    words = "looking where the noise is white"

    def own(done: float) -> None:
        tell(words, FITTED + (WHITENED - FITTED) * done)

    again = in_white(records, found, final, grows=grows, measured=measured, progress=own)
    return (None, final) if again is None else again


def _identified(
    records: Sequence[Record],
    kind: KindFound,
    preparation: Preparation,
    found: Search,
    *,
    final: FinalModel,
    wanted: Trial,
    white: White | None = None,
    free: Sequence[Record] = (),
    tell: Callable[[str, float], None],
) -> Identification:
    """The modes of the final model judged, and all of it said in words.

    Where its noise was made white, the modes are judged on what is filtered: there each is found again, or not, by what
    stands beside it.
    """
    prepared, is_driven = preparation.records, kind.kind == "driven"
    asked, searched = (prepared, found) if white is None else (white.records, white.found)
    n_rest = preparation.n_rest
    observer, decomposition, model = final.observer, final.decomposition, final.realisation
    runs = model_runs(model, prepared)
    fit = measure_fit(searched.chosen, found.power, runs)
    tell("identifying again with other halves, orders and ridges", WHITENED)
    excitation = check_excitation(preparation.as_measured, order=observer.order)
    by_inputs = kind.kind in ("driven", "transient")  # a release is none that was measured
    steps = 0 if final.refined is None else searched.chosen.refinement_steps
    reruns = repeat(
        asked,
        observer_order=observer.order,
        ridge=observer.ridge,
        model_order=model.order,
        decomposition=decomposition,
        refinement_steps=steps if white is None else MOST_STEPS,  # there output errors are innovations
        folds=_folds(kind),
        refined=final.realisation,
        past=0 if final.noise is None else final.noise.past,
        grown="all" if white is not None else "half" if searched.chosen.weak_modes else "",
        measured=preparation.measured_if_filled if white is None else white.measured,
    )
    unjudged, uncertainty, inflation, moved = with_deviations(
        extract_modes(model), final, asked, measured_share=preparation.measured_share
    )
    left = runs.left
    left_there = left if white is None else model_runs(replace(model, K=None), asked).left
    lines = between_lines(unjudged, asked, left_there, output_scale=reruns.output_scale)
    missed = missed_share(prepared, left)
    # with the lines that were taken off: of one that wanders a little, the rest alone is not steady
    as_mended = [record.select(outputs=prepared[0].output_names) for record in preparation.mended]
    unsteady = unsteady_drive(prepared, left) if kind.kind == "ambient" else ()
    modes = judge(
        unjudged,
        reruns,
        gain=driven_gain(unjudged, asked, left_there),
        chance_line=by_chance(unjudged, asked, left_there) if by_inputs else None,
        lines=lines,
        beyond=beyond_inputs(unjudged, asked, left_there, output_scale=reruns.output_scale)
        if is_driven and prepared[0].n_inputs and lines is None
        else None,
        n_values=preparation.n_values,
        edge=FILTER_EDGE * 0.5 / prepared[0].dt if prepared[0].dt > 1.5 * records[0].dt else np.inf,
        missed=missed,
        observer_order=observer.order,
        ridge=observer.ridge,
        refinement_steps=searched.chosen.refinement_steps,
        duration=max(record.duration - n * record.dt for record, n in zip(prepared, n_rest, strict=True)),
        excitation=excitation if by_inputs else None,
        # averages in which nothing acts tell nothing of what follows
        chance=chance_at_modes(unjudged, prepared) if is_driven else None,
        ringing=ringing(unjudged, prepared, left) if kind.kind in ("transient", "decay") else None,
        rings_down=kind.kind == "decay",
        clipped=distortion_at_modes(unjudged, as_mended, steady=not unsteady) if kind.kind == "ambient" else None,
        height=standing_out(unjudged, prepared) if kind.kind == "ambient" else None,
        ahead=late_and_early(preparation.input_delay)[1],
    )
    fitted = final.refined is not None or final.noise is not None
    modes = told_where_measured(modes, prepared, left, preparation.measured, is_driven=is_driven, is_fitted=fitted)
    # what a blow does there is in no sample
    foretold = seen_alone(runs.predicted, final.apart) if final.apart else runs.predicted
    asked_of_kind = told_of_steady_lines(modes, as_mended) if kind.kind == "ambient" else Answer(modes=modes)
    if is_driven and modes.modes and prepared[0].n_inputs:
        rest = [one.outputs - simulate(model, one, initial_state=np.zeros(model.order)).outputs for one in prepared]
        asked_of_kind = told_of_lines_beside(modes, prepared, rest)
    if kind.kind in ("transient", "decay"):  # a sample that was filled by a linear model tells nothing of another
        rings = seen_alone(prepared, preparation.measured)
        scale, times = reruns.output_scale, fading(model, rings, left)
        asked_of_kind = told_of_ring_down(
            modes, rings, left, output_scale=scale, is_decay=kind.kind == "decay", times=times
        )
    modes, uncertainty, varying = with_changes(
        asked_of_kind.modes,
        uncertainty,
        asked if is_driven else (),
        left_there,
        output_scale=reruns.output_scale,
        times=asked_of_kind.times,
    )
    powers = powers_of_motion(runs.records, foretold) if final.feedback == "none" else Powers()
    tell("checking residuals", 0.9)
    refined = final.refined if white is None else None
    fitted_to = runs.records if refined is None else refined.as_fitted(prepared)
    residuals, innovations = check_residuals(observer, prepared), _innovations(model, fitted_to)
    result = Identification(
        records=tuple(
            replace(run, inputs=came.inputs).samples(n)
            for run, came, n in zip(runs.records, preparation.as_measured, n_rest, strict=True)
        ),
        excitation=excitation,
        observer=observer,
        residuals=residuals,
        markov=final.markov,
        realisation=preparation.complete(model),
        fitted_model=model,
        modes=replace(
            preparation.modes_of(modes),
            output_names=prepared[0].output_names,
            output_units=prepared[0].output_units,
            input_names=prepared[0].input_names,
            input_units=prepared[0].input_units,
            input_hold=prepared[0].input_hold,
        ),
        order_evidence=order_evidence(decomposition, model.order, searched, reruns=reruns),
        choices=(
            kind.choice,
            *((RELEASED,) if kind.kind == "decay" else ()),
            *asked_of_kind.choices,
            *preparation.choices,
            *explain_scoring(prepared, _folds(kind)),
            *(() if white is None else explain_filter(white.filter, white.share)),
            *explain_search(searched, wanted=wanted if white is None else searched.chosen),
            *(() if final.leaves_white_noise and not final.apart else explain_noise(final.noise, final.why)),
            *explain_gain(final.gain),
        ),
        fit=fit,
        simulated=tuple(run.samples(n) for run, n in zip(runs.simulated, n_rest, strict=True)),
        predicted=tuple(run.samples(n) for run, n in zip(runs.predicted, n_rest, strict=True)),
        warnings=(
            *kind.warnings,
            *preparation.warnings,
            *filled_words(preparation, of_measured=fitted and final.noise is None, is_driven=is_driven),
            *asked_of_kind.warnings,
            *unsteady,
            *varying,
            *warnings_in_words(
                prepared,
                fit=fit,
                missed=missed,
                lines=lines,
                modes=modes,
                excitation=excitation if by_inputs else None,
                residuals=innovations if searched.chosen.grew and innovations else residuals,
                seen=final.seen(left, prepared, preparation.measured_if_filled),
                found=searched,
                powers=powers,
            ),
            *records_apart(*left_alone_and_together(prepared, left)),
            *blows_apart(final.unlike),
            *noise_words(modes, inflation),
        ),
        record_kind=kind.kind,
        uncertainty=uncertainty,
        innovations=innovations,
        innovation_covariance=_covariance(final),
        input_delay=preparation.input_delay,
    )
    tell("done", 1.0)
    if final.feedback == "none":
        return result
    of_noise = final.noise is not None and final.feedback == "biasing"
    return with_feedback(result, None if of_noise else moved, free)


def _with_real_modes(result: Identification, again: Callable[[list[int]], Identification]) -> Identification:
    """The result with the input delays that the phases of its modes ask for, if that explains the data as well.

    Args:
        result: with the delays that the pulse response shows.
        again: identifies with other delays, in samples of the records of the result.
    """
    tried, names = [result.input_delay], result.records[0].input_names
    longest = int(LONGEST_SHARE * max(record.n_samples for record in result.records))
    while (asked := delay_of_phases(result.modes, result.input_delay, longest=longest)) not in tried:
        tried.append(asked)
        said = ", ".join(
            f"{name}: {new} samples instead of {old}"
            for name, new, old in zip(names, asked, result.input_delay, strict=True)
            if new != old
        )
        other = again(list(asked))
        if 1.0 - other.fit.mean > WITHIN * (1.0 - result.fit.mean):
            text = (
                f"The phases of the modes ask for another input delay ({said}), but with it the model explains less, "
                "so it was not taken; do not trust modal masses and scales at these inputs, or give input_delay."
            )
            return replace(result, warnings=(*result.warnings, text))
        why = f"it makes the residues of the modes real, which the last choice did not ({said})"
        choices = tuple(replace(one, reason=why) if one.what == "input delay" else one for one in other.choices)
        result = replace(other, choices=choices)
    return result


def _covariance(final: FinalModel) -> FloatArray | None:
    if final.gain is not None:
        return final.gain.innovation_covariance
    return None if final.noise is None else final.noise.covariance


def _folds(kind: KindFound) -> Folds:
    """What is struck a few times is held out row by row: a block holds a blow or none."""
    return "rows" if kind.kind in ("transient", "decay") else "blocks"


def _innovations(model: Realisation, records: Sequence[Record]) -> ResidualCheck | None:
    try:
        return check_innovations(model, records)
    except IdentificationError:  # no gain, or too few rows for the test
        return None


def _within_memory(records: Sequence[Record], given: GivenKind) -> tuple[tuple[Record, ...], KindFound, Mended | None]:
    """The records, their kind, and how they are mended, if that was asked; stretches of long ones that always move.

    Raises:
        InvalidDataError: more than `MEMORY_SHARE` of the memory would be needed; or as `find_kind` says.
    """
    n_samples, n_channels = sum(one.n_samples for one in records), records[0].n_inputs + records[0].n_outputs
    need = COPIES * n_channels * n_samples * ITEM
    _refuse_beyond(min(need, MOST_MEMORY + bytes_in_memory(records)), n_samples, n_channels)
    mend = mended(records) if not records[0].n_inputs and need <= MOST_MEMORY else None
    kind = find_kind(records if mend is None else mend.records, given)  # one spike would make a decay ambient
    brief = kind.kind in ("transient", "decay")
    if brief:
        _refuse_beyond(need, n_samples, n_channels)
    if given != "transient" and (brief or (kind.kind == "ambient" and given == "auto" and mend is not None)):
        mend = mended(records) if mend is None else mend
        kept, kind = free_of_clipping(records, kind, mend.records)
        records, mend = kept, mend if kept == tuple(records) else None
    several = used_rows(records, kind.kind)
    if several == tuple(records):
        return several, kind, mend
    text = (
        f"Of {n_samples} samples {sum(one.n_samples for one in several)} are used, {len(several)} stretches spread "
        f"evenly over the records, because all would need {need / 2**30:.1f} GiB. Deviations are those of the "
        "stretches; every second sample behind an anti-alias filter, or fewer channels, would let more of it in."
    )
    return several, replace(kind, warnings=(*kind.warnings, text)), None


def used_rows(records: Sequence[Record], kind: RecordKind | None) -> tuple[Record, ...]:
    """The records, or stretches of long ones that always move: what is struck or rings down is told by few rows."""
    a_row = COPIES * (records[0].n_inputs + records[0].n_outputs) * ITEM
    return spread_stretches(records, int(MOST_MEMORY / a_row)) if kind in ("driven", "ambient") else tuple(records)


def _refuse_beyond(need: float, n_samples: int, n_channels: int) -> None:
    """Raise before the work if it would end in a process that the system kills."""
    budget, whose = memory_budget()
    if need > MEMORY_SHARE * budget:
        raise InvalidDataError(
            f"identifying {n_samples} samples of {n_channels} channels needs about {need / 2**30:.1f} GiB, more than "
            f"{MEMORY_SHARE:.0%} of the {budget / 2**30:.1f} GiB that {whose}; give a stretch of the record, fewer "
            "channels, or every second sample behind an anti-alias filter."
        )
