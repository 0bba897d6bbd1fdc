"""One arrow okid <- era <- modal, foreign libraries behind their one package, and imports that cost little."""

import ast
import json
import subprocess
import sys

import pytest

HEAVY = (
    "rerun",
    "matplotlib",
    "control",
    "filterpy",
    "dask",
    "pint",
    "pyarrow",
    "h5py",
    "typer",
    "rich",
    "jinja2",
    "pandas",
)
BEHIND = {
    "rerun": ("modal/recording/",),
    "control": ("era/",),
    "filterpy": ("era/",),
    "matplotlib": ("modal/plots/results.py",),
    "pint": ("okid/",),
    "pyarrow": ("okid/", "modal/"),
    "h5py": ("okid/readers/",),
    "pyuff": ("okid/readers/",),
    "typer": ("modal/",),
    "rich": ("modal/",),
    "jinja2": ("modal/report/",),
    "nptdms": ("okid/readers/",),
}
SDK_FILES = {"cli", "types", "output", "exception", "app", "client", "config", "image", "object", "functions"} | {
    "schedule",
    "server",
    "runner",
}


def imported(tree):
    """(dotted name, names taken from it) of every import that runs, inside functions too; not those for types only."""
    parts = (
        part for field in ("body", "orelse", "handlers", "finalbody", "cases") for part in getattr(tree, field, ())
    )
    for node in parts:  # an import is a statement: nothing within an expression is looked at
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        if isinstance(node, ast.Import):
            yield from ((alias.name, ()) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module or "", tuple(alias.name for alias in node.names)
        yield from imported(node)


@pytest.fixture(scope="module")
def every_import(sources):
    """(file, dotted name, names taken from it) of all."""
    return [(file, name, names) for file, tree in sources.items() for name, names in imported(tree)]


def python(code, *, cwd):
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=cwd, check=False)
    assert result.returncode == 0, result.stderr
    return result.stdout


def test_lower_packages_never_import_higher_ones(every_import):
    above = {"okid": {"era", "modal"}, "era": {"modal"}, "modal": set()}
    assert not [(file, name) for file, name, _ in every_import if name.split(".")[0] in above[file.split("/")[0]]]


def test_nothing_of_ours_takes_a_name_from_the_modal_root(sources, every_import):
    """Another distribution may own `modal/__init__.py`; only modules below it are safe."""
    modules = {file.split("/")[1].removesuffix(".py") for file in sources if file.startswith("modal/")}
    wrong = [
        (file, name) for file, root, names in every_import for name in names if root == "modal" and name not in modules
    ]
    assert not wrong


def test_file_names_avoid_those_of_the_unrelated_sdk(sources):
    top = {file.split("/")[1].removesuffix(".py") for file in sources if file.startswith("modal/")}
    assert not top & SDK_FILES


@pytest.mark.parametrize("library", sorted(BEHIND))
def test_a_foreign_library_stays_behind_its_package(library, every_import):
    wrong = [
        file for file, name, _ in every_import if name.split(".")[0] == library and not file.startswith(BEHIND[library])
    ]
    assert not wrong


ALONE = """
import sys, json, warnings, numpy as np
settings = lambda: (list(warnings.filters), np.geterr(), np.get_printoptions())
for name in {above}:
    sys.modules[name] = None
before = settings()
import {package}
assert settings() == before
print(json.dumps([name for name, module in sys.modules.items() if module]))
"""


@pytest.mark.parametrize(("package", "above"), [("okid", ["era", "modal"]), ("era", ["modal"]), ("modal", [])])
def test_a_package_imports_alone_and_quietly_and_leaves_heavy_libraries_out(package, above, repository):
    """In a fresh interpreter, with the packages above it not to be had; nothing is printed, no setting changed."""
    loaded = json.loads(python(ALONE.format(above=above, package=package), cwd=repository))
    assert not {name.split(".")[0] for name in loaded} & set(HEAVY)
    assert not [name for name in loaded if name.startswith(("scipy.signal", "scipy.optimize", "scipy.stats"))]


DEMO = """
import json, sys
import numpy as np
import modal
from modal.examples.demo import demo_record
modal.identify(demo_record(np.random.default_rng(7), n_samples=2000))
print(json.dumps(list(sys.modules)))
"""
MOTOR = """
import json, sys
import numpy as np
import modal
from modal.examples.motor_propeller import Motor, measured_record
rng = np.random.default_rng(1)
slow, fast, middle = (measured_record(Motor(), rng, voltages=v, name="run") for v in ((1, 4), (3, 12), (2, 8)))
model = modal.StructuralModel(
    [[8e-5]], [[9.3e-4]], [[0]], force_map=[[0.0909]], sensor_map=[[1]], sensor_kind="velocity",
    input_names=["voltage"], output_names=["speed"], input_units=["V"], length_unit="rad", force_unit="N m",
)
assert modal.discrepancy.diagnose(model, fit=[slow, fast], held_out=middle).findings
print(json.dumps(list(sys.modules)))
"""


@pytest.mark.parametrize(("code", "unused"), [(DEMO, ("discrepancy", "report", "plots", "recording")), (MOTOR, ())])
def test_neither_road_loads_the_slow_parts_of_scipy_and_each_pays_for_the_parts_it_uses(code, unused, repository):
    """They cost more than a short identification, for one quantile, one filter or one spline."""
    loaded = json.loads(python(code, cwd=repository))
    assert "scipy.linalg" in loaded
    slow = ("scipy.signal", "scipy.stats", "scipy.interpolate", *(f"modal.{part}" for part in unused))
    assert not [name for name in loaded if name.startswith(slow)]


def test_the_public_table_is_whole():
    import modal

    assert set(modal._PLACES) == set(modal.__all__) <= set(dir(modal))
    assert all(getattr(modal, name).__name__.split(".")[-1] == name for name in modal.__all__)
    assert not hasattr(modal, "no_such_name")


def test_okid_costs_little_more_than_numpy(repository):
    """Modules, not seconds: a clock says little on a shared machine. scipy loads its parts when they are used."""

    def loaded(names):
        modules = json.loads(python(f"import sys, json, {names}; print(json.dumps(list(sys.modules)))", cwd=repository))
        return {name for name in modules if name.split(".")[0].lstrip("_") not in known}

    known = {name.lstrip("_") for name in sys.stdlib_module_names}
    more = loaded("okid") - loaded("numpy, scipy")
    assert {name.split(".")[0] for name in more} <= {"okid", "numpy"}  # numpy.random and its kin load late
    assert len(loaded("numpy, scipy") - loaded("numpy")) < 60
