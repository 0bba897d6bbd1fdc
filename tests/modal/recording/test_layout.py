"""The blueprint: every view has an origin that holds something, and a name; panels are out of the way."""

import pytest
from page_reader import views

from modal.recording import save_recording
from modal.recording.plan import gather, planned
from modal.recording.stream import GLOBAL_AXIS, blueprint

CASES = [
    {},
    {"n_outputs": 1, "n_inputs": 1, "n_modes": 1},
    {"n_outputs": 12, "n_modes": 10, "n_inputs": 3, "n_samples": 300},
    {"n_outputs": 40, "n_modes": 3, "n_inputs": 8, "n_samples": 300},
    {"n_inputs": 0, "system": False},
]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_every_view_has_a_name_and_data_below_its_origin(build, tmp_path, read, case):
    found = build(**case)
    layout = blueprint(found, planned(found), gather(found))
    stored = read(save_recording(found, tmp_path / "run.rrd"))
    paths = {str(c.entity_path) for c in stored.store.schema().component_columns()}
    pages = layout.root_container.contents
    assert [page.name for page in pages] == ["Record", "Observer fit", "Order", "Modes", "Validation"]
    every = list(views(layout.root_container))
    assert len(every) < 150
    for view in every:
        assert view.name
        origin = "/" + view.origin.strip("/")
        assert any(path == origin or path.startswith(origin + "/") for path in paths), view.origin
    titles = [view.name for view in views(pages[3]) if view.class_identifier == "3D"]
    assert len(titles) == len(set(titles)) == min(9, case.get("n_modes", 3))


def test_linked_plots_open_on_the_whole_record(build):
    found = build(n_records=2)
    plan = planned(found)
    layout = blueprint(found, plan, gather(found))
    holders = [view for view in views(layout.root_container) if view.id == GLOBAL_AXIS]
    assert len(holders) == 1
    assert holders[0].name == "Inputs"
    linked = [v for v in views(layout.root_container) if v.class_identifier == "TimeSeries" and "cursor" not in v.name]
    assert len(linked) > 5
