"""A virtual environment for each peer, made once; and a contender run in its own process there."""

import importlib
import json
import os
import subprocess
import sys
import venv
from pathlib import Path

HERE = Path(__file__).resolve().parent
REPOSITORY = HERE.parents[1]
CONTENDERS = {
    "ours": "okid_modal",
    "slicot": "slicot_subspace",
    "refined": "refined_subspace",
    "sippy": "sippy_subspace",
    "nfoursid": "nfoursid_subspace",
    "mdof": "mdof_okid",
    "modred": "modred_okid",
    "pyoma2": "pyoma_ssi",
    "pyyeti": "pyyeti_era",
    "slycot": "slycot_subspace",
}
THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")


def contender(name):
    """The module of a contender; its package is imported only when it identifies."""
    folder = str(HERE / "contenders")
    if folder not in sys.path:
        sys.path.insert(0, folder)
    return importlib.import_module(CONTENDERS[name])


def interpreter(name, work):
    """(path, "") of a Python with the contender's packages, or ("", why there is none)."""
    requirements = contender(name).REQUIREMENTS
    if not requirements:
        return sys.executable, ""
    folder = work / "environments" / name
    python = folder / "bin" / "python"
    said = folder / "installed.json"
    if not said.exists():
        venv.create(folder, with_pip=True, clear=True)
        plain = [part for part in requirements if not part.startswith("--")]
        problem = _install(python, plain)
        for special in (part for part in requirements if part.startswith("--")):
            problem = problem or _install(python, special.split())
        said.write_text(json.dumps({"problem": problem, "versions": _versions(python)}))
    problem = json.loads(said.read_text())["problem"]
    return ("", problem) if problem else (str(python), "")


def versions(name, work):
    """ "package version" of what a peer's environment was asked to hold."""
    said = work / "environments" / name / "installed.json"
    if not said.exists():
        return ""
    listed = json.loads(said.read_text())["versions"]
    installed = {entry["name"].lower().replace("_", "-"): entry["version"] for entry in listed}
    wanted = [part.split()[-1] for part in contender(name).REQUIREMENTS]
    return ", ".join(f"{part} {installed[part.lower()]}" for part in wanted if _shown(part, installed))


def _shown(part, installed):
    return part.lower() in installed and part not in {"numpy", "cython", "wheel"}


def _install(python, what):
    done = subprocess.run(
        [python, "-m", "pip", "install", "-q", "--disable-pip-version-check", *what],
        capture_output=True,
        text=True,
        check=False,
    )
    return f"pip install {' '.join(what)}: {done.stderr.strip().splitlines()[-1][:200]}" if done.returncode else ""


def _versions(python):
    done = subprocess.run(
        [python, "-m", "pip", "list", "--format", "json", "--disable-pip-version-check"],
        capture_output=True,
        text=True,
        check=False,
    )
    return json.loads(done.stdout) if done.returncode == 0 else []


def run_tasks(name, setting, jobs, *, work):
    """The lines of JSON of each job, one a task; what is there already is kept, and a crash costs its own task only.

    `jobs` holds (path of the tasks, path of the results, number of tasks); one process works through all of them.
    """
    python, problem = interpreter(name, work)
    for _, results, _ in jobs:
        results.parent.mkdir(parents=True, exist_ok=True)
    while waiting := [job for job in jobs if len(read_lines(job[1])) < job[2]]:
        if problem:
            for _, results, n_tasks in waiting:
                _append(results, [{"failure": f"not installed: {problem}"}] * (n_tasks - len(read_lines(results))))
            break
        files = [str(path) for tasks, results, _ in waiting for path in (tasks, results)]
        before = _n_lines(waiting)
        done = subprocess.run(
            [python, HERE / "contend.py", CONTENDERS[name], setting, *files],
            env=environment(name),
            capture_output=True,
            text=True,
            check=False,
        )
        left = [results for _, results, n_tasks in waiting if len(read_lines(results)) < n_tasks]
        if left and (done.returncode or _n_lines(waiting) == before):
            last = (done.stderr.strip().splitlines() or [""])[-1][:200]
            _append(left[0], [{"failure": f"the process ended with status {done.returncode}: {last}"}])
    return [read_lines(results)[:n_tasks] for _, results, n_tasks in jobs]


def _n_lines(jobs):
    return sum(len(read_lines(results)) for _, results, _ in jobs)


def environment(name):
    return {**os.environ, **THREADS, **({"PYTHONPATH": str(REPOSITORY)} if name == "ours" else {"MPLBACKEND": "agg"})}


def read_lines(path):
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def _append(path, entries):
    with path.open("a") as file:
        file.writelines(json.dumps(entry) + "\n" for entry in entries)
