"""What the README shows must work: its commands, its sessions, its links; the examples run."""

import ast
import doctest
import importlib
import re
import subprocess
import sys

import pytest


@pytest.fixture(scope="module")
def readme(repository):
    return (repository / "README.md").read_text(encoding="utf-8")


def blocks(readme, *languages):
    found = re.findall(r"^```(\w*)\n(.*?)^```", readme, re.MULTILINE | re.DOTALL)
    return [text for language, text in found if language in languages]


def pages_of(repository):
    return [repository / "README.md", *sorted((repository / "modal" / "docs").glob("*.md"))]


def modal_report(*arguments, cwd):
    code = "import sys; from modal.command.main import main; sys.argv[0] = 'modal-report'; sys.exit(main())"
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, check=False)


def test_every_command_of_the_readme_exists(readme, repository):
    commands = set(re.findall(r"modal-report +([a-z]+)", readme))
    assert {"run", "demo", "gap"} <= commands
    for command in commands:
        result = modal_report(command, "--help", cwd=repository)
        assert result.returncode == 0, result.stderr


def test_every_option_of_the_readme_exists(readme, repository):
    for line in "\n".join(blocks(readme, "", "sh", "bash", "shell", "console")).splitlines():
        call = re.search(r"modal-report +([a-z]+)(.*)", line.split("#")[0])
        if call:
            text = modal_report(call.group(1), "--help", cwd=repository).stdout
            for option in re.findall(r"(?<= )--?[a-z][a-z-]*", call.group(2)):
                assert option in text, f"{call.group(1)} {option}"


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
    command = [sys.executable, "-m", "modal.examples.struck_mass", str(tmp_path)]
    result = subprocess.run(command, capture_output=True, text=True, cwd=repository, check=False)
    assert result.returncode == 0, result.stderr
    assert len(list(tmp_path.glob("*.svg"))) == 4
