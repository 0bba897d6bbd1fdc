import pytest

from modal.acceptance.test_file import AcceptanceLimit, Specification
from modal.geometry.sensors import Geometry, Sensor
from modal.report import pictures as module
from modal.report.pictures import setting_of


def mast(height):
    return Geometry(
        node_names=("1", "2"),
        positions=[[0, 0, 0], [0, 0, height]],
        sensors=(Sensor(name="floor_1", node=1, direction=[1, 0, 0]),),
    )


def test_the_geometry_given_comes_before_that_of_the_test_file(identification):
    own, other = mast(1.0), mast(2.0)
    specification = Specification(geometry=own)
    quality = object()
    assert setting_of(identification, quality=quality).geometry is None
    assert setting_of(identification, specification=specification, quality=quality).geometry is own
    assert setting_of(identification, specification=specification, geometry=other, quality=quality).geometry is other


def test_the_data_are_looked_at_unless_somebody_has(identification, monkeypatch):
    quality = object()
    given = setting_of(identification, quality=quality)
    assert (given.quality, given.quality_of) == (quality, "as read")
    monkeypatch.setattr("modal.report.pictures.check_quality", lambda records: records)
    found = setting_of(identification)
    assert (found.quality, found.quality_of) == (identification.records, "as used")


@pytest.mark.parametrize(("least", "state"), [(0.5, "met"), (0.999, "not met")])
def test_limits_are_weighed(identification, least, state):
    limits = (AcceptanceLimit(kind="fit", name="fit", at_least=least),)
    weighed = setting_of(identification, specification=Specification(limits=limits), quality=object())
    assert [one.state for one in weighed.outcomes] == [state]
    assert setting_of(identification, quality=object()).outcomes == ()
    assert module.NOTHING_BESIDES.outcomes == ()
