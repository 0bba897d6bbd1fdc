"""What the README shows must work: its commands, its sessions, its links; the examples run."""

import ast
import doctest
import fnmatch
import importlib
import json
import re
import shlex
import subprocess
import sys
import tomllib

import pytest

from modal.examples.files import write_files


@pytest.fixture(scope="module")
def readme(repository):
    return (repository / "README.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """What `modal-report demo --files` writes."""
    return {path.name: path for path in write_files(tmp_path_factory.mktemp("files"))}


def blocks(readme, *languages):
    found = re.findall(r"^```(\w*)\n(.*?)^```", readme, re.MULTILINE | re.DOTALL)
    return [text for language, text in found if language in languages]


def pages_of(repository):
    return [repository / "README.md", *sorted((repository / "modal" / "docs").glob("*.md"))]


HELP = """
import contextlib, io, json, sys
from modal.command.main import status
said = {}
for command in sys.argv[1:]:
    text = io.StringIO()
    with contextlib.redirect_stdout(text):
        number = status([command, "--help"])
    said[command] = [number, text.getvalue()]
print("\\n" + json.dumps(said))
"""


def test_every_command_and_option_of_the_readme_exists(readme, repository):
    calls = re.findall(r"modal-report +([a-z]+)([^`\n#]*)", readme)
    commands = {command for command, _ in calls}
    assert {"run", "demo", "gap", "check", "diff", "view"} <= commands
    done = subprocess.run(
        [sys.executable, "-c", HELP, *commands], capture_output=True, text=True, cwd=repository, check=False
    )
    assert done.returncode == 0, done.stderr
    helps = json.loads(done.stdout.splitlines()[-1])
    options = [(command, option) for command, rest in calls for option in re.findall(r"(?<= )--?[a-z][a-z-]*", rest)]
    assert len(options) > 10
    assert [(command, status) for command, (status, _) in helps.items() if status != 0] == []
    assert [(command, option) for command, option in options if option not in helps[command][1]] == []


def test_every_file_that_a_command_of_the_pages_names_can_be_written_to_try_it(repository, files):
    n_files = 0
    for page in pages_of(repository):
        text = page.read_text(encoding="utf-8").replace("\\\n", " ")
        for line in re.findall(r"^modal-report (?!demo)(.*)", text, re.MULTILINE):
            words = shlex.split(line, comments=True)
            named = [word for word in words if re.fullmatch(r"[\w*]+\.(csv|toml|uff|mat|npz)", word)]
            assert [name for name in named if not fnmatch.filter(files, name)] == [], f"{page.name}: {line}"
            n_files += len(named)
    assert n_files > 12


def test_the_notebook_runs_from_a_csv_to_a_controllers_model(repository, files, monkeypatch):
    monkeypatch.chdir(files["shaker.csv"].parent)
    cells = json.loads((repository / "modal" / "docs" / "first_steps.ipynb").read_text(encoding="utf-8"))["cells"]
    assert len(cells) <= 15
    names, code = {}, ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    for text in code:
        exec(text, names)  # noqa: S102 - the notebook is ours
    assert set(re.findall(r"^(?:import|from) (\S+)", "\n".join(code), re.MULTILINE)) == {"modal", "okid"}
    assert names["scaled"].modal_mass == pytest.approx(3.6823, abs=4 * names["scaled"].modal_mass_std.max())
    assert [len(names[one].axes) > 0 for one in ("stabilisation", "measured_over_model", "mac_picture")] == [True] * 3
    assert names["plant"].output_labels == ["root", "middle", "tip"]


def test_the_sessions_of_the_readme_print_what_they_show(readme):
    flags = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS
    sessions = "\n".join(text for text in blocks(readme, "python", "pycon") if ">>>" in text)
    test = doctest.DocTestParser().get_doctest(sessions, {}, "README.md", "README.md", 0)
    assert doctest.DocTestRunner(optionflags=flags).run(test).failed == 0


def test_the_names_in_the_code_of_the_readme_exist(readme):
    import era
    import modal
    import okid

    roots = {"okid": okid, "era": era, "modal": modal}
    for text in blocks(readme, "python"):
        if ">>>" in text:
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in roots:
                assert hasattr(roots[node.value.id], node.attr), f"{node.value.id}.{node.attr}"


def test_the_effect_of_the_page_passes_its_own_check(repository):
    page = (repository / "modal" / "docs" / "discrepancy.md").read_text(encoding="utf-8")
    (text,) = (text for text in blocks(page, "python") if "register(" in text)
    names = {}
    exec(text.partition("found =")[0], names)  # noqa: S102 - the page is ours
    assert "cubic_drag" in names["mine"]


def test_public_names_that_the_pages_speak_of_exist(repository):
    """A dotted name in backticks is public: it can be reached from its package without importing anything else."""
    n_names = 0
    for page in pages_of(repository):
        for name in re.findall(r"`((?:okid|era|modal)\.[\w.]+)[`(]", page.read_text(encoding="utf-8")):
            package, *parts = name.split(".")
            thing = importlib.import_module(package)
            for part in parts:
                assert part in getattr(thing, "__all__", dir(thing)), f"{page.name}: {name}"
                thing = getattr(thing, part)
            n_names += 1
    assert n_names > 10


def test_folders_that_the_pages_speak_of_exist(repository):
    for page in pages_of(repository):
        for name in re.findall(r"`((?:okid|era|modal|tests)/[\w/]*)`", page.read_text(encoding="utf-8")):
            assert (repository / name).exists(), f"{page.name}: {name}"


def layers(repository):
    """[the parts of one layer of modal] from top to bottom, as import-linter holds them apart."""
    settings = tomllib.loads((repository / "pyproject.toml").read_text(encoding="utf-8"))
    (contract,) = (one for one in settings["tool"]["importlinter"]["contracts"] if one.get("containers") == ["modal"])
    return [layer.split(" : ") for layer in contract["layers"]]


def test_the_layers_are_the_folders_of_modal(repository):
    parts = [part for layer in layers(repository) for part in layer]
    assert sorted(parts) == sorted(file.parent.name for file in (repository / "modal").glob("*/__init__.py"))


def test_the_readme_names_the_parts_in_the_order_of_the_layers(readme, repository):
    table = readme.partition("## Where is what")[2].partition("\n\n[")[0]
    firsts = [line.split("|")[1] for line in table.splitlines() if line.startswith("|")]
    named = [part for cell in firsts for part in re.findall(r"`modal/(\w+)/`", cell)]
    assert named == [part for layer in layers(repository) for part in layer]


def test_the_page_on_the_house_draws_the_layers_as_they_are(repository):
    page = (repository / "modal" / "docs" / "house.md").read_text(encoding="utf-8")
    drawn = [re.split(r" {2,}", line)[0].split(" | ") for line in blocks(page, "")[0].splitlines()]
    assert drawn == layers(repository)


def test_the_functions_of_the_walk_are_where_the_page_says(repository):
    page = (repository / "modal" / "docs" / "house.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| \w+ \| `([\w/]+)` \| ((?:`\w+`(?:, )?)+) \|", page, re.MULTILINE)
    assert len(rows) > 14
    for folder, names in rows:
        text = "\n".join(file.read_text(encoding="utf-8") for file in (repository / folder).glob("*.py"))
        for name in re.findall(r"\w+", names):
            assert re.search(rf"^def {name}\(", text, re.MULTILINE), f"{folder}: {name}"


def test_what_the_pages_link_to_exists(repository):
    assert len(pages_of(repository)) > 10
    for page in pages_of(repository):
        text = page.read_text(encoding="utf-8")
        for link, heading in re.findall(r"\]\(([^)#\s]*)#?([^)\s]*)\)", text):
            if link.startswith(("http:", "https:")):
                continue
            target = page.parent / link if link else page
            assert target.exists(), f"{page.name}: {link}"
            titles = re.findall(r"^#+ (.+)$", target.read_text(encoding="utf-8"), re.MULTILINE) if heading else []
            anchors = {re.sub(r"[^\w-]", "", title.lower().replace(" ", "-")) for title in titles}
            assert not heading or heading in anchors, f"{page.name}: {link}#{heading}"


def test_every_page_is_linked_to(repository):
    folder = repository / "modal" / "docs"
    readme = (repository / "README.md").read_text(encoding="utf-8")
    for page in folder.glob("*.md"):
        others = [other.read_text(encoding="utf-8") for other in folder.glob("*.md") if other != page]
        assert f"](modal/docs/{page.name}" in readme or any(f"]({page.name}" in text for text in others), page.name


def test_the_struck_mass_runs_as_its_docstring_says(repository, tmp_path):
    command = [sys.executable, "-m", "modal.examples.struck_mass", "-o", str(tmp_path)]
    result = subprocess.run(command, capture_output=True, text=True, cwd=repository, check=False)
    assert result.returncode == 0, result.stderr
    assert len(list(tmp_path.glob("*.svg"))) == 4


def test_ci_pins_a_version_within_bounds_and_a_hash_for_all_that_is_installed(repository):
    pinned = dict(
        re.findall(
            r"^([a-z0-9._-]+)==([^ ]+) --hash=sha256:[0-9a-f]{64}$",
            (repository / ".ci" / "pinned.txt").read_text(),
            re.MULTILINE,
        )
    )
    text = tomllib.loads((repository / "pyproject.toml").read_text(encoding="utf-8"))
    wanted = text["project"]["dependencies"] + text["dependency-groups"]["test"]
    for name, least in (each.lower().split(">=") for each in wanted):
        assert tuple(map(int, pinned[name].split(".")[:3])) >= tuple(map(int, least.split("."))), name


def test_recipe_and_citation_say_what_pyproject_says(repository):
    project = tomllib.loads((repository / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    recipe = (repository / "modal" / "docs" / "site" / "recipe.yaml").read_text(encoding="utf-8")
    run = re.search(r"  run:\n((?:    - .*\n)+)", recipe)[1].replace("matplotlib-base", "matplotlib")
    assert re.findall(r"- (.*)", run) == [
        each.replace(">=", " >=") for each in (f"python{project['requires-python']}", *project["dependencies"])
    ]
    version = re.search(r'__version__ = "(.*)"', (repository / "okid" / "__init__.py").read_text(encoding="utf-8"))[1]
    cited = (repository / "modal" / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\n  version: {version}\n" in recipe
    assert f"\nversion: {version}\n" in cited
    assert f"\nlicense: {project['license']}\n" in cited
