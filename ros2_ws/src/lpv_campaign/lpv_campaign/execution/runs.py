"""One run of a campaign: from its number to its signals."""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from lpv_campaign.plan.campaign import Campaign
from lpv_campaign.plan.paths import random_joint_path, random_path
from lpv_campaign.plan.spec import BOTH, NO_FAULT
from lpv_core.certificate.gains import Gains
from lpv_core.decision.diagnosis import DiagnosisParameters
from lpv_core.model.arm import ArmParameters
from lpv_core.serial_arm.any_arm import Arm
from lpv_core.serial_arm.description import SerialArm
from lpv_core.simulation.closed_loop import Run, Transport, run_closed_loop
from lpv_core.simulation.faults import Fault
from lpv_core.simulation.scenario import Scenario
from lpv_core.simulation.serial_closed_loop import SerialLoopRun, run_serial_loop
from lpv_core.simulation.serial_scenario import SerialScenario

_TUNING = {f'diagnosis.{field.name}': field.name for field in fields(DiagnosisParameters)}


@dataclass(frozen=True)
class RunPlan:
    """What is simulated in one run of a two-link arm."""

    number: int  # Number of the run
    values: dict  # Of the factors
    arm: ArmParameters  # Nominal arm, with the run's sample time
    gains: Gains  # Its gains
    scenario: Scenario  # What happens
    parameters: DiagnosisParameters  # Tuning of the diagnosis
    compensation: str  # What the loop closes on
    substeps: int  # Least number of plant steps per sample
    delay: int  # Samples from a measurement to the effect of its command
    loss: float  # Probability that a measurement is lost

    def simulate(self, faults: bool = True) -> Run:
        """Run the closed loop; ``faults=False``: its healthy twin."""
        scenario = self.scenario if faults else replace(self.scenario, faults=())
        return run_closed_loop(
            self.arm,
            self.gains,
            scenario,
            self.compensation,
            self.parameters,
            self.substeps,
            Transport(self.delay, self.loss),
        )


@dataclass(frozen=True)
class SerialRunPlan:
    """What is simulated in one run of a serial arm."""

    number: int  # Number of the run
    values: dict  # Of the factors
    arm: SerialArm  # Nominal arm, with the run's sample time
    scenario: SerialScenario  # What happens
    parameters: DiagnosisParameters  # Tuning of the diagnosis
    compensation: str  # What the loop closes on
    substeps: int  # As in `lpv_core.simulation.serial_closed_loop.run_serial_loop`

    def simulate(self, faults: bool = True) -> SerialLoopRun:
        """Run the closed loop; ``faults=False``: its healthy twin."""
        scenario = self.scenario if faults else replace(self.scenario, faults=())
        return run_serial_loop(
            self.arm,
            scenario,
            self.compensation,
            parameters=self.parameters,
            substeps=self.substeps,
        )


def plan_run(campaign: Campaign, number: int) -> RunPlan | SerialRunPlan:
    """What is simulated in a run.

    Parameters
    ----------
    campaign : Campaign
        The campaign.
    number : int
        Number of the run; with the campaign it determines everything.

    Returns
    -------
    RunPlan or SerialRunPlan
        Ready to be simulated.
    """
    values, spec = campaign.values(number), campaign.spec
    # Not the generator of the plan's points, which must not depend on what else is random in a run.
    rng = np.random.default_rng([spec.seed, 2, number])
    seed = int(rng.integers(2**31))
    time = values['sample_time'] or campaign.arm.sample_time
    arm: Any = replace(campaign.arm, sample_time=time)
    scenario: Any = _on_path(campaign, arm, values['path'], rng)
    given = {_SCALARS[name]: values[name] for name in _SCALARS if values[name] is not None}
    if isinstance(scenario, Scenario):
        given['mass_factors'] = _pair(values, 'mass', scenario.mass_factors)
        given['inertia_factors'] = _pair(values, 'inertia', scenario.inertia_factors)
    scenario = replace(scenario, name=f'{spec.name} {number}', seed=seed, **given)
    if 'fault.kind' in spec.factors:
        scenario = replace(scenario, faults=_faults(arm, values, rng))
    tuning = {field: values[name] for name, field in _TUNING.items() if name in values}
    parameters = DiagnosisParameters(**tuning)
    if campaign.is_serial:
        return SerialRunPlan(
            number, values, arm, scenario, parameters, values['compensation'], spec.substeps
        )
    return RunPlan(
        number,
        values,
        arm,
        campaign.gains(values['design'], time),
        scenario,
        parameters,
        values['compensation'],
        spec.substeps,
        round(values['command_delay']),
        values['sample_loss'],
    )


_SCALARS = {
    'plant': 'plant',
    'payload': 'payload',
    'friction': 'friction_factor',
    'noise': 'noise_factor',
    'disturbance': 'disturbance_factor',
    'parameter_error': 'parameter_error',
}
"""Factors that replace a field of the scenario."""
_PLANE_PATH, _SERIAL_PATH = ('times', 'points', 'elbow', 'obstacle'), ('times', 'waypoints')
"""Fields of a scenario that make its path."""


def _on_path(campaign: Campaign, arm: Arm, path: str, rng: np.random.Generator) -> Any:
    """The scenario of a run with its path and its length."""
    spec = campaign.spec
    scenario: Any = campaign.scenario(spec.scenario)
    duration = spec.duration or scenario.duration
    if path == 'random' and isinstance(arm, SerialArm):
        times, points = random_joint_path(arm, rng, duration)
        return replace(scenario, duration=duration, times=times, waypoints=points)
    if path == 'random' and isinstance(arm, ArmParameters):
        times, points = random_path(arm, rng, duration)
        return replace(
            scenario, duration=duration, times=times, points=points, elbow='positive', obstacle=None
        )
    other = campaign.scenario(spec.scenario if path == 'scenario' else path)
    names = _SERIAL_PATH if isinstance(other, SerialScenario) else _PLANE_PATH
    same_path = {name: getattr(other, name) for name in names}
    return replace(scenario, duration=duration, **same_path)


def _pair(values: dict[str, Any], name: str, default: tuple[float, float]) -> tuple[float, float]:
    given = values[f'{name}_1'], values[f'{name}_2']
    return (
        default[0] if given[0] is None else given[0],
        default[1] if given[1] is None else given[1],
    )


def _faults(arm: Arm, values: dict[str, Any], rng: np.random.Generator) -> tuple[Fault, ...]:
    signs = rng.choice([-1.0, 1.0], 2).tolist()
    if values['fault.kind'] == NO_FAULT:
        return ()
    if values['fault.sign'] is not None:
        signs = [1.0 if values['fault.sign'] >= 0.0 else -1.0] * 2
    if values['fault.kind'] in ('noise', 'spike'):
        signs = [1.0, 1.0]  # these have no direction
    sensor = values['fault.sensor'] or arm.sensor_names[0]
    sensors = [sensor]
    if sensor == BOTH:
        # The two of a two-link arm; of more, two by chance.
        chosen = range(2) if len(arm.sensor_names) == 2 else sorted(_two_of(arm, rng))
        sensors = [arm.sensor_names[i] for i in chosen]
    drift = values['fault.kind'] == 'drift'
    return tuple(
        Fault(
            name,
            values['fault.kind'],
            values['fault.onset'],
            values['fault.duration'],
            sign * values['fault.size'],
            values['fault.rate'] * (sign if drift else 1.0),
        )
        for name, sign in zip(sensors, signs)
    )


def _two_of(arm: Arm, rng: np.random.Generator) -> list[int]:
    count = len(arm.sensor_names)
    return rng.choice(count, min(2, count), replace=False).tolist()
