"""How many small faults in a module its own tests catch: mutants of its syntax tree, drawn at random.

    python tests/benchmarks/mutation_score.py okid/observer.py era/hankel.py --count 30 --seed 1
    python tests/benchmarks/mutation_score.py --core

A mutant changes one place: a comparison lets its border in or out or is turned round, + and - or * and / are swapped, a
term is dropped, a whole number is one larger, another number a tenth larger, `and` is `or`, a condition is turned
round, min is max. Texts of errors, annotations and module docstrings are left alone. No file is written: the changed
module is imported from memory by a forked process (so this needs fork), which runs the test files of the module and
stops at the first failure. A mutant that takes more CPU seconds than --most-seconds counts as caught.

Test files are those at the mirrored path, `tests/okid/test_observer.py` for `okid/observer.py`, and those of ALSO.
EQUIVALENT lists the mutants that change nothing anybody may rely on, each with the reason; they are not counted.
"""

import argparse
import ast
import copy
import importlib.abc
import importlib.util
import os
import random
import signal
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CORE = (
    "okid/observer.py", "okid/markov.py", "okid/gram.py", "okid/least_squares.py", "era/hankel.py", "era/balanced.py",
    "modal/modes/extraction.py", "modal/verdict/probability.py",
)  # fmt: skip
ALSO = {
    "modal/modes/extraction.py": ("tests/modal/modes/test_indicators.py",),
    "okid/gram.py": ("tests/modal/estimation/test_block_grams.py",),
    "okid/least_squares.py": ("tests/okid/test_regression.py", "tests/modal/estimation/test_block_grams.py"),
    "era/balanced.py": ("tests/era/test_realisation.py", "tests/era/test_hankel.py"),
    "era/hankel.py": ("tests/era/test_balanced.py",),
}
"""Test files of other names that are a module's own."""
SPEED_ONLY = {("era/hankel.py", "_dense_is_cheaper")}
"""Functions that choose between two ways to the same numbers, each held to the other by a test: not mutated."""
EQUIVALENT = {
    ("era/hankel.py", "spectrum = np.fft.rfft(markov[1 : n_needed + 1], n_transform, axis=0)", "one more"): (
        "one lag more than needed meets no row and column"
    ),
    ("era/hankel.py", "best = 1 << (least - 1).bit_length()", "Sub to Add"): "a higher bound, the same least",
    ("era/balanced.py", "order: int = self.A.shape[0]", "one more"): "A is square",
    ("era/balanced.py", "largest = found.singular_values[0] if found.singular_values.size else 0.0", "a tenth more"): (
        "without singular values the sentence says 0 of nothing"
    ),
    ("okid/least_squares.py", "if 2.0 * gram.n_rows * size**2 <= _QR_OPERATIONS:", "a tenth more"): (
        "two exact ways to one solution; which is taken at the border costs the same"
    ),
    ("era/balanced.py", "if 1 < end <= rank and end < singular_values.size:", "Lt to LtE"): (
        "with no value beyond the end there is no drop there that the rule could take for a gap"
    ),
    ("modal/modes/extraction.py", "size = np.linalg.norm(measured.reshape(n_poles, -1), axis=1)", "one more"): (
        "NumPy takes any negative size for the open one"
    ),
    ("modal/modes/extraction.py", "died = size**last < decay_limit * (1 - 1e-12)", "Sub to Add"): "a rounding's worth",
    ("modal/modes/extraction.py", "died = size**last < decay_limit * (1 - 1e-12)", "a tenth more"): (
        "a rounding's worth"
    ),
    ("okid/least_squares.py", "if 2.0 * gram.n_rows * size**2 <= _QR_OPERATIONS:", "LtE to Lt"): (
        "two exact ways to one solution; which is taken at the border costs the same"
    ),
}
"""{(file, mutated line, what was done): why nobody may notice}."""

COMPARISONS = {
    ast.Lt: (ast.LtE, ast.GtE), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.LtE), ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,), ast.Is: (ast.IsNot,), ast.IsNot: (ast.Is,), ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}  # fmt: skip
SWAPS = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult}
OTHER_NAME = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "argmin": "argmax"}


def changes(node):
    """[(what, changed node)] of one node."""
    found = []
    if isinstance(node, ast.Compare):
        for place, operator in enumerate(node.ops):
            for other in COMPARISONS.get(type(operator), ()):
                new = copy.deepcopy(node)
                new.ops[place] = other()
                found.append((f"{type(operator).__name__} to {other.__name__}", new))
    elif isinstance(node, ast.BinOp) and type(node.op) in SWAPS:
        new = copy.deepcopy(node)
        new.op = SWAPS[type(node.op)]()
        found.append((f"{type(node.op).__name__} to {type(new.op).__name__}", new))
        if isinstance(node.op, ast.Add | ast.Sub):
            found.append(("term dropped", copy.deepcopy(node.left)))
    elif isinstance(node, ast.Constant) and type(node.value) is int:
        found.append(("one more", ast.Constant(node.value + 1)))
    elif isinstance(node, ast.Constant) and type(node.value) is float:
        found.append(("a tenth more", ast.Constant(1.1 * node.value if node.value else 0.1)))
    elif isinstance(node, ast.BoolOp):
        new = copy.deepcopy(node)
        new.op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        found.append(("and for or", new))
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
        found.append((f"{type(node.op).__name__} dropped", copy.deepcopy(node.operand)))
    elif isinstance(node, ast.If | ast.IfExp) and not isinstance(node.test, ast.Compare):
        new = copy.deepcopy(node)
        new.test = ast.UnaryOp(ast.Not(), new.test)
        found.append(("condition turned round", new))
    elif isinstance(node, ast.Name | ast.Attribute):
        name = node.id if isinstance(node, ast.Name) else node.attr
        if name in OTHER_NAME:
            new = copy.deepcopy(node)
            setattr(new, "id" if isinstance(node, ast.Name) else "attr", OTHER_NAME[name])
            found.append((f"{name} to {OTHER_NAME[name]}", new))
    return found


def places(node, path=()):
    """(path of fields, node) of everything that may be changed."""
    for field, value in ast.iter_fields(node):
        if isinstance(node, ast.Raise) or field in ("annotation", "returns", "decorator_list", "type_params"):
            continue
        if isinstance(node, ast.Assign | ast.AnnAssign) and "__all__" in ast.unparse(node):
            continue
        for i, child in enumerate(value if isinstance(value, list) else [value]):
            if isinstance(child, ast.AST) and not isinstance(child, ast.JoinedStr | ast.expr_context):
                step = (*path, (field, i if isinstance(value, list) else None))
                yield step, child
                yield from places(child, step)


def mutants(source):
    """[(line number, what was done, source of the changed module)], in the order of the file."""
    tree, found = ast.parse(source), []
    for path, node in places(tree):
        for what, new in changes(node):
            changed = copy.deepcopy(tree)
            parent = changed
            for field, i in path[:-1]:
                parent = getattr(parent, field) if i is None else getattr(parent, field)[i]
            field, i = path[-1]
            if i is None:
                setattr(parent, field, new)
            else:
                getattr(parent, field)[i] = new
            line = getattr(node, "lineno", 0)
            found.append((line, what, ast.unparse(ast.fix_missing_locations(changed))))
    return found


class Changed(importlib.abc.MetaPathFinder, importlib.abc.InspectLoader):
    """Import one module from changed source, all others as usual."""

    def __init__(self, name, source):
        self.name, self.source = name, source

    def find_spec(self, name, path=None, target=None):
        return importlib.util.spec_from_loader(name, self) if name == self.name else None

    def get_source(self, fullname):
        return self.source


def caught(module, source, tests, most_seconds):
    """Whether the tests fail on the changed module, in a process of its own."""
    child = os.fork()
    if child == 0:
        import pytest

        quiet = os.open(os.devnull, os.O_WRONLY)
        os.dup2(quiet, 1)
        os.dup2(quiet, 2)
        signal.signal(signal.SIGPROF, signal.SIG_DFL)  # ends the process
        signal.setitimer(signal.ITIMER_PROF, most_seconds)
        sys.meta_path.insert(0, Changed(module.removesuffix(".py").replace("/", "."), source))
        try:
            code = pytest.main(["-x", "-q", "-n", "0", "-p", "no:cacheprovider", *tests])
            os._exit(0 if code == pytest.ExitCode.OK else 1)
        finally:
            os._exit(1)
    return os.waitpid(child, 0)[1] != 0


def tests_of(module):
    """The test files of a module."""
    path = Path(module)
    own = Path("tests", *path.parts[:-1], f"test_{path.name}")
    return [str(ROOT / test) for test in (own, *ALSO.get(module, ())) if (ROOT / test).exists()]


def score(module, options):
    """(caught, counted) of one module; prints the survivors."""
    text = (ROOT / module).read_text(encoding="utf-8")
    lines, tests = text.splitlines(), options.tests or tests_of(module)
    if not tests:
        sys.exit(f"{module} has no test file of its name; name some with --tests or in ALSO")
    left_out = {
        line
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.FunctionDef) and (module, node.name) in SPEED_ONLY
        for line in range(node.lineno, node.end_lineno + 1)
    }
    every = [mutant for mutant in mutants(text) if mutant[0] not in left_out]
    drawn = random.Random(options.seed).sample(every, min(options.count, len(every)))  # noqa: S311 - a sample
    if caught(module, text, tests, options.most_seconds):
        sys.exit(f"{module}: its tests fail as it stands, {' '.join(tests)}")
    counted, found = 0, 0
    for number, what, source in sorted(drawn):
        line = lines[number - 1].strip()
        if (module, line, what) in EQUIVALENT:
            continue
        counted += 1
        if caught(module, source, tests, options.most_seconds):
            found += 1
        else:
            print(f"  survived  {module}:{number}  {what}: {line}", flush=True)
    print(f"{module}: {found} of {counted} caught, {found / max(counted, 1):.0%}, of {len(every)} mutants", flush=True)
    return found, counted


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("modules", nargs="*", help="files of the product, from the repository's folder")
    parser.add_argument("--core", action="store_true", help=", ".join(CORE))
    parser.add_argument("--count", type=int, default=20, help="mutants a module, at most")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--tests", nargs="+", help="test files to run instead of the module's own")
    parser.add_argument("--most-seconds", type=float, default=120.0, help="CPU seconds of one mutant")
    options = parser.parse_args()
    os.chdir(ROOT)
    sys.path.insert(0, str(ROOT))
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
    for library in ("pytest", "numpy", "scipy.linalg", "scipy.signal"):  # once, before the forks
        importlib.import_module(library)
    totals = [score(module, options) for module in (*options.modules, *(CORE if options.core else ()))]
    found, counted = (sum(column) for column in zip(*totals, strict=True))
    print(f"all: {found} of {counted} caught, {found / max(counted, 1):.0%}")


if __name__ == "__main__":
    main()
