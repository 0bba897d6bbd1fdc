"""Rules that the text of every library file keeps."""

import ast

import pytest

EDGE = ("modal/command", "modal/examples/", "modal/__main__")


KINDS = (ast.Call, ast.Assert, ast.FunctionDef, ast.AsyncFunctionDef, ast.keyword)


@pytest.fixture(scope="module")
def nodes(sources):
    """(place, node) of all that is looked at here; calls with the words of what they call."""
    return [
        (f"{file}:{node.lineno}", node, ast.unparse(node.func) if isinstance(node, ast.Call) else "")
        for file, tree in sources.items()
        for node in ast.walk(tree)
        if isinstance(node, KINDS)
    ]


def places(nodes, found):
    return [place for place, node, called in nodes if not place.startswith(EDGE) and found(node, called)]


def test_library_code_neither_prints_nor_exits(nodes):
    assert not places(nodes, lambda _, called: called in {"print", "sys.exit", "exit", "quit", "os._exit"})


def test_user_input_is_not_checked_by_assert(nodes):
    """`assert x is not None` after x was made tells the type checker, and is allowed."""

    def checks(node, _):
        return isinstance(node, ast.Assert) and not ast.unparse(node.test).endswith(" is not None")

    assert not places(nodes, checks)


def test_no_function_swallows_keywords(nodes):
    """`with_effect` takes an effect's parameters by name, which only the catalogue knows; it checks them itself."""

    def swallows(node, _):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) or node.args.kwarg is None:
            return False
        return node.name != "with_effect"

    assert not places(nodes, swallows)


def test_randomness_comes_only_from_a_generator_that_was_passed(nodes):
    """`numpy.random.seed` and its kin share one hidden state; a fresh unseeded generator cannot be repeated."""

    def hidden(node, name):
        legacy = name.startswith("np.random.") and name not in {"np.random.default_rng", "np.random.Generator"}
        return legacy or (name == "np.random.default_rng" and not node.args)

    assert not places(nodes, hidden)


def test_nothing_is_unpickled_or_evaluated(nodes):
    def risky(node, called):
        if isinstance(node, ast.keyword) and node.arg == "allow_pickle":
            return not (isinstance(node.value, ast.Constant) and node.value.value is False)
        return called in {"eval", "exec", "pickle.load", "pickle.loads"}

    assert not [place for place, node, called in nodes if risky(node, called)]


def test_files_are_short_and_say_what_they_are(sources, repository):
    """A file is a chapter: a docstring, and at most 600 lines."""
    lengths = {file: len((repository / file).read_text(encoding="utf-8").splitlines()) for file in sources}
    assert not {file: length for file, length in lengths.items() if length > 600}
    assert not [file for file, tree in sources.items() if not ast.get_docstring(tree)]
