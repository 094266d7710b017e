"""Replays of recordings of a serial arm."""

import numpy as np
import pytest
from serial_bags import crane, crane_file, crane_run, record_crane

from lpv_bag.replay.injected_faults import judge
from lpv_bag.replay.replay import Replay
from lpv_bag.rosbag.reading import open_bag
from lpv_bag.run.record import load_run
from lpv_cli.main import main
from lpv_core.monitoring.serial_monitor import SerialSensorMonitor
from lpv_core.simulation.faults import Fault, FaultInjector

STEP = Fault('encoder2', 'bias', 0.6, size=0.05)


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    return record_crane(tmp_path_factory.mktemp('crane') / 'bag', crane_run())


def replay(bag, out, faults=(), **options):
    injector = FaultInjector(crane().sensor_names, faults, np.random.default_rng(0))
    return Replay(SerialSensorMonitor('/uio', crane()), injector=injector, **options).run(bag, out)


def contents(path):
    with open_bag(path) as reader:
        return [(c.topic, stamp, data) for c, stamp, data in reader.messages()]


def test_given_a_recording_of_three_joints_when_replayed_then_all_answers_are_in_the_bag(
    bag, tmp_path
):
    result = replay(bag, tmp_path / 'out')
    record = load_run(tmp_path / 'out', joint_names=crane().joint_names)
    assert result.answered == result.measurements == record.counts['/lpv/joint_states_corrected']
    assert record.get('fault_estimate', 'estimate').shape == (result.measurements, 3)
    assert record.sensor_names == crane().sensor_names and not record.alarms


def test_given_an_injected_step_when_replayed_then_it_is_found_and_corrected(bag, tmp_path):
    result = replay(bag, tmp_path / 'out', [STEP])
    found = judge([STEP], result)[0]
    assert found.found and not found.wrong_sensors
    assert found.size == pytest.approx(0.05, abs=2e-3) and found.delay < 0.02
    with open_bag(tmp_path / 'out') as reader:
        topic = [c for c in reader.connections if c.topic.endswith('_corrected')]
        corrected = [
            reader.deserialize(data, c.msgtype).position for c, _, data in reader.messages(topic)
        ]
    healthy = load_run(bag, joint_names=crane().joint_names).get('joint_states', 'position')
    assert np.abs(np.array(corrected) - healthy).max() < 5e-3


@pytest.mark.parametrize('without', ['velocity', 'effort'])
def test_given_messages_without_rates_or_efforts_when_replayed_then_a_step_is_found(
    tmp_path, without
):
    bag = record_crane(tmp_path / 'bag', crane_run(), [without])
    result = replay(bag, tmp_path / 'out', [STEP])
    assert judge([STEP], result)[0].found and not result.rejected
    assert contents(tmp_path / 'out')


def test_given_gains_for_a_serial_arm_when_replayed_then_they_are_refused(bag, tmp_path, capsys):
    arm = str(crane_file(tmp_path))
    arguments = ['replay', str(bag), '--arm', arm, '--out', str(tmp_path / 'out')]
    assert main([*arguments, '--gains', 'paper.yaml']) == 2
    assert main([*arguments, '--requirement', 'paper']) == 2
    assert 'lpv: is missing: gains are designed for its region' in capsys.readouterr().err
    assert main(arguments) == 0
    assert not (tmp_path / 'out' / 'gains.yaml').exists()
