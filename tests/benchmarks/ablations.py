"""The ledger of the diagnosis: which cases need which mechanism of the search, and what is lost without it.

    python tests/benchmarks/ablations.py --hidden 3020-3021 --outside 31 --mistakes 31 --work DIR

Every case is diagnosed once with all mechanisms watched: one that never answers otherwise than its replacement (none,
as it is) cannot have mattered to it. Where one did, the case is diagnosed once more without it. A case is "right" (the
truth is named, or nothing where nothing is hidden), "wrong" (a firm name, or none, that is not the truth) or "open", as
`hidden_effects`, `outside_catalogue` and `everyday_mistakes` say. Lines that are in DIR are not made again.
`--write-docs` puts the table into modal/docs/ablations.md.
"""

import argparse
import functools
import importlib.util
import json
import os
import signal
import sys
import time
import warnings
from collections.abc import Callable
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"
ROOT = Path(__file__).resolve().parents[2]
for folder in ("tests/benchmarks", "tests/hidden_effects", "tests/reference", "."):
    sys.path.insert(0, str(ROOT / folder))

import everyday_mistakes as mistakes  # noqa: E402 - after the path is set: the records
import hidden_effects as hidden_board  # noqa: E402
import outside_catalogue as outside_board  # noqa: E402
from hidden_cases import hidden_case  # noqa: E402
from hidden_scoring import model_of, options_of, outcome, records_of  # noqa: E402
from stamps import seeds_from, write_figures  # noqa: E402

# the benchmark has the name of its records
_spec = importlib.util.spec_from_file_location("mistakes_board", Path(__file__).with_name("everyday_mistakes.py"))
mistakes_board = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(mistakes_board)

DOCUMENT = ROOT / "modal" / "docs" / "ablations.md"
BEAM, NODES = "modal.discrepancy.selection.beam", "modal.discrepancy.fitting.nodes"
SMALLER, DECISION = "modal.discrepancy.selection.smaller_models", "modal.discrepancy.selection.decision"
LACK = "modal.discrepancy.selection.lack_of_fit"


@dataclass(frozen=True, slots=True, kw_only=True)
class Mechanism:
    """What it does in words, where the function is ("module:function"), and what answers in its place."""

    says: str
    where: str
    off: Callable

    @property
    def name(self):
        return self.where.partition(":")[2].lstrip("_")


def first(*values, **_):
    return values[0]


def none(*_, **__):
    return None


def false(*_, **__):
    return False


def empty(*_, **__):
    return []


def nothing_left(*_, **__):
    return [], []


def zero(*_, **__):
    return 0


def as_they_come(items, *_):
    return list(items)


def whole_catalogue(_curves, task):
    return dict(task.catalogue)


MECHANISMS = (
    Mechanism(says="screen along a weaker gain", where=f"{NODES[:-5]}observed_fits:weaker_form", off=none),
    Mechanism(says="limits before richer laws", where=f"{SMALLER}:simple_first", off=as_they_come),
    Mechanism(says="one of three stiffnesses of a gap spring settled", where=f"{BEAM}:settled_stiffness", off=none),
    Mechanism(says="stop at a limit that leaves only noise", where=f"{BEAM}:_enough", off=false),
    Mechanism(says="free run come to gain by gain", where=f"{BEAM}:_found_again", off=first),
    Mechanism(says="begin at rest where that is nearer", where=f"{NODES}:rested", off=first),
    Mechanism(says="hysteretic links loaded from rest", where=f"{NODES}:loaded", off=first),
    Mechanism(says="the initial state of held-out records by observer", where=f"{NODES}:_by_observer", off=none),
    Mechanism(says="sharp laws polished on a finer grid", where=f"{NODES}:polished", off=first),
    Mechanism(says="masses released", where=f"{NODES}:with_released_masses", off=none),
    Mechanism(says="two effects merged into one", where=f"{SMALLER}:merged", off=none),
    Mechanism(says="a limit in the place of a law", where=f"{SMALLER}:at_limits", off=empty),
    Mechanism(says="form-free curves", where="modal.discrepancy.selection.form_free:curves_beside", off=empty),
    Mechanism(says="after a curve only laws of its motion", where=f"{BEAM}:_laws_like", off=whole_catalogue),
    Mechanism(says="end where only noise is left", where=f"{LACK}:only_noise", off=false),
    Mechanism(says="room for what halves the fit alone", where=f"{BEAM}:_hopeful", off=false),
    Mechanism(says="effects without which it is as good go", where=f"{DECISION}:_pruned", off=first),
    Mechanism(says="a gain taken up by the calibration", where=f"{SMALLER}:absorbed_gain", off=none),
    Mechanism(says="masses that are not needed go back", where=f"{NODES}:needed_masses", off=first),
    Mechanism(says="a curve where a name leaves something", where=f"{DECISION}:_by_curve", off=first),
    Mechanism(says="no firm corner where a smooth law does as well", where=f"{DECISION}:_cornered", off=first),
    Mechanism(says="a known value is not free", where=f"{DECISION}:_found_as_known", off=zero),
    Mechanism(says="no firm name for three effects or a bad fit", where=f"{DECISION}:_unproved", off=empty),
    Mechanism(says="no firm name for undetermined shapes", where=f"{DECISION}:undetermined", off=empty),
    Mechanism(says="no firm name that neighbours fit as well", where=f"{LACK}:undecided_laws", off=empty),
    Mechanism(says="what two outputs share is no noise", where=f"{LACK}:_in_common", off=empty),
    Mechanism(says="noise of sensors beside nothing", where="modal.discrepancy.setup:_from_sensors", off=false),
    Mechanism(says="no firm name for absurd gains", where=f"{DECISION}:doubted_gains", off=empty),
    Mechanism(says="no firm name where something is left", where=f"{LACK}:what_is_left", off=nothing_left),
    Mechanism(says="the other hold", where="modal.discrepancy.validation.other_hold:by_the_better_hold", off=first),
)


def same(one, other):
    """Whether two answers are the same: the very objects, or plain values that are equal."""
    if isinstance(one, list | tuple) and isinstance(other, list | tuple):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys()
    plain = (bool, int, str, type(None))
    return one is other or (isinstance(one, plain) and isinstance(other, plain) and one == other)


@contextmanager
def replaced(mechanism, new):
    """Every name in the product that is this function stands for another one."""
    module, _, attribute = mechanism.where.partition(":")
    original = getattr(importlib.import_module(module), attribute)
    holders = [
        (holder, key)
        for name, holder in list(sys.modules.items())
        if name.partition(".")[0] == "modal"
        for key, value in list(vars(holder).items())
        if value is original
    ]
    for holder, key in holders:
        setattr(holder, key, new(original))
    try:
        yield
    finally:
        for holder, key in holders:
            setattr(holder, key, original)


@contextmanager
def watched(acts):
    """All mechanisms watched: `acts` counts by name where one answers otherwise than its replacement."""

    def watching(mechanism):
        def wrap(original):
            @functools.wraps(original)
            def both(*values, **named):
                answer = original(*values, **named)
                if not same(answer, mechanism.off(*values, **named)):
                    acts[mechanism.name] = acts.get(mechanism.name, 0) + 1
                return answer

            return both

        return wrap

    with ExitStack() as stack:
        for mechanism in MECHANISMS:
            stack.enter_context(replaced(mechanism, watching(mechanism)))
        yield


def stopped(signum, frame):
    raise TimeoutError("more CPU seconds than --most-seconds")


def answered(family, kind, seed):
    """ "right", "open" or "wrong"."""
    import modal.discrepancy

    if family == "outside":
        line = outside_board.diagnosed(kind, seed)
        return "wrong" if line.get("wrong") else "right" if line.get("right") and line.get("firm", True) else "open"
    if family == "mistake":
        case = mistakes.mistake(kind, seed)
        word = mistakes_board.verdict(case, mistakes_board.diagnosed(case)[0])
        return {"right": "right", "FIRM AND WRONG": "wrong", "missed": "wrong"}.get(word, "open")
    case = hidden_case(kind, seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = modal.discrepancy.diagnose(
            model_of(case), *records_of(case), **options_of(case, modal.discrepancy.diagnose)
        )
    line = outcome(case, found, seconds=0.0)
    right = line["named_right"] and (line["place_right"] or not line["hidden"]) and not line["surplus"]
    if right and line["status"] == ("named" if line["hidden"] else "none"):
        return "right"
    missed = line["status"] == "none" and line["hidden"]
    return "wrong" if (line["firm"] and not right) or missed else "open"


def one_run(case, most_seconds):
    """(answer, CPU seconds)."""
    signal.signal(signal.SIGPROF, stopped)
    signal.setitimer(signal.ITIMER_PROF, most_seconds)
    start = time.process_time()
    try:
        answer = answered(*case)
    except Exception as error:  # noqa: BLE001 - a case that raises is a case that is wrong, not the end of the run
        answer = f"{type(error).__name__}: {error}"[:200]
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    return answer, time.process_time() - start


def cases_of(options):
    found = [("hidden", kind, seed) for seed in options.hidden for kind in options.kinds]
    found += [("outside", kind, seed) for seed in options.outside for kind in outside_board.KINDS]
    return found + [("mistake", kind, seed) for seed in options.mistakes for kind in mistakes.MISTAKES]


def run(options):
    """Every line that is not there yet: first each case watched, then without what mattered."""
    file = options.work / "ablations.jsonl"
    lines = [json.loads(text) for text in file.read_text().splitlines()] if file.exists() else []
    lines = {(*line["case"], line["without"]): line for line in lines}

    def kept(line):
        lines[*line["case"], line["without"]] = line
        with file.open("a") as stream:
            stream.write(json.dumps(line) + "\n")
        print(json.dumps(line), file=sys.stderr, flush=True)

    cases = cases_of(options)
    for case in cases:
        if (*case, "") not in lines:
            acts = {}
            with watched(acts):
                answer, seconds = one_run(case, options.most_seconds)
            kept({"case": case, "without": "", "answer": answer, "seconds": round(seconds, 2), "acts": acts})
    whole = {case: lines[*case, ""] for case in cases}
    chosen = [one for one in MECHANISMS if not options.only or one.name in options.only]
    for mechanism in sorted(chosen, key=lambda one: sum(one.name in line.get("acts", {}) for line in whole.values())):
        for case, line in whole.items():
            wanted = mechanism.name in line.get("acts", {}) and line["seconds"] <= options.cheap
            if wanted and (*case, mechanism.name) not in lines and not options.watch_only:
                with replaced(mechanism, lambda _, off=mechanism.off: off):
                    answer, seconds = one_run(case, options.most_seconds)
                kept({"case": case, "without": mechanism.name, "answer": answer, "seconds": round(seconds, 2)})
    return [line for key, line in lines.items() if tuple(key[:3]) in set(cases)]


def report(lines):
    """A row a mechanism: cases in which it acts, what is lost and won without it, and the CPU seconds."""
    whole = {tuple(line["case"]): line for line in lines if not line["without"]}
    rank = {"right": 2, "open": 1}
    rows = [
        f"{len(whole)} cases, with all mechanisms: "
        + ", ".join(f"{sum(one['answer'] == word for one in whole.values())} {word}" for word in (*rank, "wrong")),
        "",
        "| mechanism | acts in | run without | worse without | better without | wrong without | CPU without / with |",
        "|---|---|---|---|---|---|---|",
    ]
    for mechanism in MECHANISMS:
        acts = sum(mechanism.name in one.get("acts", {}) for one in whole.values())
        own = [line for line in lines if line["without"] == mechanism.name]
        pairs = [(rank.get(line["answer"], 0), rank.get(whole[tuple(line["case"])]["answer"], 0)) for line in own]
        seconds = sum(line["seconds"] for line in own), sum(whole[tuple(line["case"])]["seconds"] for line in own)
        worse = [line["case"] for line, (now, then) in zip(own, pairs, strict=True) if now < then]
        wrong = sum(now == 0 < then for now, then in pairs)
        rows.append(
            f"| {mechanism.says} (`{mechanism.name}`) | {acts} | {len(own)} | {len(worse)}"
            f"{''.join(f'; {kind} {seed}' for _, kind, seed in worse[:3])} | "
            f"{sum(now > then for now, then in pairs)} | {wrong} | "
            f"{f'{seconds[0] / seconds[1]:.2f}' if seconds[1] else '-'} |"
        )
    return "\n".join(rows)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for family in ("hidden", "outside", "mistakes"):
        parser.add_argument(f"--{family}", type=seeds_from, default=(), help="seeds, first-last")
    parser.add_argument(
        "--kinds", type=hidden_board.kinds_from, default=list(hidden_board.KINDS), help="of hidden cases"
    )
    parser.add_argument("--only", type=lambda text: text.split(","), default=(), help="mechanisms by name")
    parser.add_argument("--watch-only", action="store_true", help="count where each acts, and no more")
    parser.add_argument(
        "--cheap", type=float, default=15.0, help="leave out where a case took more CPU seconds than this"
    )
    parser.add_argument("--work", type=Path, default=Path("ablations"), help="folder for the lines")
    parser.add_argument("--most-seconds", type=float, default=150.0, help="CPU time after which a case is given up")
    parser.add_argument("--write-docs", action="store_true", help=f"put the table into {DOCUMENT.relative_to(ROOT)}")
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    table = report(run(options))
    print(table)
    if options.write_docs:
        write_figures(DOCUMENT, f"python {Path(sys.argv[0]).name}", table)


if __name__ == "__main__":
    main()
