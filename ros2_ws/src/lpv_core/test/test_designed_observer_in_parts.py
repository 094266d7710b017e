"""The designed observer beside the horizon: what is decided does not depend on the division."""

from dataclasses import replace

import numpy as np
import pytest

from lpv_core.monitoring.serial_monitor import SerialSensorMonitor
from lpv_core.simulation.closed_loop import run_closed_loop
from lpv_core.simulation.faults import Fault

LENGTH = 8.0


@pytest.fixture(scope='module')
def faulty_run(paper_arm, paper_gains, two_faults):
    fault = Fault('link1_angle', 'bias', 0.0, size=0.4, duration=4.0)
    scenario = replace(two_faults, faults=(fault,), duration=LENGTH)
    return run_closed_loop(paper_arm, scenario, paper_gains, compensation='off')


@pytest.mark.parametrize('part', [7, 500])
def test_given_a_fault_when_samples_come_in_parts_then_every_answer_is_the_same(
    paper_arm, paper_gains, faulty_run, part
):
    stamps = 1 + np.round(faulty_run.time * 1e9).astype(np.int64)
    rows = faulty_run.measured, faulty_run.measured_velocity, faulty_run.effort

    def answers(length):
        monitor = SerialSensorMonitor('parts', paper_arm, gains=paper_gains)
        found = [
            monitor.take_many(stamps[k : k + length], *(row[k : k + length] for row in rows))
            for k in range(0, len(stamps), length)
        ]
        events = [event for one in found for _, event in one.events]
        return events, *(
            np.concatenate([getattr(one.fault, name) for one in found])
            for name in ('estimate', 'bound', 'threshold')
        )

    whole, parts = answers(len(stamps)), answers(part)
    assert whole[0] == parts[0] and {event.sensor for event in whole[0]} == {'link1_angle'}
    for one, other in zip(whole[1:], parts[1:]):
        np.testing.assert_array_equal(one, other)
