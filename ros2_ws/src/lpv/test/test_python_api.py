"""The Python API, as docs/api.md shows it."""

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

PAGE = (ROOT / 'docs' / 'api.md').read_text()
BLOCKS = re.findall(r'```python\n(.*?)```', PAGE, re.DOTALL)


@pytest.fixture(scope='module')
def page():
    """Names that the page's code leaves behind."""
    names = {}
    for block in BLOCKS:
        exec(block, names)
    return names


@pytest.fixture(scope='module')
def bag(page, tmp_path_factory):
    """Bag of a short simulated run, with the node's answers."""
    scenario = replace(lpv.load_scenario('two_faults'), duration=7.0)
    path = tmp_path_factory.mktemp('api') / 'my_bag'
    runs.record(path, page['arm'], page['gains'], scenario)
    return path


def test_given_the_page_when_its_code_is_run_then_both_faults_raise_alarms(page):
    raised = {a.sensor for a in page['run'].alarms if a.event == lpv.AlarmEvent.RAISED}
    assert raised == set(page['arm'].sensor_names)


def test_given_a_bias_when_simulated_then_the_estimate_is_its_size(page):
    assert page['biased'].fault_estimate[page['biased'].time.searchsorted(6.0)] == pytest.approx(
        [0.0, 0.2], abs=0.03
    )


def test_given_measurements_when_monitored_then_estimates_are_those_of_the_loop(page):
    monitor, run = lpv.Monitor(page['arm'], page['gains']), page['run']
    updates = [
        monitor.update(int(s), p, v, e)
        for s, p, v, e in zip(page['stamps'], run.measured, run.measured_velocity, page['effort'])
    ]
    found = np.array([u.fault for u in updates[1:]])
    np.testing.assert_array_equal(found, run.fault_estimate[1:])
    events = [e for u in updates if u for e in u.alarms]
    assert [(e.sensor, e.kind) for e in events] == [(e.sensor, e.kind) for e in run.alarms]


def test_given_wrong_sizes_when_updated_then_it_is_told(page):
    with pytest.raises(lpv.SampleError, match='position'):
        lpv.Monitor(page['arm'], page['gains']).update(1, [0.0], [0.0, 0.0], [0.0, 0.0])


def test_given_a_bag_when_diagnosed_then_estimates_are_those_that_were_recorded(page, bag):
    found, recorded = lpv.diagnose(page['arm'], page['gains'], bag), load_run(bag)
    np.testing.assert_array_equal(found.stamp, recorded.stamps['fault_estimate'])
    np.testing.assert_array_equal(found.fault, recorded.get('fault_estimate', 'estimate'))
    assert [a.kind for a in found.alarms] == [a.kind for a in recorded.alarms]
    assert found.alarms


def test_given_a_serial_arm_when_its_bag_is_diagnosed_then_the_monitor_says_the_same(tmp_path):
    arm = lpv.load_arm(crane_file(tmp_path))
    bag = record_crane(tmp_path / 'bag', crane_run(0.5))
    diagnosis, monitor = lpv.diagnose(arm, None, bag), lpv.Monitor(arm)
    updates = [
        monitor.update(sample.stamp, sample.position, sample.velocity, sample.effort)
        for sample in lpv.read_bag(bag, arm)
    ]
    np.testing.assert_array_equal(diagnosis.fault, [update.fault for update in updates])
    np.testing.assert_array_equal(diagnosis.position, [update.position for update in updates])
