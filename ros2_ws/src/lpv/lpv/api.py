"""What ``import lpv`` has; imported when it is first asked for."""

from lpv.core.monitoring.parameters import DiagnosisParameters
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis.alarms import Alarm, AlarmEvent
from lpv.core.simulation.closed_loop import Run
from lpv.core.simulation.faults import Fault
from lpv.core.simulation.scenario import Scenario
from lpv.core.support.errors import ConfigError, LpvError, SampleError
from lpv.core.uio.certificate.gains import Gains
from lpv.designing import design
from lpv.files import load_arm, load_gains, load_scenario, save_gains
from lpv.monitor import Diagnosis, Monitor, Update, diagnose
from lpv.recordings import Sample, read_bag
from lpv.simulation import simulate

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
