"""What the README shows must work: its commands, its sessions, its links; the examples run."""

import ast
import doctest
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


def modal_report(*arguments, cwd):
    code = "import sys; from modal.command import main; sys.argv[0] = 'modal-report'; sys.exit(main())"
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


def test_files_that_the_readme_links_to_exist(readme, repository):
    links = re.findall(r"\]\(([^)#\s]+)", readme) + re.findall(r"src=\"([^\"]+)\"", readme)
    missing = [link for link in links if not link.startswith(("http:", "https:")) and not (repository / link).exists()]
    assert not missing


def test_the_struck_mass_runs_as_its_docstring_says(repository, tmp_path):
    command = [sys.executable, "-m", "modal.examples.struck_mass", str(tmp_path)]
    result = subprocess.run(command, capture_output=True, text=True, cwd=repository, check=False)
    assert result.returncode == 0, result.stderr
    assert len(list(tmp_path.glob("*.svg"))) == 4
