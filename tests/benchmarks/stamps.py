"""Stamps of the figures in README and modal/docs: the command that made them, the commit, and whether they are stale.

    python tests/benchmarks/stamps.py --list              every block of figures, fresh or stale
    python tests/benchmarks/stamps.py --list --strict     exit status 1 where one is stale
    python tests/benchmarks/stamps.py --renew README.md   figures that were measured anew and put in by hand: of HEAD

A block begins and ends with a comment, and its first sentence says commit and command:

    <!-- figures: of="okid era" hash=0123456789ab -->
    Measured at e39c1a1 by `python tests/benchmarks/era_benchmark.py`:
    ...
    <!-- end of figures -->

"by the command of each line" stands for the command where every line of the tables names its own. The hash is that of
the Python files in `of` and of the command's script. Where it is another one today the figures are stale: they were
true at that commit, and nobody has looked since. That breaks nothing; a stamp that is missing, or names what is not
there, does (tests/contracts/test_figures.py). A table without measured numbers has `<!-- no figures -->` above it.
"""

import argparse
import hashlib
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BEGIN = re.compile(r'^<!-- figures: of="([^"]*)" hash=(\S+) -->$')
END = "<!-- end of figures -->"
NONE = "<!-- no figures -->"
MEASURED = re.compile(r"Measured at ([0-9a-f]{7,40}) by (`[^`]+`|the command of each line)")
COMMAND = re.compile(r"`((?:python|pytest|modal-report) [^`]+)`")


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """Figures between two comments; lines are counted from 1, `first` is that of the comment."""

    page: Path
    first: int
    last: int
    of: tuple[str, ...]
    hash: str
    text: str

    @property
    def commit(self):
        found = MEASURED.search(self.text)
        return found.group(1) if found else ""

    @property
    def commands(self):
        """The command of the block and those of its lines."""
        return tuple(dict.fromkeys(COMMAND.findall(self.text)))

    @property
    def own_command(self):
        found = MEASURED.search(self.text)
        return found.group(2).strip("`") if found else ""

    @property
    def files(self):
        """What the figures depend on, as `hash_of` takes it."""
        return (*self.of, *scripts(self.commands))


def pages(root=ROOT):
    return [root / "README.md", *sorted((root / "modal" / "docs").glob("*.md"))]


def blocks(page):
    """The blocks of a page; ValueError where one has no end."""
    found, lines = [], page.read_text(encoding="utf-8").splitlines()
    first = None
    for number, line in enumerate(lines, 1):
        if begin := BEGIN.match(line):
            if first is not None:
                raise ValueError(f"{page.name}, line {first[0]}: figures without `{END}`")
            first = number, begin
        elif line == END:
            if first is None:
                raise ValueError(f"{page.name}, line {number}: an end of figures without a beginning")
            at, begin = first
            text = "\n".join(lines[at : number - 1])
            of, stamp = tuple(begin.group(1).split()), begin.group(2)
            found.append(Block(page=page, first=at, last=number, of=of, hash=stamp, text=text))
            first = None
    if first is not None:
        raise ValueError(f"{page.name}, line {first[0]}: figures without `{END}`")
    return found


def scripts(commands):
    """The files that commands name: a script, a test file, the file of `python -m`."""
    named = []
    for command in commands:
        named += re.findall(r"(?<= )[\w./-]+\.py(?= |$|::)", command)
        named += [f"{module.replace('.', '/')}.py" for module in re.findall(r"python -m ([\w.]+)", command)]
    return tuple(dict.fromkeys(named))


def hash_of(files, root=ROOT):
    """Of the Python files given or below the folders given, by name and content."""
    paths = {path for name in files for path in _python_files(root / name)}
    digest = hashlib.sha256()
    for path in sorted(paths):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0")
        digest.update(path.read_bytes().replace(b"\r\n", b"\n") + b"\0")
    return digest.hexdigest()[:12]


def _python_files(path):
    return [path] if path.is_file() else sorted(path.rglob("*.py"))


def git(*arguments):
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
    return done.stdout.strip() if done.returncode == 0 else ""


def commit_now():
    """Of HEAD; the hash says whether the working tree is another one."""
    return git("rev-parse", "--short=7", "HEAD") or "0000000"


def listed(block):
    """(stale, one line)."""
    stale = hash_of(block.files) != block.hash
    since = git("rev-list", "--count", f"{block.commit}..HEAD", "--", *block.files) if stale else ""
    words = (f"stale, {since} commits since" if since else "stale") if stale else "fresh"
    where = f"{block.page.relative_to(ROOT).as_posix()}:{block.first}"
    return stale, f"{where}: {words}, measured at {block.commit} by {block.own_command}"


def begin(of, commands):
    """The comment over figures that were measured just now."""
    return f'<!-- figures: of="{of}" hash={hash_of((*of.split(), *scripts(commands)))} -->'


def write_figures(page, command, text, *, key=""):
    """Put the text into the block of a page whose command runs the same script, with the key in it where one is given.

    Raises:
        ValueError: the page has no such block, or several.
    """
    page = page.resolve()
    script = scripts([command])
    own = [block for block in blocks(page) if scripts([block.own_command]) == script]
    own = [block for block in own if key in block.own_command]
    if len(own) != 1:
        raise ValueError(f"{page.name} has {len(own)} blocks of figures by {' '.join([*script, key])}; it needs one")
    (block,) = own
    lines = page.read_text(encoding="utf-8").splitlines()
    sentence = next(line for line in block.text.splitlines() if MEASURED.search(line))
    said = MEASURED.sub(lambda _: f"Measured at {commit_now()} by `{command}`", sentence)
    stamped = begin(" ".join(block.of), [command, *COMMAND.findall(text)])
    new = [stamped, said, "", *text.strip().splitlines(), END]
    page.write_text("\n".join([*lines[: block.first - 1], *new, *lines[block.last :]]) + "\n", encoding="utf-8")


def renew(page):
    """Every block of a page: measured at HEAD, with the hash of today."""
    lines = page.read_text(encoding="utf-8").splitlines()
    for block in blocks(page):
        lines[block.first - 1] = begin(" ".join(block.of), block.commands)
        for number in range(block.first, block.last - 1):
            lines[number] = re.sub(r"(?<=Measured at )[0-9a-f]{7,40}(?= by )", commit_now(), lines[number])
    page.write_text("\n".join(lines) + "\n", encoding="utf-8")


def seeds_from(text):
    """Seeds from "1-60" or "1,5,9-12"."""
    seeds = []
    for part in text.split(","):
        first, _, last = part.partition("-")
        seeds += range(int(first), int(last or first) + 1)
    return seeds


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--list", action="store_true", help="every block of figures, fresh or stale")
    parser.add_argument("--strict", action="store_true", help="exit status 1 where a block is stale")
    parser.add_argument("--renew", type=Path, nargs="+", default=[], metavar="PAGE", help="stamp its figures anew")
    options = parser.parse_args()
    for page in options.renew:
        renew(page.resolve())
    found = [listed(block) for page in pages() for block in blocks(page)]
    if options.list or not options.renew:
        print("\n".join(line for _, line in found))
    return int(options.strict and any(stale for stale, _ in found))


if __name__ == "__main__":
    sys.exit(main())
