"""The designed observer in the loop: its bound holds, and what it excludes is certified."""

from dataclasses import replace

import numpy as np
import pytest

from lpv_core.control.tracking import make_controller
from lpv_core.monitoring.serial_monitor import SerialSensorMonitor
from lpv_core.serial_arm.diagnosis.alarms import AlarmEvent
from lpv_core.simulation.closed_loop import run_closed_loop
from lpv_core.simulation.faults import Fault
from lpv_core.support.errors import ConfigError
from lpv_core.uio.planar import planar_model
from lpv_core.uio.unknown_input_observer import UnknownInputObserver

pytestmark = pytest.mark.slow


def measured(run):
    """Arguments of `take_many` for a run."""
    stamps = 1 + np.round(1e9 * run.time).astype(np.int64)
    return stamps, run.measured, run.measured_velocity, run.effort


@pytest.fixture
def loaded(paper_arm, paper_gains):
    """The paper's arm whose file states a payload, with gains that allow for it."""
    arm = replace(paper_arm, uncertainty=replace(paper_arm.uncertainty, payload=0.3))
    return arm, replace(paper_gains, arm_sha256=planar_model(arm).sha256())


@pytest.mark.parametrize('payload', [0.0, 0.3])
@pytest.mark.parametrize('factors', [(1.05, 0.95), (0.95, 1.05), (1.05, 1.05)])
def test_given_a_healthy_arm_inside_its_file_when_it_moves_then_errors_stay_in_the_bound(
    loaded, two_faults, factors, payload
):
    arm, gains = loaded
    scenario = replace(
        two_faults, faults=(), duration=6.0, payload=payload,
        mass_factors=factors, inertia_factors=factors, disturbance=False,
    )  # fmt: skip
    run = run_closed_loop(arm, scenario, gains)
    monitor = SerialSensorMonitor('uio', arm, gains=gains, observer='uio')
    answers = monitor.take_many(*measured(run))
    assert answers.events == []
    known = answers.fault.bound[500:]
    assert np.isfinite(known).all() and known.max() < 0.5
    assert np.all(np.abs(answers.fault.estimate[500:]) <= known)


@pytest.mark.parametrize('sensor', [0, 1])
@pytest.mark.parametrize('size', [0.6, -0.6])
def test_given_an_offset_from_the_start_when_excluded_then_its_own_sensor_is_certified(
    paper_arm, paper_gains, two_faults, sensor, size
):
    fault = Fault(paper_arm.sensor_names[sensor], 'bias', 0.0, size=size)
    scenario = replace(two_faults, faults=(fault,), duration=5.0)
    run = run_closed_loop(paper_arm, scenario, paper_gains)
    raised = [a for a in run.alarms if a.event != AlarmEvent.CLEARED]
    assert {a.sensor_index for a in raised} == {sensor}
    assert any(a.basis == 'guaranteed' for a in raised)
    assert run.fault_estimate[-1, sensor] == pytest.approx(size, abs=0.1)
    assert abs(run.fault_estimate[-1, 1 - sensor]) < 0.05


def test_given_the_tighter_of_two_observers_when_published_then_no_bound_is_larger_than_either(
    paper_arm, paper_gains, two_faults
):
    run = run_closed_loop(paper_arm, replace(two_faults, faults=(), duration=3.0), paper_gains)
    bounds = {
        name: SerialSensorMonitor('uio', paper_arm, gains=paper_gains, observer=name)
        .take_many(*measured(run))
        .fault.bound
        for name in ('tightest', 'uio', 'horizon')
    }
    least = np.minimum(bounds['uio'], bounds['horizon'])
    np.testing.assert_allclose(bounds['tightest'][100:], least[100:], rtol=1e-12)
    assert (bounds['uio'] < bounds['horizon']).any()


def test_given_rates_that_are_derived_when_observed_then_nothing_is_certified(
    real_arm, real_gains, paper_arm, paper_gains
):
    assert UnknownInputObserver(paper_arm, paper_gains).certifies
    assert not UnknownInputObserver(real_arm, real_gains).certifies


def test_given_gains_of_another_arm_when_constructed_then_they_are_refused(real_arm, paper_gains):
    for make in (UnknownInputObserver, lambda a, g: SerialSensorMonitor('uio', a, gains=g)):
        with pytest.raises(ConfigError, match='gains.arm_sha256'):
            make(real_arm, paper_gains)


def test_given_a_loop_with_gains_when_run_then_its_torques_are_those_of_the_designed_law(
    paper_arm, paper_gains, two_faults
):
    run = run_closed_loop(paper_arm, replace(two_faults, faults=(), duration=0.5), paper_gains)
    law = make_controller(paper_arm, paper_gains)
    path = two_faults.path(paper_arm)
    for k in range(len(run.time)):
        reference = path.sample(run.time[k])
        position = run.compensated[k]
        command = law.update(
            reference, position, run.estimated_velocity[k], position, 0.002 if k else 0.0
        )
        np.testing.assert_allclose(run.command[k], command.torque, rtol=1e-9, atol=1e-9)
