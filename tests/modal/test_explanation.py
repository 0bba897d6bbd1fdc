"""Every sentence has one rule; each is met from both sides."""

import numpy as np
import pytest

from era.balanced import decompose, realise_from
from modal.explanation import (
    EXPLAINS,
    FOLDS_APART,
    FOLLOWS_INPUT,
    LEAST_EXCITED,
    explain_scoring,
    explain_search,
    order_evidence,
    warnings_in_words,
)
from modal.extraction import extract_modes
from modal.identification import Fit
from modal.mode import ModalModel, Mode
from modal.search import WITHIN, Search, SearchLimits
from modal.stretches import LONGEST_SCORED
from modal.trials import Trial
from modal.verdict import Rerun, Reruns
from okid.excitation import Excitation
from okid.markov import MarkovParameters
from okid.record import Record
from okid.residuals import ResidualCheck

ORDERS, RIDGES, MODEL_ORDERS = (1, 2, 4, 8, 16), (0.0, 1e-3, 0.1), (1, 2, 4, 8)


def trial(observer_order=8, ridge=1e-3, model_order=4, error=0.1):
    return Trial(
        observer_order=observer_order,
        ridge=ridge,
        model_order=model_order,
        squared_errors=np.full((3, 2), error**2),
        block_errors=np.full(9, error**2 / 9),
        error=error,
    )


def found_of(*trials, chosen=0, orders=ORDERS, ridges=RIDGES, model_orders=MODEL_ORDERS):
    limits = SearchLimits(observer_orders=orders, ridges=ridges, model_orders=model_orders)
    return Search(trials=trials, chosen=trials[chosen], power=np.ones((3, 2)), limits=limits, ground=None)


def fit_of(*cross_validated, folds=(0.9, 0.9, 0.9)):
    values = np.array(cross_validated)
    return Fit(cross_validated=values, folds=np.array(folds), whole=values, one_step=values)


def a_mode(verdict):
    return Mode(
        pole=-0.1 + 9j,
        kind="oscillatory",
        frequency=1.4,
        damping_ratio=0.01,
        shape=np.ones(2),
        participation=np.ones(1),
        verdict=verdict,
    )


def excitation_of(*, persistency=9, share=1.0, messages=("the inputs lack something.",)):
    return Excitation(
        needed_order=9,
        persistency_order=persistency,
        condition=10.0,
        excited_share=np.array([1.0, share]),
        excited_bands=(((0.0, 50.0),),) * 2,
        messages=messages,
    )


def residuals_of(input_ratio):
    return ResidualCheck(
        autocorrelation=np.ones((1, 2)),
        whiteness_ratio=1.0,
        whiteness_p_value=0.5,
        input_correlation_ratio=input_ratio,
        confidence_limit=0.05,
        messages=(),
    )


def warnings_of(
    *,
    fit=None,
    verdicts=("system",),
    excitation=None,
    found=None,
    driven=True,
    output_names=("base", "tip"),
    input_ratio=1.0,
):
    values = np.random.default_rng(0).standard_normal((20, 4))
    record = Record(values[:, : 2 * driven], values[:, 2:], 0.01, output_names=output_names)
    return warnings_in_words(
        [record],
        fit=fit or fit_of(0.9, 0.9),
        modes=ModalModel(modes=tuple(a_mode(v) for v in verdicts), dt=0.01, indicator_caution=0.1),
        excitation=excitation or excitation_of(),
        residuals=residuals_of(input_ratio),
        found=found or found_of(trial()),
    )


def test_a_residual_that_follows_the_inputs_is_told():
    assert warnings_of(input_ratio=FOLLOWS_INPUT) == ()
    assert warnings_of(input_ratio=np.nan) == ()
    (words,) = warnings_of(input_ratio=1.01 * FOLLOWS_INPUT)
    assert "still follows the inputs" in words


def test_scored_stretches_are_told_for_long_records_only():
    short, long = (Record([], np.arange(float(n)), 0.01) for n in (LONGEST_SCORED, LONGEST_SCORED + 1))
    assert explain_scoring([short]) == ()
    (choice,) = explain_scoring([long])
    assert choice.value.startswith("3 stretches")


def test_no_news_is_good_news():
    assert warnings_of() == ()


def test_a_model_that_does_not_explain_the_data():
    (words,) = warnings_of(fit=fit_of(EXPLAINS + 0.1, EXPLAINS - 0.12))[:1]
    assert words == (
        "The model does not explain the data: a free run of the model explains 49 % of the outputs' motion on held-out "
        "rows, so no mode is certain."
    )
    assert not any("explain the data" in words for words in warnings_of(fit=fit_of(EXPLAINS, EXPLAINS)))


def test_a_model_worse_than_the_mean_explains_nothing():
    assert "explains 0 % of" in warnings_of(fit=fit_of(-0.3, -2.0))[0]


def test_one_output_that_is_not_explained_is_named():
    (words,) = warnings_of(fit=fit_of(0.9, EXPLAINS - 0.01))
    assert words == "The model does not explain these outputs (held-out fit): tip (0.49)."
    assert warnings_of(fit=fit_of(0.9, EXPLAINS)) == ()
    # where nothing is explained, one sentence is enough
    assert len(warnings_of(fit=fit_of(0.3, 0.2), verdicts=("doubtful",))) == 1


def test_folds_far_apart():
    (words,) = warnings_of(fit=fit_of(0.8, 0.8, folds=(0.9, 0.9 - FOLDS_APART - 0.01, 0.8)))
    assert words.startswith("Parts of the data fit very differently (0.64 to 0.90 over the folds)")
    assert warnings_of(fit=fit_of(0.8, 0.8, folds=(0.9, 0.9 - FOLDS_APART + 0.01, 0.8))) == ()


def test_no_input_is_told_and_its_excitation_is_not():
    words = warnings_of(driven=False, excitation=excitation_of(persistency=0))
    assert len(words) == 1
    assert words[0].startswith("No input was given")
    assert "one-step prediction explains 30 %" in warnings_of(driven=False, fit=fit_of(0.3, 0.3))[0]


@pytest.mark.parametrize("verdicts", [(), ("noise",), ("doubtful", "noise")])
def test_no_system_mode(verdicts):
    assert warnings_of(verdicts=verdicts) == (
        "No mode was found again often enough to be called a mode of the system.",
    )
    assert warnings_of(verdicts=(*verdicts, "system")) == ()


def test_the_largest_observer_order():
    (words,) = warnings_of(found=found_of(trial(16)))
    assert words.startswith("The largest observer order that the data allow (16) was the best")
    assert warnings_of(found=found_of(trial(16, error=0.1), trial(8, error=0.1 * WITHIN + 1e-6))) == (words,)
    # a tie is no sign that more would help
    assert warnings_of(found=found_of(trial(16, error=0.1), trial(8, error=0.1 * WITHIN - 1e-6))) == ()
    assert warnings_of(found=found_of(trial(8))) == ()
    assert warnings_of(found=found_of(trial(16), orders=(16,))) == ()  # the caller's own


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({}, False),
        ({"persistency": 8}, True),
        ({"share": LEAST_EXCITED - 0.01}, True),
        ({"share": LEAST_EXCITED}, False),
    ],
)
def test_excitation(options, told):
    assert bool(warnings_of(excitation=excitation_of(**options))) is told


# --- choices ---------------------------------------------------------------------------------------------------------


def reasons(found, wanted=None):
    choices = explain_search(found, wanted=wanted or found.chosen)
    assert [choice.what for choice in choices] == ["observer order", "ridge", "model order"]
    return [choice.value for choice in choices], [choice.reason for choice in choices]


def test_the_best_trial_is_said_to_be_the_best():
    found = found_of(trial(error=0.1), trial(16, error=0.2), trial(ridge=0.1, error=0.3))
    values, why = reasons(found)
    assert values == ["8", "0.001", "4"]
    assert why[0] == "free run on held-out rows: fit 0.900; best fits by observer order: 8: 0.900, 16: 0.800"
    assert why[1] == "free run on held-out rows: fit 0.900; best fits by ridge: 0.001: 0.900, 0.1: 0.700"
    assert why[2] == "free run on held-out rows: fit 0.900, the best of 3 models tried"


def test_a_smaller_model_says_what_it_stands_in_for():
    found = found_of(trial(model_order=8, error=0.1), trial(model_order=4, error=0.101), chosen=1)
    values, why = reasons(found)
    assert values[2] == "4"
    assert "the best (8 states, fit 0.900) by more than one standard error" in why[2]
    assert "no other came close" in why[0]


def test_an_unstable_first_choice_is_told():
    found = found_of(trial(model_order=8, error=0.1), trial(model_order=4, error=0.2), chosen=1)
    _, why = reasons(found, wanted=found.trials[0])
    assert why[2].endswith(
        "the first choice (8 states) is unstable, or worse than on its folds, when fitted to all rows"
    )


def test_what_was_given_is_said_to_be_given():
    found = found_of(trial(), orders=(8,), ridges=(1e-3,), model_orders=(4,))
    assert reasons(found)[1] == ["given as an argument"] * 3


def test_order_evidence_collects_the_candidates_of_the_chosen_observer():
    lag = np.arange(1.0, 60.0)
    pulse = np.r_[0.0, 0.95**lag * np.cos(0.5 * lag) + 0.9**lag * np.cos(1.7 * lag)]
    noise = 1e-4 * np.random.default_rng(1).standard_normal(60)
    decomposition = decompose(MarkovParameters(system=(pulse + noise).reshape(-1, 1, 1), dt=0.1), max_order=8)
    found = found_of(
        trial(model_order=4, error=0.1),
        trial(model_order=2, error=0.4),
        trial(16, model_order=8, error=0.5),
        trial(model_order=8, error=0.2),
    )
    evidence = order_evidence(decomposition, 4, found)
    assert evidence.candidate_orders.tolist() == [2, 4, 8]
    np.testing.assert_allclose(evidence.candidate_fits, [0.6, 0.9, 0.8])
    assert (evidence.order, evidence.gap_order) == (4, 4)
    assert {point.order for point in evidence.stabilisation} == set(range(1, 9))
    assert all(np.isnan(point.repeatability) for point in evidence.stabilisation)


def test_order_evidence_asks_the_reruns_of_every_pole():
    lag = np.arange(1.0, 60.0)
    pulse = np.r_[0.0, 0.95**lag * np.cos(0.5 * lag) + 0.9**lag * np.cos(1.7 * lag)]
    runs = []
    for seed in (2, 3):
        noise = 1e-4 * np.random.default_rng(seed).standard_normal(60)
        again = decompose(MarkovParameters(system=(pulse + noise).reshape(-1, 1, 1), dt=0.1), max_order=8)
        runs.append(Rerun(label="", change="data", modes=extract_modes(realise_from(again, 8))))
    reruns = Reruns(runs=tuple(runs), n_steps=60, output_scale=np.ones(1), input_scale=np.ones(1))
    evidence = order_evidence(again, 4, found_of(trial(model_order=4, error=0.1)), reruns=reruns)
    share = {order: [p.repeatability for p in evidence.stabilisation if p.order == order] for order in (4, 8)}
    assert min(share[4]) > 0.99  # the two modes
    assert sorted(share[8])[-3] < 0.8  # the poles of the noise, of which one run of the two has others
