"""The whole loop in one process, in the order in which the lockstep graph runs it."""

from dataclasses import dataclass, field

import numpy as np

from lpv_core.diagnosis import Diagnoser
from lpv_core.observer import NANOSECONDS, UnknownInputObserver
from lpv_core.simulation import ArmSimulator
from lpv_core.tracking import TrackingController, feedback_position


@dataclass
class Run:
    """Signals of one run, one row a sample.

    Attributes
    ----------
    time : ndarray, shape (n,)
        [s].
    position, velocity : ndarray, shape (n, 2)
        True joint positions and rates.
    measured, estimate, estimated_velocity, reference : ndarray, shape (n, 2)
        Joint positions as measured and estimated, estimated rates, references.
    fault, fault_estimate, threshold : ndarray, shape (n, 2)
        Of the physical sensors [rad].
    torque : ndarray, shape (n, 2)
        Commanded joint torques [N m].
    alarms : list of Alarm
        Events.
    """

    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    measured: np.ndarray
    estimate: np.ndarray
    estimated_velocity: np.ndarray
    reference: np.ndarray
    fault: np.ndarray
    fault_estimate: np.ndarray
    threshold: np.ndarray
    torque: np.ndarray
    alarms: list = field(default_factory=list)


def run_closed_loop(arm, gains, scenario, compensation='confirmed', parameters=None, substeps=2):
    """Simulate a scenario with observer, diagnosis and tracking.

    Parameters
    ----------
    arm : ArmParameters
        Nominal arm.
    gains : Gains
        Its gains.
    scenario : Scenario
        What happens.
    compensation : {'off', 'confirmed', 'always'}, optional
        What the loop closes on.
    parameters : DiagnosisParameters, optional
        Tuning of the diagnosis.
    substeps : int, optional
        Plant steps per sample.

    Returns
    -------
    Run
        All signals.
    """
    plant = ArmSimulator(arm, scenario, substeps)
    observer = UnknownInputObserver(arm, gains)
    diagnoser = Diagnoser(arm, gains, parameters)
    controller = TrackingController(arm, gains)
    path = scenario.path(arm)
    n = int(round(scenario.duration / arm.sample_time)) + 1
    names = [f for f in Run.__dataclass_fields__ if f not in ('time', 'alarms')]
    rows = {name: np.zeros((n, 2)) for name in names}
    time, alarms = np.zeros(n), []
    estimate = previous = None
    for k in range(n):
        measurement, truth = plant.sense()
        stamp = round(plant.time * NANOSECONDS)
        fresh = observer.update(stamp, measurement.position, measurement.velocity,
                                measurement.effort)
        reference = path.sample(stamp / NANOSECONDS)
        rows['measured'][k], rows['reference'][k] = measurement.position, reference.position
        rows['position'][k], rows['velocity'][k] = truth.position, truth.velocity
        rows['fault'][k], time[k] = truth.fault, plant.time
        if fresh is not None:
            estimate, diagnosis = fresh, diagnoser.update(fresh)
            alarms += diagnosis.events
        # No start value yet, or a fault that cannot be compensated: the brakes engage.
        if estimate is None or not diagnosis.trustworthy:
            plant.hold()
            controller.reset()
            previous = None
            continue
        position = feedback_position(compensation, estimate, diagnosis.confirmed_fault,
                                     observer.joints)
        # Eq. (59) literally integrates the faulty measurement; the exact loop does not.
        integrated = (estimate.measured_position if gains.controller.method == 'paper'
                      else position)
        command = controller.update(reference, position, estimate.velocity, integrated,
                                    0.0 if previous is None else (stamp - previous) / NANOSECONDS)
        previous = stamp
        for name, value in (
                ('estimate', estimate.position), ('estimated_velocity', estimate.velocity),
                ('fault_estimate', estimate.fault), ('threshold', diagnosis.threshold),
                ('torque', command.torque)):
            rows[name][k] = value
        plant.step(command.torque)
    return Run(time=time, alarms=alarms, **rows)
