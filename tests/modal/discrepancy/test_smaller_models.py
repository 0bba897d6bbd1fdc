"""A model without what it needs, on made-up estimates."""

from types import SimpleNamespace

import pytest
from made_up_estimates import estimate_of, node_with

from modal.discrepancy import nodes
from modal.discrepancy import smaller_models as module
from modal.discrepancy.nodes import Node


@pytest.mark.parametrize(
    ("costs", "judged"),
    [([99.0, 25.0, 8.0, 8.0], True), ([101.0], False), ([99.0, 31.0], False), ([99.0, 25.0, 11.0], False)],
)
def test_a_model_without_what_it_needs_is_neither_fitted_nor_judged_to_the_end(monkeypatch, costs, judged):
    """Costs after each four iterations; the whole model's is 1."""
    left = list(costs)
    monkeypatch.setattr(module, "estimate", lambda *_a, **_k: estimate_of(left[0], cost=left.pop(0)))
    monkeypatch.setattr(nodes, "judged", lambda *_args: estimate_of(2.0))
    whole = node_with(1.0)
    whole = Node(fitted=whole.fitted, held_out=whole.held_out, coarse=estimate_of(1.0, cost=1.0))
    found = module._compared(estimate_of(500.0), whole, SimpleNamespace(fit="fit", held_out="held"))
    assert (found.held_out is not None) == judged
    assert left == []
