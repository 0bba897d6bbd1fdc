"""A report written once, of channels whose names are as bad as names get."""

import pytest

NASTY_NAMES = (
    '<script>alert("1")</script>',
    '=HYPERLINK("http://x.y") ](javascript:1) `|* ' + "very long " * 60,
    "\N{RIGHT-TO-LEFT OVERRIDE}קומה\x1b[2J\x00 $\\frac{",
)
NASTY_INPUT = "--><img src=x onerror=alert(1)>"


@pytest.fixture(scope="session")
def nasty(make_result):
    return make_result(names=NASTY_NAMES, input_name=NASTY_INPUT, warnings=(f"Look at {NASTY_NAMES[0]}.",))


@pytest.fixture(scope="session")
def plain(make_result):
    return make_result(warnings=("Look at floor_1.",))


@pytest.fixture(scope="session")
def nasty_files(nasty, tmp_path_factory):
    from modal.report import Provenance, write_report

    provenance = Provenance(
        command=f"modal-report run '{NASTY_INPUT}'", sources=(NASTY_NAMES[0],), remarks=(NASTY_INPUT,)
    )
    with pytest.MonkeyPatch.context() as patch:  # the recording has its own tests, with names of its own
        patch.setattr("modal.recording.save_recording", lambda _result, path, **_options: path.write_bytes(b"rrd"))
        return write_report(nasty, tmp_path_factory.mktemp("nasty") / "report", provenance=provenance)


@pytest.fixture(scope="session")
def plain_files(plain, tmp_path_factory):
    from modal.report import Provenance, write_report

    provenance = Provenance(command="modal-report run x", sources=("x",), remarks=("x",))
    return write_report(plain, tmp_path_factory.mktemp("plain") / "report", provenance=provenance)
