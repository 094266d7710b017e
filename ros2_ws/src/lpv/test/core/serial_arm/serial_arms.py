"""Arms of the tests: of three joints; a SCARA, a large arm on a linear axis, nine mixed joints."""

from dataclasses import replace

import fault_injection
import numpy as np
from fault_injection import Stream, derived, with_sensors, wrong_chain
from simulated_runs import Run, simulated_run
from watched import Watched

from lpv import DiagnosisParameters, load_arm
from lpv.core.monitoring.answers import Answers
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.serial_arm import description as parts
from lpv.core.serial_arm.chain import body_parameters
from lpv.core.serial_arm.description import SerialArm, Uncertainty

URDF = """<robot name="small"><link name="base"/><link name="tool"/>
<link name="one"><inertial><origin xyz="0.1 0.02 0" rpy="0.3 0 0.2"/><mass value="3"/>
  <inertia ixx="0.02" ixy="0.001" ixz="0" iyy="0.03" iyz="0.002" izz="0.04"/></inertial></link>
<link name="two"><inertial><origin xyz="0 0.2 0"/><mass value="2"/>
  <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.02"/></inertial></link>
<link name="left"><inertial><origin xyz="0 0 0.05"/><mass value="0.4"/>
  <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001"/></inertial></link>
<joint name="a" type="revolute"><parent link="base"/><child link="one"/>
  <origin xyz="0 0 0.3" rpy="0.1 0.2 0.3"/><axis xyz="0 1 0"/>
  <limit lower="-1" upper="2" velocity="3" effort="50"/></joint>
<joint name="b" type="revolute"><parent link="one"/><child link="two"/>
  <origin xyz="0.4 0 0"/><axis xyz="1 2 -1"/>
  <limit lower="-1" upper="2" velocity="3" effort="50"/></joint>
<joint name="mount" type="fixed"><parent link="two"/><child link="tool"/>
  <origin xyz="0 0 0.1" rpy="0 0.5 0"/></joint>
<joint name="finger" type="prismatic"><parent link="tool"/><child link="left"/>
  <origin xyz="0 0.02 0"/><axis xyz="0 1 0"/>
  <limit lower="0" upper="0.05" velocity="1" effort="5"/></joint></robot>"""
"""Two turning joints with a fixed tool, and a finger that slides."""
KNOWN = Uncertainty(payload=0.5, friction=0.3)


def shoulder_arm(rates: str = 'derived', uncertainty: Uncertainty = KNOWN) -> SerialArm:
    """Three joints: the base turns about the vertical, shoulder and elbow lift."""
    arm = with_rates(fault_injection.shoulder_arm(), rates)
    return replace(arm, name='shoulder', uncertainty=uncertainty)


def with_rates(arm: SerialArm, rates: str, **changes) -> SerialArm:
    return replace(with_sensors(arm, rates=rates), **changes)


def simulated(arm, *faults, pushes=(), seed=1, duration=8.0, plant=None) -> Run:
    """A run of the arm with a plant that its model does not know exactly."""
    plant = wrong_chain(arm, np.random.default_rng(seed)) if plant is None else plant
    return simulated_run(arm, duration, *faults, plant=plant, pushes=pushes, seed=seed)


def watch(arm, run) -> Watched:
    monitor = Watched(arm)
    monitor.take(run.stamps, run.samples)
    return monitor


def delivered(arm: SerialArm, samples) -> Stream:
    """What the driver of an arm makes of readings, rates and efforts; its rates may be derived."""
    stamps = 1 + np.round(1e9 * arm.sample_time * np.arange(len(samples))).astype(np.int64)
    stream = Stream(stamps, samples)
    return derived(stream) if arm.joints[0].sensors.rates == 'derived' else stream


def blamed(monitor) -> list[tuple[str, str]]:
    return [(alarm.sensor, alarm.kind) for alarm in monitor.alarms if alarm.sensor]


def answered(arm, run, **parameters) -> Answers:
    """Answers of an arm's monitor to a run; no stamp is 0."""
    monitor = SerialSensorMonitor('/uio', arm, DiagnosisParameters(**parameters))
    return monitor.take_many(run.stamps + 1, *np.moveaxis(run.samples, 1, 0))


def without(run, rows) -> Run:
    return Run(*(np.delete(one, rows, axis=0) for one in run))


LEVEL, UP, DOWN = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)
# Place and orientation of the frame, axis, mass, centre of mass, limits of position, rate, torque.
RAIL = ('rail', (0.0, 0.0, 0.4), LEVEL, (1.0, 0.0, 0.0), 60.0, (0.0, 0.0, 0.1),
        (-2.0, 2.0), 1.5, 1500.0, 'prismatic')  # fmt: skip
SCARA = (
    ('turn_1', (0.0, 0.0, 0.3), LEVEL, UP, 8.0, (0.15, 0.0, 0.0), (-2.5, 2.5), 4.0, 150.0),
    ('turn_2', (0.35, 0.0, 0.0), LEVEL, UP, 5.0, (0.12, 0.0, 0.0), (-2.5, 2.5), 5.0, 80.0),
    ('lift', (0.3, 0.0, -0.05), LEVEL, UP, 1.5, (0.0, 0.02, -0.1), (-0.2, 0.0), 0.8, 120.0,
     'prismatic'),
    ('turn_3', (0.0, 0.0, -0.02), LEVEL, DOWN, 0.5, (0.01, 0.0, 0.0), (-3.1, 3.1), 8.0, 10.0),
)  # fmt: skip


def _joint(name, place, rpy, axis, mass, center, span, rate, torque, kind='revolute'):
    body = body_parameters(mass, center, 0.02 * mass * np.diag([1.0, 0.8, 0.6]))
    turns, slides = (0.5, 0.5, 0.05, 5e-5), (20.0, 15.0, 5.0, 2e-5)
    viscous, coulomb, rotor, noise = slides if kind == 'prismatic' else turns
    return parts.SerialJoint(
        name, place, rpy, axis, parts.LinkInertia.from_vector(body),
        parts.JointFriction(0.0, viscous, coulomb), rotor_inertia=rotor,
        limits=parts.JointLimits(*span, rate, torque), type=kind,
        sensors=parts.JointSensors(f'{name}_encoder', noise, 0.0, 'derived'))  # fmt: skip


def floats(values):
    return tuple(float(value) for value in values)


def arm_of(name: str, rows: tuple, tip: tuple[float, float, float]) -> SerialArm:
    joints = tuple(_joint(*row) for row in rows)
    return SerialArm(name, joints, tip=tip, uncertainty=Uncertainty(0.5, 0.3))


def scara() -> SerialArm:
    """Joints RRPR: the quill turns below its slide."""
    return arm_of('scara', SCARA, (0.05, 0.0, -0.15))


def ur10_on_rail() -> SerialArm:
    """The shipped UR10 on a horizontal rail, without its last joint: its compiled code serves."""
    arm = load_arm('ur10')
    own = {'name': 'ur10_on_rail', 'covariance': None, 'urdf': '', 'locked': ()}
    joints = (_joint(*RAIL), *arm.joints[:-1])
    return replace(arm, joints=joints, uncertainty=Uncertainty(0.5, 0.3), **own)


def mixed_arm(seed: int = 9, joints: int = 9) -> SerialArm:
    rng, rows = np.random.default_rng(seed), []
    for i in range(joints):
        axis, turn = rng.normal(size=3), floats(rng.uniform(-3.0, 3.0, 3))
        kind = ('revolute', 'prismatic')[i % 3 == 1]
        span = (-0.5, 0.6) if kind == 'prismatic' else (-2.0, 2.0)
        rows.append((f'joint{i + 1}', floats(rng.uniform(-0.4, 0.4, 3)),
                     turn, floats(axis / np.linalg.norm(axis)),
                     float(rng.uniform(0.5, 8.0)), floats(rng.uniform(-0.2, 0.2, 3)), span, 2.0,
                     500.0, kind))  # fmt: skip
    return arm_of('mixed', tuple(rows), (0.1, 0.0, 0.2))


def middle(arm: SerialArm) -> np.ndarray:
    return np.array([0.5 * sum(joint.range) for joint in arm.joints])
