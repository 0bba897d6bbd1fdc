"""Confusion of effects: cases in which one is hidden, diagnosed, and scored against what was hidden.

    python tests/benchmarks/hidden_effects.py --seeds 1000-1059 --kinds 1dof_displacement,none --work DIR --processes 2

Cases come from `tests/hidden_effects/` (an integrator of their own, sharp laws, wrong linear parameters), models and
records go in through public names only, and `modal.discrepancy.diagnose` sees nothing of the truth. One line of JSON a
case in `DIR/<kind>.jsonl`; lines that are there are not made again (`--restart` empties them), so that an interrupted
run goes on. `--report-only` prints the tables of what is there; `--write-docs` puts them into
modal/docs/discrepancy_confusion.md. Seeds of a figure are never the seeds of building: below 1000 is for building.

Goals, and what each word means, are in `hidden_scoring` (`GOALS`). Seconds are CPU time of the
diagnosis alone, one BLAS thread, on a machine that may be shared.
"""

import argparse
import json
import os
import signal
import sys
import time
import traceback
import warnings
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"
ROOT = Path(__file__).resolve().parents[2]
for folder in (ROOT, ROOT / "tests" / "hidden_effects", ROOT / "tests" / "benchmarks"):
    sys.path.insert(0, str(folder))

from hidden_cases import hidden_case  # noqa: E402 - after the path is set
from hidden_kinds import KINDS  # noqa: E402
from hidden_scoring import describe, model_of, options_of, outcome, records_of, report  # noqa: E402
from stamps import seeds_from, write_figures  # noqa: E402

DOCUMENT = ROOT / "modal" / "docs" / "discrepancy_confusion.md"


def stopped(signum, frame):
    raise TimeoutError("stopped: more CPU seconds than --most-seconds")


def diagnosed(kind, seed, most_seconds):
    """The line of one case."""
    from modal.discrepancy import diagnose

    case = hidden_case(kind, seed)
    model, (fit, held_out) = model_of(case), records_of(case)
    signal.signal(signal.SIGPROF, stopped)
    signal.setitimer(signal.ITIMER_PROF, most_seconds)
    start = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = diagnose(model, fit, held_out, **options_of(case, diagnose))
        seconds = time.process_time() - start
    except Exception as error:  # noqa: BLE001 - a case that raises is a case that is wrong, not the end of the run
        where = traceback.extract_tb(error.__traceback__)[-1]
        text = f"{type(error).__name__}: {error}".replace("|", "/").replace("\n", " ")[:200]
        return {
            **describe(case),
            "error": f"{text} ({Path(where.filename).name}:{where.lineno})",
            "seconds": time.process_time() - start,
        }
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    return outcome(case, found, seconds=seconds)


def kinds_from(text):
    """Kinds by name, "all" for every one."""
    chosen = list(KINDS) if text == "all" else text.split(",")
    unknown = set(chosen) - set(KINDS)
    if unknown:
        raise argparse.ArgumentTypeError(f"no kinds {sorted(unknown)}; there are {', '.join(KINDS)}, and all")
    return chosen


def lines_in(folder, kinds):
    """All lines of these kinds, the last one of each case."""
    files = [folder / f"{kind}.jsonl" for kind in kinds]
    lines = [json.loads(line) for file in files if file.exists() for line in file.read_text().splitlines()]
    return list({(line["kind"], line["seed"]): line for line in lines}.values())


def wanted_cases(options):
    """All (kind, seed)."""
    seeds = {kind: options.none_seeds if kind == "none" else options.seeds for kind in options.kinds}
    return {(kind, seed) for kind in options.kinds for seed in seeds[kind]}


def run(options):
    """Every case that is not there yet."""
    done = {(line["kind"], line["seed"]) for line in lines_in(options.work, options.kinds)}
    # by seed, then kind: an interrupted run has something of every kind
    missing = sorted(wanted_cases(options) - done, key=lambda case: (case[1], case[0]))
    with ProcessPoolExecutor(options.processes) as pool:
        jobs = {pool.submit(diagnosed, kind, seed, options.most_seconds): (kind, seed) for kind, seed in missing}
        for i, job in enumerate(as_completed(jobs)):
            kind, _ = jobs[job]
            with (options.work / f"{kind}.jsonl").open("a") as file:
                file.write(json.dumps(job.result()) + "\n")
            print(f"{i + 1} of {len(jobs)} cases", end="\r", file=sys.stderr, flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=seeds_from, default=seeds_from("1000-1059"))
    parser.add_argument(
        "--none-seeds",
        type=seeds_from,
        help='of the kind "none"; by default those of the others, and 40 more from 60 on',
    )
    parser.add_argument("--kinds", type=kinds_from, default=kinds_from("all"), help=", ".join(KINDS))
    parser.add_argument("--work", type=Path, default=Path("hidden_effects"), help="folder for the lines")
    parser.add_argument("--processes", type=int, default=1, help="one BLAS thread each")
    parser.add_argument("--most-seconds", type=float, default=300.0, help="CPU time after which a case is given up")
    parser.add_argument("--restart", action="store_true", help="empty the lines of these kinds first")
    parser.add_argument("--report-only", action="store_true", help="tables of the lines that are there")
    parser.add_argument("--write-docs", action="store_true", help=f"put the tables into {DOCUMENT.relative_to(ROOT)}")
    options = parser.parse_args()
    if options.none_seeds is None:  # a false name is rarer than a wrong one: more cases
        last = max(options.seeds)
        options.none_seeds = (
            [*options.seeds, *range(last + 1, last + 41)] if len(options.seeds) >= 60 else options.seeds
        )
    options.work.mkdir(parents=True, exist_ok=True)
    if options.restart:
        for kind in options.kinds:
            (options.work / f"{kind}.jsonl").unlink(missing_ok=True)
    if not options.report_only:
        run(options)
    wanted = wanted_cases(options)
    lines = [line for line in lines_in(options.work, options.kinds) if (line["kind"], line["seed"]) in wanted]
    if not lines:
        sys.exit("no case to report on")
    tables = report(lines)
    print(tables)
    if options.write_docs:
        write_figures(DOCUMENT, command_of(options), tables, key="--write-docs")


def command_of(options):
    """What makes the same lines again."""
    words = ["python tests/benchmarks/hidden_effects.py", f"--seeds {spans(options.seeds)}"]
    words += [f"--none-seeds {spans(options.none_seeds)}"] if options.none_seeds != options.seeds else []
    return " ".join([*words, f"--most-seconds {options.most_seconds:g}", "--work DIR --write-docs"])


def spans(seeds):
    """ "2130-2149" for what `seeds_from` gave."""
    ends = [i for i in range(1, len(seeds)) if seeds[i] != seeds[i - 1] + 1]
    parts = [seeds[a:b] for a, b in zip([0, *ends], [*ends, len(seeds)], strict=True)]
    return ",".join(f"{part[0]}-{part[-1]}" for part in parts)


if __name__ == "__main__":
    main()
