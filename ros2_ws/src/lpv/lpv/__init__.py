"""Sensor-fault diagnosis of robot arms for Python scripts: no ROS is needed.

>>> import lpv
>>> arm = lpv.load_arm('paper')
>>> gains = lpv.design(arm)
>>> run = lpv.simulate(arm, gains, scenario='two_faults')
>>> run.alarms
"""

from lpv.designing import design
from lpv.files import load_arm, load_gains, load_scenario, save_gains
from lpv.monitor import Diagnosis, Monitor, Update, diagnose
from lpv.recordings import Sample, read_bag
from lpv.simulation import simulate
from lpv_core.monitoring.parameters import DiagnosisParameters
from lpv_core.serial_arm.description import SerialArm
from lpv_core.serial_arm.diagnosis.alarms import Alarm, AlarmEvent
from lpv_core.simulation.closed_loop import Run
from lpv_core.simulation.faults import Fault
from lpv_core.simulation.scenario import Scenario
from lpv_core.support.errors import ConfigError, LpvError, SampleError
from lpv_core.uio.certificate.gains import Gains

__all__ = [
    'Alarm',
    'AlarmEvent',
    'SerialArm',
    'ConfigError',
    'Diagnosis',
    'DiagnosisParameters',
    'Fault',
    'Gains',
    'LpvError',
    'Monitor',
    'Run',
    'Sample',
    'SampleError',
    'Scenario',
    'Update',
    'design',
    'diagnose',
    'load_arm',
    'load_gains',
    'load_scenario',
    'read_bag',
    'save_gains',
    'simulate',
]
