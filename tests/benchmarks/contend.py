"""In the environment of one contender: identify every task of some files, one line of JSON each as soon as it is done.

    python contend.py CONTENDER SETTING TASKS.npz RESULTS.jsonl [TASKS.npz RESULTS.jsonl ...]

`leaderboard.py` starts it; a crash, a refusal or a time limit loses one line, not the run. CPU time is that of the call
alone, after the imports of a first small task.
"""

import contextlib
import importlib
import io
import json
import resource
import signal
import sys
import time
import warnings
from pathlib import Path

import numpy as np

CPU_LIMIT = 240.0
"""[s] for one task that states no other."""
MEMORY_LIMIT = 8 * 2**30


class OverTimeError(Exception):
    """The CPU limit of one task."""


def over_time(_signal, _frame):
    raise OverTimeError("not done within the CPU time of one task")


def plain(value):
    """Arrays to lists, complex matrices to their real form's parts."""
    if isinstance(value, dict):
        return {key: plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [plain(part) for part in value]
    if isinstance(value, np.ndarray):
        return {"re": value.real.tolist(), "im": value.imag.tolist()} if np.iscomplexobj(value) else value.tolist()
    return value.item() if isinstance(value, np.generic) else value


def timed(identify, records, dt, *, setting, order, limit=CPU_LIMIT):
    """The model and the CPU seconds, or the words of what went wrong."""
    start = time.process_time()
    signal.setitimer(signal.ITIMER_PROF, limit)
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            found = plain(identify(records, dt, setting=setting, order=order))
    except (Exception, SystemExit) as problem:  # noqa: BLE001 - whatever a peer raises is its row
        found = {"failure": f"{type(problem).__name__}: {problem}"[:300]}
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    return {**found, "cpu": time.process_time() - start}


def warm_up(identify, setting):
    """Imports and first-call costs, on a small record."""
    rng = np.random.default_rng(0)
    inputs = rng.standard_normal((900, 1))
    outputs = np.array([np.convolve(inputs[:, 0], 0.9 ** np.arange(50))[:900]]).T
    timed(identify, [(inputs, outputs + 0.1 * rng.standard_normal((900, 1)))], 0.01, setting=setting, order=2)


def work_through(identify, setting, tasks_path, results):
    """What has no line yet in the results."""
    done = len(results.read_text().splitlines()) if results.exists() else 0
    with np.load(tasks_path) as stored:
        data = dict(stored)
    for task in json.loads(str(data["tasks"]))[done:]:
        records = [(data[inputs].copy(), data[outputs].copy()) for inputs, outputs in task["records"]]
        limit = task.get("cpu_limit", CPU_LIMIT)
        found = timed(identify, records, task["dt"], setting=setting, order=task["order"], limit=limit)
        with results.open("a") as file:
            file.write(json.dumps(found) + "\n")


def main():
    if "--help" in sys.argv[1:]:
        print(__doc__)
        raise SystemExit
    name, setting, *files = sys.argv[1:]
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT, MEMORY_LIMIT))
    signal.signal(signal.SIGPROF, over_time)
    warnings.simplefilter("ignore")
    sys.path.insert(0, str(Path(__file__).parent / "contenders"))
    identify = importlib.import_module(name).identify
    warm_up(identify, setting)
    for tasks_path, results_path in zip(files[::2], files[1::2], strict=True):
        work_through(identify, setting, tasks_path, Path(results_path))


if __name__ == "__main__":
    main()
