import numpy as np
from differences import by_value, disagreement
from hypothesis import given
from hypothesis import strategies as st

from modal.effects.inputs import InputGain
from modal.effects.sensors import SensorBias, SensorGain

signals = st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=20).map(np.array)
numbers = st.floats(-10.0, 10.0)


@given(drive=signals, gain=numbers)
def test_an_input_gain_is_the_factor_itself(drive, gain):
    start, end = InputGain().apply([gain], drive, 2.0 * drive, 0.1)
    np.testing.assert_array_equal(start, gain * drive)
    np.testing.assert_array_equal(end, gain * 2.0 * drive)
    np.testing.assert_array_equal(InputGain().at_samples([gain], drive, 3.0 * drive, drive, 0.1), gain * drive)
    for slope, part in zip(
        InputGain().by_parameter([gain], drive, 2.0 * drive, 3.0 * drive, 0.1), (2, 3, 1), strict=True
    ):
        np.testing.assert_array_equal(slope, part * drive[np.newaxis])


@given(output=signals, first=numbers, second=numbers)
def test_sensor_derivatives_agree_with_differences(output, first, second):
    time = 0.1 * np.arange(output.size)
    for effect, values in ((SensorGain(), [first]), (SensorBias(), [first, second])):

        def sensed(changed, effect=effect):
            return effect.gain(changed) * output + effect.offset(changed, time)

        derivative = effect.by_parameter(values, output, time)
        assert derivative.shape == (output.size, len(values))
        for j in range(len(values)):
            assert disagreement(derivative[:, j], by_value(sensed, values, j)) < 1e-6


@given(output=signals, gain=numbers, offset=numbers, slope=numbers)
def test_a_sensor_reads_by_the_law(output, gain, offset, slope):
    time = 0.1 * np.arange(output.size)
    bias = SensorBias()
    np.testing.assert_array_equal(SensorGain().gain([gain]) * output, gain * output)
    np.testing.assert_array_equal(SensorGain().offset([gain], time), 0.0)
    assert bias.gain([offset, slope]) == 1.0
    np.testing.assert_allclose(bias.offset([offset, slope], time), [offset + slope * t for t in time])


@given(signal=signals)
def test_neutral_values_change_nothing(signal):
    time = np.arange(float(signal.size))
    np.testing.assert_array_equal(InputGain().apply(InputGain.neutral, signal, signal, 0.1)[0], signal)
    for effect in (SensorGain(), SensorBias()):
        sensed = effect.gain(effect.neutral) * signal + effect.offset(effect.neutral, time)
        np.testing.assert_array_equal(sensed, signal)


def test_units_are_those_of_the_channel():
    assert [kind.dimension for kind in SensorBias.parameters] == [(1, 0, 0), (1, 0, -1)]
    assert [kind.dimension for kind in (*SensorGain.parameters, *InputGain.parameters)] == [(0, 0, 0)] * 2
