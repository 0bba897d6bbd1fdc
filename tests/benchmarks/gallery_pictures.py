"""The pictures of the gallery, of the README and of order.md, made anew from runs of the examples and of the demo.

    python tests/benchmarks/gallery_pictures.py WORK [--viewer PROGRAM] [--only NAME ...]

Examples write into WORK, unless their folder is there already. Pages are photographed by the browser that prints the
PDF (`modal.report.folder.find_browser`). Recordings are photographed by a program that is called as
`PROGRAM IN.rrd OUT.png WIDTH HEIGHT --tab NAME`; without one their pictures stay as they are.
"""

import argparse
import contextlib
import importlib
import io
import subprocess
import tempfile
from pathlib import Path

from PIL import Image

PICTURES = Path(__file__).parents[2] / "modal" / "docs" / "pictures"
WIDTH = 1000
PAGES = {  # name: (folder in WORK, page, first and last row of pixels)
    "report": ("demo", "report.html", 0, 1235),
    "discrepancy_report": ("motor_propeller", "report.html", 0, 790),
    "gallery_hammer": ("hammer", "report.html", 0, 552),
    "gallery_motor": ("motor_propeller", "report.html", 805, 1655),
    "gallery_bench": ("measured_motor", "report.html", 0, 1100),
    "gallery_pendulum": ("measured_pendulum", "report.html", 0, 1100),
    "gallery_mass": ("struck_mass", "1-full-order.svg", 0, 396),
    "gallery_records": ("many_records", "comparison.html", 0, 1080),
    "gallery_set_ups": ("six_set_ups", "report.html", 0, 552),
    "gallery_year": ("year_of_a_bridge", "tracks.html", 0, 1160),
}
RECORDINGS = {
    "recording_modes": ("demo", "recording.rrd", "Modes"),
    "recording_order": ("demo", "recording.rrd", "Order"),
    "gallery_frame": ("three_storey_frame", "recording.rrd", "Modes"),
    "gallery_joint": ("loose_joint", "recording.rrd", "Discrepancy"),
}


def run(name, folder):
    """Let an example write its files, unless they are there."""
    if folder.exists():
        return
    with contextlib.redirect_stdout(io.StringIO()) as told:
        if name == "demo":
            from modal.command.main import status

            status(["demo", "-o", str(folder)])
        elif name == "hammer":
            from modal.command.main import status
            from modal.examples.files import write_files

            write_files(folder)
            status(["run", str(folder / "hammer.csv"), "--inputs", "force", "-o", str(folder)])
        elif name == "measured_motor":  # of measured records, which are not in the repository
            bench = Path(__file__).parents[3] / "shared" / "data" / "dc_motor_bench"
            files = [str(bench / f"prbs_{number}.csv") for number in (1, 2)]
            columns = ["--inputs", "u", "--outputs", "speed", "--counts"]
            importlib.import_module("modal.examples.measured_motor").main([*files, *columns, "-o", str(folder)])
        elif name == "measured_pendulum":
            swing = Path(__file__).parents[3] / "shared" / "data" / "pendulum_single" / "free_swing.csv"
            importlib.import_module("modal.examples.measured_pendulum").main(
                [str(swing), "--outputs", "angle", "-o", str(folder)]
            )
        else:
            importlib.import_module(f"modal.examples.{name}").main(["-o", str(folder)])
    print(f"{name}\n{told.getvalue()}")


def photograph_page(page, first, last, target):
    """Some rows of a page in a window 1100 wide."""
    from modal.report.folder import find_browser

    with tempfile.TemporaryDirectory() as profile:
        options = ["--headless", "--disable-gpu", "--no-first-run", "--disable-background-networking", "--no-sandbox"]
        options += ["--disable-component-update", "--disable-sync", "--disable-quic", "--hide-scrollbars"]
        options += [f"--user-data-dir={profile}", f"--window-size=1100,{last}", f"--screenshot={target}"]
        address = page.absolute().as_uri()
        subprocess.run([find_browser(), *options, address], capture_output=True, timeout=180, check=True)
    with Image.open(target) as whole:
        part = whole.crop((0, first, whole.width, last))
    part.save(target)


def keep(photograph, target, *, width):
    """Small enough for a document: the width that it is read at, 256 colours."""
    with Image.open(photograph) as picture:
        whole = picture.convert("RGB")
    height = round(whole.height * width / whole.width)
    small = whole if width == whole.width else whole.resize((width, height), Image.Resampling.LANCZOS)
    small.quantize(256, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(target, optimize=True)
    print(f"{target.name}: {small.width} x {small.height}, {target.stat().st_size / 1024:.0f} KiB")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path)
    parser.add_argument("--viewer", help="program that photographs a recording")
    parser.add_argument("--only", nargs="+", default=[*PAGES, *RECORDINGS], metavar="NAME")
    given = parser.parse_args()
    given.work.mkdir(parents=True, exist_ok=True)
    taken = given.work / "taken.png"
    for name in given.only:
        folder = given.work / (PAGES | RECORDINGS)[name][0]
        run(folder.name, folder)
        if name in PAGES:
            _, page, first, last = PAGES[name]
            photograph_page(folder / page, first, last, taken)
        elif given.viewer is None:
            continue
        else:
            _, file, tab = RECORDINGS[name]
            command = [given.viewer, folder / file, taken, "1500", "900", "--tab", tab]
            subprocess.run([*map(str, command)], check=True)
        keep(taken, PICTURES / f"{name}.png", width=WIDTH if name in PAGES else 1200)


if __name__ == "__main__":
    main()
