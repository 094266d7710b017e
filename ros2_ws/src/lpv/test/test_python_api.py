import re
from dataclasses import replace

import numpy as np
import pytest
import runs
from places import ROOT
from serial_bags import crane_file, crane_run, record_crane

import lpv
from lpv.bag.run.record import load_run

pytestmark = pytest.mark.slow


@pytest.fixture(scope='module')
def page():
    names, text = {}, (ROOT / 'docs' / 'api.md').read_text()
    for block in re.findall(r'```python\n(.*?)```', text, re.DOTALL):
        exec(block, names)
    return names


def test_given_the_page_when_its_code_is_run_then_faults_raise_alarms_of_their_size(page):
    raised = {a.sensor for a in page['run'].alarms if a.event == lpv.AlarmEvent.RAISED}
    assert raised == set(page['arm'].sensor_names)
    found = page['biased'].fault_estimate[page['biased'].time.searchsorted(6.0)]
    assert found == pytest.approx([0.0, 0.2], abs=0.03)


@pytest.mark.parametrize(('field', 'change'), [
    ('duration', {'duration': -1.0}), ('duration', {'duration': 1e6}),
    ('duration', {'duration': np.nan}), ('plant.model', {'plant': 'gazebo'}), ('compensation', {}),
])  # fmt: skip
def test_given_what_cannot_be_simulated_then_it_is_named(field, change):
    scenario = replace(lpv.load_scenario('two_faults'), **change)
    given = lpv.load_arm('paper'), None, scenario, None, 'off' if change else 'on'
    pytest.raises(lpv.ConfigError, lpv.simulate, *given).match(f'^{field}: must be')


def test_given_an_arm_without_a_region_when_gains_are_designed_then_it_needs_none():
    told = 'ur10: lpv: is missing: gains are designed for its region, arms without one need none'
    pytest.raises(lpv.ConfigError, lpv.design, lpv.load_arm('ur10')).match(told)


@pytest.mark.parametrize(('field', 'value', 'told'), [
    ('sigmas', np.nan, 'must be finite'), ('hours_between_false_alarms', 0, 'must lie within'),
    ('safe_stop_bound', -1.0, 'must lie within'), ('latch', 3, 'must be true or false'),
])  # fmt: skip
def test_given_parameters_that_no_file_may_hold_then_they_are_named(field, value, told):
    arm, parameters = lpv.load_arm('paper'), lpv.DiagnosisParameters(**{field: value})
    for use in (
        lambda: lpv.Monitor(arm, parameters=parameters),
        lambda: lpv.simulate(arm, parameters=parameters),
        lambda: lpv.diagnose(arm, None, 'bag', parameters),
    ):
        pytest.raises(lpv.ConfigError, use).match(f'^diagnosis.{field}: {told}')


def test_given_measurements_when_monitored_then_estimates_are_those_of_the_loop(page):
    monitor, run = lpv.Monitor(page['arm'], page['gains']), page['run']
    with pytest.raises(lpv.SampleError, match='position'):
        monitor.update(1, [0.0], [0.0, 0.0], [0.0, 0.0])
    samples = zip(page['stamps'], run.measured, run.measured_velocity, run.effort)
    updates = [monitor.update(int(stamp), *vectors) for stamp, *vectors in samples]
    found = np.array([u.fault for u in updates[1:]])
    np.testing.assert_array_equal(found, run.fault_estimate[1:])
    events = [e for u in updates if u for e in u.alarms]
    assert [(e.sensor, e.kind) for e in events] == [(e.sensor, e.kind) for e in run.alarms]


@pytest.mark.parametrize('place', [1, 2, 3])
@pytest.mark.parametrize(
    'wrong', ['ab', None, 0.5, ['a', 'b'], {'a': 0.1, 'b': 0.2}, [[0.1], [0.2]], np.zeros((2, 2))]
)
def test_given_wrong_types_when_monitored_then_it_is_said_which(page, place, wrong):
    monitor, sample = lpv.Monitor(page['arm']), [10**9, *3 * [[0.1, 0.2]]]
    name = ('position', 'velocity', 'effort')[place - 1]
    with pytest.raises(lpv.SampleError, match=f'^{name} must be 2 numbers, one a joint, got '):
        monitor.update(*sample[:place], wrong, *sample[place + 1 :])
    for stamp in ('x', None, 10**30, 1.5, 1e9):
        with pytest.raises(lpv.SampleError, match='^stamp must be a whole number of nanoseconds'):
            monitor.update(stamp, *sample[1:])
    assert monitor.update(*sample) is not None, 'it goes on'


def test_given_a_bag_when_diagnosed_then_estimates_are_those_that_were_recorded(page, tmp_path):
    scenario = replace(lpv.load_scenario('two_faults'), duration=7.0)
    bag = runs.record(tmp_path / 'my_bag', page['arm'], page['gains'], scenario)
    found, recorded = lpv.diagnose(page['arm'], page['gains'], bag), load_run(bag)
    np.testing.assert_array_equal(found.stamp, recorded.stamps['fault_estimate'])
    np.testing.assert_array_equal(found.fault, recorded.get('fault_estimate', 'estimate'))
    assert [a.kind for a in found.alarms] == [a.kind for a in recorded.alarms] and found.alarms


def test_given_a_serial_arm_when_its_bag_is_diagnosed_then_the_monitor_says_the_same(tmp_path):
    arm, run = lpv.load_arm(crane_file(tmp_path)), crane_run(0.5)
    run.samples[100:150, 0, 0] = np.nan  # a dropout
    bag = record_crane(tmp_path / 'bag', run)
    diagnosis, monitor = lpv.diagnose(arm, None, bag), lpv.Monitor(arm)
    samples = lpv.read_bag(bag, arm)
    updates = [monitor.update(s.stamp, s.position, s.velocity, s.effort) for s in samples]
    np.testing.assert_array_equal(diagnosis.fault, [update.fault for update in updates])
    np.testing.assert_array_equal(diagnosis.position, [update.position for update in updates])
    np.testing.assert_array_equal(diagnosis.trustworthy, [one.trustworthy for one in updates])
    assert diagnosis.trustworthy[50] and not diagnosis.trustworthy[140]
