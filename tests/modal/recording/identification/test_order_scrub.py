"""The page "Order" on the timeline "model_order": poles appear as the order grows, words say what each order has."""

import numpy as np

from modal.recording import save_recording

PLOT = "/order/stabilisation/plot"


def test_each_order_shows_the_poles_of_all_orders_below_and_its_own_in_front(stored, identification):
    points = [p for p in identification.order_evidence.stabilisation if p.frequency <= 50.0]
    below, own = (stored.rows(f"{PLOT}/{name}", "model_order") for name in ("poles", "poles_now"))
    orders = sorted({point.order for point in points})
    assert list(below) == list(own) == orders
    for order in orders:
        assert len(own[order]["Points2D:positions"]) == sum(p.order == order for p in points)
        assert len(below[order]["Points2D:positions"] or []) == sum(p.order < order for p in points)
        assert all(text.startswith(f"order {order}: ") for text in own[order]["Points2D:labels"])


def test_on_the_timeline_time_all_poles_are_there_at_once(stored, identification):
    points = [p for p in identification.order_evidence.stabilisation if p.frequency <= 50.0]
    rows = stored.rows(f"{PLOT}/poles", "time")
    assert len(rows) == 1
    assert len(next(iter(rows.values()))["Points2D:positions"]) == len(points)
    assert not stored.rows(f"{PLOT}/poles_now", "time")


def test_the_line_of_the_order_rises_with_it(stored):
    rows = stored.rows(f"{PLOT}/order_now", "model_order")
    heights = [row["LineStrips2D:strips"][0][0][1] for row in rows.values()]
    assert (np.diff(heights) < 0).all()  # up is down in the view


def test_the_words_of_each_order_come_from_its_numbers(stored, identification):
    evidence = identification.order_evidence
    rows = stored.rows("/order/text", "model_order")
    assert list(rows) == sorted({point.order for point in evidence.stabilisation})
    text = rows[10]["TextDocument:text"][0]
    fit = evidence.candidate_fits[evidence.candidate_orders == 10][0]
    assert f"cross-validated fit {fit:.4f}" in text
    sure = sum(p.overlap >= 0.95 for p in evidence.stabilisation if p.order == 10)
    total = sum(p.order == 10 for p in evidence.stabilisation)
    assert f"{sure} of its {total} poles continue a pole of the order below" in text
    assert ", chosen" not in text
    ((chosen,),) = [row["TextDocument:text"] for row in stored.rows("/order/text", "time").values()]
    assert chosen.startswith(f"### Order {evidence.order}, chosen")


def test_behind_the_poles_is_the_spectrum_of_the_outputs_and_the_key_says_so(build, tmp_path, read):
    stored = read(save_recording(build(), tmp_path / "run.rrd"))
    assert "mean spectrum of the outputs" in stored.static(f"{PLOT}/words", "Points2D:labels")
    (line,) = stored.static(f"{PLOT}/mean_spectrum_of_the_outputs", "LineStrips2D:strips")
    assert np.ptp(np.array(line), axis=0).min() > 100


def test_an_order_that_was_not_tried_has_no_dot_on_the_fit(stored, identification):
    evidence = identification.order_evidence
    tried = set(evidence.candidate_orders[np.isfinite(evidence.candidate_fits)].tolist())
    rows = stored.rows("/order/fit/plot/order_now", "model_order")
    assert list(rows) == sorted({point.order for point in evidence.stabilisation})
    assert {order for order, row in rows.items() if row["Points2D:positions"]} == tried & set(rows)
    assert not tried >= set(rows)
