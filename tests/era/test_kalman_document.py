"""The sessions of the document on the Kalman gain print what they show."""

import doctest
import re
from pathlib import Path

DOCUMENT = Path(__file__).resolve().parents[2] / "modal" / "docs" / "kalman.md"


def test_the_sessions_print_what_they_show():
    text = DOCUMENT.read_text(encoding="utf-8")
    sessions = "\n".join(re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL))
    assert sessions.count(">>>") > 15
    test = doctest.DocTestParser().get_doctest(sessions, {}, DOCUMENT.name, str(DOCUMENT), 0)
    assert doctest.DocTestRunner().run(test).failed == 0
