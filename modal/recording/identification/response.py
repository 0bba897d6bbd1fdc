"""The page "Responses" of a recording, where no record was identified but a table of frequency responses."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from modal.identification.result import Identification
from modal.modes.response_synthesis import tabled_frf
from modal.plots.results import measured_responses
from modal.recording.figure import Pane, document_view, log_chart, plot_view
from modal.recording.plan import cell
from modal.recording.tables import choices_text, log_table
from modal.sections.words import modes_headline

if TYPE_CHECKING:
    import rerun

    from okid.frequency_response import FrequencyResponse

__all__ = ["log_response_page", "response_page"]

RESPONSES: Final = Pane("responses/plot", 1100.0, 820.0)
TEXT: Final = "responses/text"


def log_response_page(
    identification: Identification, response: "FrequencyResponse", recording: "rerun.RecordingStream"
) -> None:
    """The responses with the model over them, and what was found and chosen in words."""
    import rerun as rr

    log_chart(recording, RESPONSES, measured_responses(identification, tabled_frf(response)))
    flat = response.response.reshape(response.n_lines, -1)
    columns: dict[str, Iterable[object]] = {
        "frequency": response.frequencies,
        "real": flat.real.tolist(),
        "imaginary": flat.imag.tolist(),
    }
    log_table(recording, "responses/lines", "frequency_line", np.arange(1, response.n_lines + 1), columns)
    parts = [f"### {modes_headline(identification)}"]
    parts += [f"**Read this:** {cell(warning)}" for warning in identification.warnings]
    parts.append(choices_text(identification))
    document = rr.TextDocument("\n\n".join(parts), media_type=rr.MediaType.MARKDOWN)
    recording.log(TEXT, document, static=True, strict=True)


def response_page() -> Any:
    """The page: responses on the left, words on the right."""
    import rerun.blueprint as rrb

    views = plot_view(RESPONSES, "Measured and synthesised"), document_view(TEXT, "Found and chosen")
    return rrb.Horizontal(*views, column_shares=[2.2, 1.0], name="Responses")
