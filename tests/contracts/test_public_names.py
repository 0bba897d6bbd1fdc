"""Public names keep their signatures: `public_names.txt` lists those of commit e39c1a1, the last before the folders,
and those that came since.

One difference is meant: `okid.fit_observer` had a default for `order`, and `modal.choose_orders` chooses it now.
"""

import ast
import inspect

import pytest
from public_table import public_table

from modal.discrepancy import CATALOGUE

ORDER_WITHOUT_DEFAULT = ("okid.fit_observer", "order")


def listed(repository):
    return (repository / "tests" / "contracts" / "public_names.txt").read_text(encoding="utf-8").split("\n")[:-1]


def found(name):
    """The thing of a dotted name: an entry of a package's `__all__`, or an attribute of one."""
    table = public_table()
    if name in table:
        return table[name]
    owner, _, attribute = name.rpartition(".")
    return getattr(table[owner], attribute)


def parameters_of(thing):
    """{name: (kind, default as text or None)}."""
    return {
        name: (parameter.kind, None if parameter.default is inspect.Parameter.empty else as_text(parameter.default))
        for name, parameter in inspect.signature(thing).parameters.items()
    }


def as_text(default):
    return "CATALOGUE" if default is CATALOGUE else ast.unparse(ast.parse(repr(default), mode="eval"))


def parameters_written(text):
    """The same of a signature in words."""
    arguments = ast.parse(f"def f{text}: pass").body[0].args
    positional, kind = arguments.args, inspect.Parameter.POSITIONAL_OR_KEYWORD
    defaults = [None] * (len(positional) - len(arguments.defaults)) + arguments.defaults
    written = {a.arg: (kind, d and ast.unparse(d)) for a, d in zip(positional, defaults, strict=True)}
    pairs = zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True)
    written |= {a.arg: (inspect.Parameter.KEYWORD_ONLY, d and ast.unparse(d)) for a, d in pairs}
    open_ended = (
        (arguments.vararg, inspect.Parameter.VAR_POSITIONAL),
        (arguments.kwarg, inspect.Parameter.VAR_KEYWORD),
    )
    return written | {a.arg: (kind, None) for a, kind in open_ended if a}


def test_the_list_is_whole(repository):
    assert len(listed(repository)) == 158
    assert sum("(" in line for line in listed(repository)) == 106


def test_every_name_is_there_with_its_signature(repository):
    changed = []
    for line in listed(repository):
        name, bracket, rest = line.partition("(")
        thing = found(name)
        if not bracket:
            continue
        then, now = parameters_written("(" + rest), parameters_of(thing)
        if name == ORDER_WITHOUT_DEFAULT[0]:
            then.pop(ORDER_WITHOUT_DEFAULT[1])
            assert ORDER_WITHOUT_DEFAULT[1] in now
        positional = [p for p, (kind, _) in then.items() if kind is inspect.Parameter.POSITIONAL_OR_KEYWORD]
        now_positional = [p for p, (kind, _) in now.items() if kind is inspect.Parameter.POSITIONAL_OR_KEYWORD]
        gone = {p: how for p, how in then.items() if now.get(p) != how}
        # a result that only the product makes may hold more; nobody's call may need more than it did
        result = inspect.isclass(thing) and not now_positional
        needed = [p for p, (_, default) in now.items() if p not in then and default is None and not result]
        needed = [p for p in needed if (name, p) != ORDER_WITHOUT_DEFAULT]
        if gone or needed or now_positional[: len(positional)] != positional:
            changed.append(f"{name}: changed {gone}, needs {needed}, positional {now_positional}")
    assert not changed, "\n".join(changed)


@pytest.mark.parametrize(
    ("then", "now"),
    [("(a, b=1)", "(a, b=2)"), ("(a, b)", "(a)"), ("(a, *, b=1)", "(a, b=1)"), ("(a, *, b=1)", "(a, *, b)")],
)
def test_a_change_would_be_seen(then, now):
    assert parameters_written(then) != parameters_written(now)
