"""Services that inject and clear faults, on an injector without a graph."""

from types import SimpleNamespace

import numpy as np
import pytest

from lpv.core.simulation.faults import FaultInjector
from lpv_arm_sim.services import FaultServices
from lpv_msgs.srv import ClearFaults, InjectFault


@pytest.fixture
def services():
    """Services of a simulator that is at 2 s."""
    injector = FaultInjector(('a', 'b'), [], np.random.default_rng(0))
    logger = SimpleNamespace(info=lambda text: None)
    node = SimpleNamespace(create_service=lambda *_: None, get_logger=lambda: logger)
    return FaultServices(node, SimpleNamespace(time=2.0, injector=injector))


def inject(services, **fields):
    request = InjectFault.Request(**{'sensor': 'a', 'kind': 'bias', 'size': 0.3, **fields})
    return services.inject(request, InjectFault.Response())


def clear(services, sensor):
    return services.clear(ClearFaults.Request(sensor=sensor), ClearFaults.Response())


@pytest.mark.parametrize(
    'fields', [{'sensor': 'c'}, {'kind': 'nix'}, {'size': 0.0}, {'size': float('nan')}]
)
def test_given_a_fault_that_makes_no_sense_when_injected_then_the_reason_is_told(services, fields):
    response = inject(services, **fields)
    assert not response.success and f'fault.{next(iter(fields))}' in response.message
    assert not clear(services, 'c').success


def test_given_two_faults_when_injected_and_one_is_cleared_then_the_other_stays(services):
    response = inject(services)
    assert response.success
    assert response.message == 'bias on a from 2.000 s on'
    inject(services, sensor='b')
    assert [clear(services, sensor).cleared for sensor in ('a', '', '')] == [1, 1, 0]
