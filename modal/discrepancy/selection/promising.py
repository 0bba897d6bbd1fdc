"""What is worth a fit beside a model: the best of a screen, along a motion that shows what is missing."""

from collections.abc import Sequence

from modal.discrepancy.fitting.estimation import Estimate
from modal.discrepancy.fitting.nodes import Node, Task
from modal.discrepancy.fitting.observed_fits import observed_form, weaker_form
from modal.discrepancy.selection.screening import Candidate, screen_candidates
from modal.discrepancy.selection.simpler_laws import simple_first

__all__ = ["seen"]

PLACES, SHAPES = 2, 2
LEAST_SHARE = 0.1
"""A candidate is followed while it takes away at least this share of what the best one takes away."""

CONVINCING, FEWEST = 0.5, 4
"""Where the best one takes away less than the first share, so many different effects are followed in any case."""

TELLING = 1.5
"""With a weaker gain the best candidate must take away so many times the share that it does with the whole one."""
BLIND = 10.0
"""A level above which a screen without an observer form is not trusted, where its best candidate takes away less than
the share above."""

SIMPLE = 0.5
"""A limit of a richer law is fitted before it where it takes away this share of what that takes away."""


def seen(node: Node, task: Task) -> tuple[Estimate, list[Candidate]]:
    """The model in observer form and what is worth a fit, with a weaker gain where that shows more.

    The outputs follow the records so closely under a strong gain that it hides what is narrow in frequency or acts on
    the outputs alone.

    Args:
        node: A model.
        task: Records to fit, catalogue.

    Returns:
        The model along the records, and the candidates: the best first, of the others limits before richer laws.
    """
    observed = observed_form(node.coarse, task)
    screened = screen_candidates(observed, task.fit, task.catalogue)
    weaker = None if _convincing(screened) else weaker_form(observed, task)
    if weaker is not None and weaker.cost < node.coarse.cost:
        other = screen_candidates(weaker, task.fit, task.catalogue)
        if _most(other) > TELLING * _most(screened):
            return weaker, _in_order(_promising(other))
    return observed, _in_order(_candidates(observed, screened, task))


def _most(candidates: Sequence[Candidate]) -> float:
    """What the best of a screen takes away."""
    return candidates[0].fall if candidates else 0.0


def _candidates(observed: Estimate, screened: Sequence[Candidate], task: Task) -> list[Candidate]:
    """What is worth a fit: by the screen, and every effect once where the screen knows little.

    Without an observer form the screen goes along the motion of a wrong model. Of a mass that is struck and then held
    by friction it sees neither the right law nor even its sign.
    """
    candidates = _promising(screened)
    if observed.gain is not None or observed.level <= BLIND or _convincing(screened):
        return candidates
    every = screen_candidates(observed, task.fit, task.catalogue, signs="turned")
    tried = {one.key for one in candidates}
    first: dict[str, Candidate] = {}
    for one in every:
        if one.key not in tried:
            first.setdefault(one.key, one)
    return [*candidates, *first.values()]


def _convincing(candidates: Sequence[Candidate]) -> bool:
    return _most(candidates) >= CONVINCING


def _promising(candidates: Sequence[Candidate]) -> list[Candidate]:
    """The best places of each effect, the best shapes of each place."""
    kept: list[Candidate] = []
    least = LEAST_SHARE * _most(candidates)
    few = 1 if _convincing(candidates) else FEWEST
    for candidate in candidates:
        if candidate.fall < least and len({other.key for other in kept}) >= few:
            break
        same_effect = [other for other in kept if other.key == candidate.key]
        same_place = [other for other in same_effect if other.where == candidate.where]
        places = {other.where for other in same_effect}
        if len(same_place) < SHAPES and (candidate.where in places or len(places) < PLACES):
            kept.append(candidate)
    return kept


def _in_order(candidates: Sequence[Candidate]) -> list[Candidate]:
    """The best first, of the others limits before richer laws."""
    others = simple_first(
        candidates[1:], lambda one: (one.key, one.where), lambda simple, rich: simple.fall >= SIMPLE * rich.fall
    )
    return [*candidates[:1], *others]
