"""The leaderboard: accuracy and cost of this repository and of its peers on the same problems, one command, one table.

    python tests/benchmarks/leaderboard.py --work DIR [--systems 30] [--realisations 12] [--records FOLDER]
        [--only ours,slicot] [--parts sweep,random,records,cost] [--again ours]
        [--write-table modal/docs/leaderboard.md]

Every contender runs in a virtual environment of its own below DIR, made by pip at the first call; one that cannot be
installed, or that fails on a problem, is a row that says so. Every model is kept in DIR as JSON, so a run that was
interrupted goes on where it was; `--again ours` forgets what was kept of a contender. Run it with the Python in which
this repository is installed. What is measured: the peers' settings on seeds of building (sweep), `random_board.py`
(random problems), `records_board.py` (measured records), `cost_board.py` (time); what each contender does:
`contenders/`.
"""

import argparse
import json
import shutil
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent / "reference"), str(HERE.parents[1])]

import random_board  # noqa: E402 - after the path is set
from cost_board import costs  # noqa: E402
from environments import CONTENDERS, contender, versions  # noqa: E402
from tables import (  # noqa: E402
    WHO,
    cost_table,
    document,
    random_table,
    records_table,
    settings_list,
    sweep_table,
    write_document,
)

PARTS = ("sweep", "random", "records", "cost")
FIRST_SEED = 5000
BUILDING_SEED = 1000


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, required=True, help="folder for environments, problems and results")
    parser.add_argument("--systems", type=int, default=30)
    parser.add_argument("--peer-systems", type=int, help="the peers on the first so many systems only: some are slow")
    parser.add_argument("--realisations", type=int, default=12, help="of the noise, for each system")
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    parser.add_argument("--sweep-systems", type=int, default=4, help="systems of building for the peers' settings")
    parser.add_argument("--sweep-realisations", type=int, default=3)
    parser.add_argument("--rounds", type=int, default=3, help="of each timing")
    parser.add_argument("--records", type=Path, help="folder of measured records, each with its about.json")
    parser.add_argument("--only", default=",".join(CONTENDERS), help="contenders, with commas between")
    parser.add_argument("--parts", default=",".join(PARTS))
    parser.add_argument("--again", default="", help="contenders whose kept results are forgotten first")
    parser.add_argument("--write-table", type=Path, help="the Markdown file to write the table into")
    options = parser.parse_args()
    for given, known in ((options.only, CONTENDERS), (options.parts, PARTS), (options.again, CONTENDERS)):
        unknown = set(filter(None, given.split(","))) - set(known)
        if unknown:
            parser.error(f"{', '.join(sorted(unknown))}: known are {', '.join(known)}")
    return options


def forget(name, work):
    """What was kept of a contender; for ours also the bands, and so the peers' records, stay under their factor."""
    for path in [*work.glob(f"runs/random/*/{name}, *"), *work.glob(f"runs/records/*/{name}*")]:
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    kept = work / "costs.json"
    if kept.exists():
        lines = json.loads(kept.read_text())
        for line in lines.values():
            for who in [who for who in line if who.split(",")[0] == name]:
                del line[who]
        kept.write_text(json.dumps(lines))


def random_part(options, only):
    seeds = range(options.first_seed, options.first_seed + options.systems)
    cases = [random_board.prepare(seed, options.realisations, options.work) for seed in seeds]
    n_peers = options.systems if options.peer_systems is None else min(options.systems, options.peer_systems)
    rows = []
    for name in only:
        own = cases if name == "ours" else cases[:n_peers]
        for setting in contender(name).SETTINGS:
            scores = random_board.contend(own, name, setting, options.work)
            rows.append((name, setting, random_board.figures(own, scores)))
            if name == "ours" and n_peers < len(
                cases
            ):  # once more on the systems of the peers, to compare like with like
                rows.append((name, setting, random_board.figures(cases[:n_peers], scores[:n_peers])))
            tell(f"{name}, {setting}: done on {len(own)} systems")
    (options.work / "random.json").write_text(json.dumps(rows, indent=1))
    return random_table(rows, first_seed=options.first_seed, realisations=options.realisations)


def sweep_part(options, only):
    """Every swept setting of each peer on systems of building; a word where SETTINGS holds another than the best."""
    n_systems, n_realisations = options.sweep_systems, options.sweep_realisations
    seeds = range(BUILDING_SEED, BUILDING_SEED + n_systems)
    cases = [random_board.prepare(seed, n_realisations, options.work) for seed in seeds]
    rows = []
    for name in only:
        for form, values in getattr(contender(name), "SWEEP", {}).items():
            own = []
            for setting in map(form.format, values):
                scores = random_board.contend(cases, name, setting, options.work)
                figures = random_board.figures(cases, scores)
                own.append((name, form, setting, {**figures, "score": random_board.sweep_score(cases, scores)}))
            least = min(round(row[3]["score"], 2) for row in own)
            best = [row[2] for row in own if round(row[3]["score"], 2) == least]
            known = set(best) & set(contender(name).SETTINGS)
            tell(f"{name}: best is {' or '.join(best)}" + ("" if known else ", which SETTINGS lacks"))
            rows += own
    (options.work / "sweep.json").write_text(json.dumps(rows, indent=1))
    return sweep_table(rows, n_systems=n_systems, first_seed=BUILDING_SEED, realisations=n_realisations)


def records_part(options, only):
    from records_board import SETTINGS, contend, measured_problems

    problems, left_out = measured_problems(options.records)
    rows = []
    for problem in problems:
        rows.append(contend(problem, [name for name in only if name in SETTINGS and name != "ours"], options.work))
        tell(f"record {problem.name}: done")
    (options.work / "records.json").write_text(json.dumps(rows, indent=1))
    return records_table(rows, left_out)


def tell(what):
    sys.stderr.write(f"{what}\n")


def main():
    options = arguments()
    options.work = options.work.resolve()
    options.work.mkdir(parents=True, exist_ok=True)
    for name in filter(None, options.again.split(",")):
        forget(name, options.work)
    only = [name for name in CONTENDERS if name in options.only.split(",")]
    parts = options.parts.split(",")
    sections, commands = {WHO: ""}, {}
    for part, (title, make) in MADE.items():
        if part in parts and (part != "records" or options.records):
            sections[title] = make(options, only)
            commands[title] = part, shown(options, part)
    # the environments are made on the way, so the versions are known only now
    known = {name: (contender(name), versions(name, options.work)) for name in CONTENDERS}
    sections[WHO] = settings_list(known)
    print(document(sections))
    if options.write_table:
        write_document(options.write_table.resolve(), sections, commands)


def cost_part(options, only):
    return cost_table(costs(only, options.work, options.rounds))


def shown(options, part):
    """The command of a part, with the arguments that decide its figures."""
    systems = f"--systems {options.systems}"
    if options.peer_systems is not None:
        systems += f" --peer-systems {options.peer_systems}"
    given = {
        "sweep": f"--sweep-systems {options.sweep_systems} --sweep-realisations {options.sweep_realisations}",
        "random": f"{systems} --realisations {options.realisations} --first-seed {options.first_seed}",
        "records": "--records FOLDER",
        "cost": f"--rounds {options.rounds}",
    }
    only = f" --only {options.only}" if options.only != ",".join(CONTENDERS) else ""
    return f"python tests/benchmarks/leaderboard.py --work DIR --parts {part} {given[part]}{only}"


MADE = {
    "sweep": ("Settings of the peers", sweep_part),
    "random": ("Random problems", random_part),
    "records": ("Measured records", records_part),
    "cost": ("Cost", cost_part),
}
"""Part: title of its section, and what makes it."""


if __name__ == "__main__":
    main()
