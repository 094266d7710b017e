"""Cost of one measurement: observer and diagnosis, against FilterPy's extended Kalman filter.

Both run over the same simulated measurements of the paper's arm, with the same states (two angles,
two rates, two faults).  The figure is the ratio of the two times in this very run; times alone say
more about the machine than about the software.
"""

import time
from types import SimpleNamespace

import numpy as np
from accuracy_limit import make_ekf

from lpv_core.control.tracking import TrackingController
from lpv_core.model.arm import load_arm
from lpv_core.model.joints import JointMap
from lpv_core.monitoring.monitor import SensorMonitor
from lpv_core.simulation.arm_simulator import ArmSimulator
from lpv_core.simulation.scenario import load_scenario
from lpv_core.support.resources import bringup_file
from lpv_design.design_flow import design
from lpv_design.requirement import load_requirement

SAMPLES = 3000
ROUNDS = 5


def measurements(arm, gains):
    """Messages of a run whose loop is closed on the truth."""
    scenario = load_scenario(bringup_file('scenarios', 'two_faults'))
    plant, controller = ArmSimulator(arm, scenario), TrackingController(arm, gains)
    path, found = scenario.path(arm), []
    for _ in range(SAMPLES):
        measurement, truth = plant.sense()
        found.append(
            SimpleNamespace(
                name=list(arm.joint_names),
                position=measurement.position,
                velocity=measurement.velocity,
                effort=measurement.effort,
            )
        )
        plant.step(
            controller.update(
                path.sample(plant.time),
                truth.position,
                truth.velocity,
                truth.position,
                arm.sample_time,
            ).torque
        )
    return found


def ours(arm, gains, messages):
    """Time of the monitor over all messages [s]."""
    monitor = SensorMonitor('bench', arm, gains)
    monitor.warm_up()
    period = round(arm.sample_time * 1e9)
    start = time.perf_counter()
    for k, message in enumerate(messages):
        monitor.take(k * period, message)
    return time.perf_counter() - start


def peer(arm, messages):
    """Time of FilterPy over all messages [s]."""
    joints, ekf = JointMap(arm), make_ekf(arm, messages[0].position)
    start = time.perf_counter()
    for m in messages:
        y = np.concatenate([joints.sensor_position(m.position), joints.sensor_velocity(m.velocity)])
        ekf.take(y, joints.absolute_torque(m.effort))
    return time.perf_counter() - start


def main():
    """Measure in turns, and print the median ratio."""
    arm = load_arm(bringup_file('arms', 'paper'))
    gains = design(arm, load_requirement('paper')).gains
    messages = measurements(arm, gains)
    pairs = [(ours(arm, gains, messages), peer(arm, messages)) for _ in range(ROUNDS)]
    ratio = np.median([a / b for a, b in pairs])
    each = np.median([a for a, _ in pairs]) / SAMPLES
    print(f'observer and diagnosis / FilterPy EKF: {ratio:.2f} (median of {ROUNDS} rounds)')
    print(f'here {each * 1e6:.0f} us a measurement, {each / arm.sample_time:.1%} of a sample time')


if __name__ == '__main__':
    main()
