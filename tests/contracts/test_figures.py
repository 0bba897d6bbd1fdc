"""Figures in README and docs: each says command and commit, and the command can be given; the benchmarks start."""

import json
import re
import subprocess
import sys

import pytest

RUNNER = """
import contextlib, io, json, os, pathlib, runpy, sys
before_path, before = list(sys.path), set(sys.modules)
said = {}
for script in sys.argv[1:]:
    sys.path[:] = [str(pathlib.Path(script).parent), *before_path]
    sys.argv = [script, "--help"]
    text, status = io.StringIO(), "no SystemExit"
    with contextlib.redirect_stdout(text):
        try:
            runpy.run_path(script, run_name="__main__")
        except SystemExit as end:
            status = end.code or 0
        except BaseException as problem:
            status = repr(problem)
    said[script] = [status, text.getvalue()]
    helpers = {name for name in set(sys.modules) - before if getattr(sys.modules[name], "__file__", "") and
               str(sys.modules[name].__file__).startswith(str(pathlib.Path(script).parents[1]))}
    for name in helpers:  # the next script must find its own
        del sys.modules[name]
print("\\n" + json.dumps(said))
"""
NUMBER = re.compile(r"\d")


@pytest.fixture(scope="module")
def stamps(repository):
    sys.path.insert(0, str(repository / "tests" / "benchmarks"))
    try:
        import stamps
    finally:
        sys.path.pop(0)
    return stamps


@pytest.fixture(scope="module")
def every_block(stamps, repository):
    return [block for page in stamps.pages(repository) for block in stamps.blocks(page)]


@pytest.fixture(scope="module")
def help_of(repository):
    """{name: (status, what --help prints)} of every script in tests/benchmarks, in one process without peers."""
    files = sorted((repository / "tests" / "benchmarks").glob("*.py"))
    scripts = [str(file) for file in files if 'if __name__ == "__main__":' in file.read_text(encoding="utf-8")]
    done = subprocess.run(
        [sys.executable, "-c", RUNNER, *scripts], capture_output=True, text=True, cwd=repository, check=False
    )
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout.splitlines()[-1])
    return {
        f"tests/benchmarks/{script.replace(chr(92), '/').rsplit('/', 1)[1]}": tuple(said[script]) for script in said
    }


def test_every_benchmark_starts_and_says_what_it_does(help_of):
    assert len(help_of) >= 15
    for script, (status, text) in help_of.items():
        assert status == 0, f"{script}: {status}"
        assert len(text.split()) > 20, script


def test_a_table_with_numbers_stands_in_a_block_of_figures(stamps, repository):
    for page in stamps.pages(repository):
        covered = {line for block in stamps.blocks(page) for line in range(block.first, block.last)}
        lines = page.read_text(encoding="utf-8").splitlines()
        fenced = False
        for number, line in enumerate(lines, 1):
            fenced ^= line.lstrip().startswith("```")
            if fenced or not line.startswith("|") or not NUMBER.search(re.sub(r"`[^`]*`|\([^)]*\)", "", line)):
                continue
            top = number - 1
            while lines[top - 1].startswith("|"):
                top -= 1
            above = next((above for above in reversed(lines[:top]) if above.strip()), "")
            assert number in covered or above == stamps.NONE, f"{page.name}, line {number}: {line[:60]}"


def test_every_block_says_commit_and_command(every_block, repository):
    assert {block.page.name for block in every_block} >= {"README.md", "identification.md", "leaderboard.md"}
    for block in every_block:
        where = f"{block.page.name}, line {block.first}"
        assert block.commit, f"{where}: no `Measured at COMMIT by ...`"
        assert re.fullmatch(r"[0-9a-f]{12}", block.hash), where
        assert block.commands, where
        assert block.of, where
        for name in block.files:
            assert (repository / name).exists(), f"{where}: {name}"
        if block.own_command == "the command of each line":
            tables = [line for line in block.text.splitlines() if line.startswith("|")]
            for line in tables[2:]:
                assert "`" in line or line.rstrip(" |").endswith("same"), f"{where}: {line[:60]}"


def test_every_command_of_the_pages_can_be_given(stamps, repository, help_of):
    for page in stamps.pages(repository):
        text = re.sub(r"\\\n *", " ", page.read_text(encoding="utf-8"))
        for command in re.findall(r"(?:python|pytest) [^`\n]*?tests/[^`\n]*", text):
            for script in stamps.scripts([command]):
                assert (repository / script).is_file(), f"{page.name}: {command}"
                for option in re.findall(r"(?<= )--[a-z][a-z-]*", command) if script in help_of else ():
                    assert option in help_of[script][1], f"{page.name}: {command}: {option}"


def test_the_hash_goes_by_what_the_figures_depend_on(stamps, tmp_path):
    for name, text in {"okid/a.py": "1", "era/b.py": "2", "script.py": "3"}.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    before = stamps.hash_of(["okid", "script.py"], tmp_path)
    (tmp_path / "era" / "b.py").write_text("other")
    assert stamps.hash_of(["script.py", "okid"], tmp_path) == before
    (tmp_path / "okid" / "a.py").write_text("other")
    assert stamps.hash_of(["okid", "script.py"], tmp_path) != before


def test_figures_written_by_a_command_take_the_place_of_its_last_ones(stamps, tmp_path):
    page = tmp_path / "page.md"
    command = "python tests/benchmarks/whole_run_benchmark.py"
    end = stamps.END
    lines = (
        *("before", '<!-- figures: of="okid" hash=? -->', f"Measured at 0000000 by `{command}`, on one core:"),
        *("", "| 1 |", end, '<!-- figures: of="era" hash=? -->'),
        *("Measured at 0000000 by `pytest tests/test_road.py`:", "", "| 2 |", end, "after", ""),
    )
    page.write_text("\n".join(lines))
    stamps.write_figures(page, f"{command} --sizes 1500x2", "| 3 |")
    first, second = stamps.blocks(page)
    assert first.own_command == f"{command} --sizes 1500x2"
    assert first.text.endswith("on one core:\n\n| 3 |")
    assert first.hash == stamps.hash_of(["okid", "tests/benchmarks/whole_run_benchmark.py"])
    assert second.hash == "?"
    assert page.read_text().startswith("before\n")
    assert page.read_text().endswith("| 2 |\n" + end + "\nafter\n")
    with pytest.raises(ValueError, match="needs one"):
        stamps.write_figures(page, "python tests/benchmarks/era_benchmark.py", "| 4 |")


@pytest.mark.parametrize(
    "text", ['<!-- figures: of="okid" hash=? -->\n', "<!-- end of figures -->\n"], ids=["no end", "no beginning"]
)
def test_half_a_block_is_an_error(stamps, tmp_path, text):
    page = tmp_path / "page.md"
    page.write_text(text)
    with pytest.raises(ValueError, match="figures"):
        stamps.blocks(page)


def test_each_stage_of_a_whole_run_has_its_functions(repository):
    code = "import sys; sys.path.insert(0, sys.argv[1]); import whole_run_benchmark as w; print(w.wrapped(w.Clock()))"
    folder = str(repository / "tests" / "benchmarks")
    done = subprocess.run([sys.executable, "-c", code, folder], capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "[]", done.stdout + done.stderr
