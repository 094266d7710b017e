"""What is said of injected faults: found or not, right sensor or wrong, delay and size error."""

import pytest

from lpv_bag.replay.injected_faults import judge, true_size
from lpv_bag.replay.session import ReplayResult
from lpv_bag.run.streams import RecordedAlarm
from lpv_core.serial_arm.diagnosis.alarms import AlarmEvent
from lpv_core.simulation.faults import Fault

SENSORS = ('a', 'b')
START = 5_000_000_000


def fault(sensor='a', kind='bias', onset=1.0, duration=0.0, size=0.3, rate=0.0):
    return Fault(sensor, kind, onset, duration, size, rate)


def event(time, sensor='a', kind=AlarmEvent.RAISED, size=0.28, name='bias'):
    """An alarm event at a time since the first measurement [s]."""
    stamp = START + round(time * 1e9)
    place = SENSORS.index(sensor)
    return RecordedAlarm(kind, place, sensor, stamp, stamp, size, 0.05, name, 1.0, stamp)


def judged(faults, *events):
    return judge(faults, ReplayResult(first_stamp=START, events=list(events)))


def test_given_an_alarm_of_the_sensor_when_judged_then_delay_and_size_error_are_told():
    later = event(2.0, kind=AlarmEvent.UPDATED, size=0.31, name='drift')
    (found,) = judged([fault()], event(1.25), later)
    assert found.found and not found.wrong_sensors
    assert found.delay == pytest.approx(0.25)
    assert (found.kind, found.error) == ('drift', pytest.approx(0.01))
    assert found.verdict == 'found'


def test_given_no_alarm_when_judged_then_the_fault_is_not_found():
    assert [f.verdict for f in judged([fault()])] == ['not found']


def test_given_an_alarm_of_the_other_sensor_when_judged_then_it_is_the_wrong_one():
    (found,) = judged([fault()], event(1.5, 'b'))
    assert not found.found and found.verdict == 'wrong sensor: b'


def test_given_alarms_of_both_sensors_when_one_is_healthy_then_it_is_named():
    (found,) = judged([fault()], event(1.2), event(1.5, 'b'))
    assert found.found and found.verdict == 'found, and wrongly b'


def test_given_faults_of_both_sensors_when_both_are_alarmed_then_neither_is_wrong():
    found = judged([fault(), fault('b')], event(1.2), event(1.5, 'b'))
    assert [f.verdict for f in found] == ['found', 'found']


@pytest.mark.parametrize('time', [0.5, 3.5])
def test_given_an_alarm_before_or_long_after_a_fault_when_judged_then_it_is_not_found(time):
    (found,) = judged([fault(duration=1.0)], event(time))
    assert not found.found and not found.wrong_sensors


def test_given_a_cleared_alarm_when_judged_then_the_size_is_that_before():
    cleared = event(2.5, kind=AlarmEvent.CLEARED, size=0.0)
    (found,) = judged([fault(duration=1.0)], event(1.2), cleared)
    assert found.error == pytest.approx(-0.02)


@pytest.mark.parametrize(
    ('one', 'time', 'size'),
    [
        (fault(), 3.0, 0.3),
        (fault(kind='drift', size=0.0, rate=-0.1), 3.0, -0.2),
        (fault(kind='drift', size=0.15, rate=0.1), 3.0, 0.15),
        (fault(kind='drift', size=0.0, rate=0.1, duration=1.0), 3.0, 0.1),
        (fault(kind='stuck'), 3.0, None),
    ],
)
def test_given_a_kind_when_its_size_is_asked_for_then_it_is_that_of_the_time(one, time, size):
    assert true_size(one, time) == (None if size is None else pytest.approx(size))
