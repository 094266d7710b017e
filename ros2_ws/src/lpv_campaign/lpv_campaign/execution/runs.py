"""One run of a campaign: from its number to its signals."""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from lpv_campaign.plan.campaign import Campaign
from lpv_campaign.plan.paths import random_path
from lpv_campaign.plan.spec import BOTH, NO_FAULT
from lpv_core.certificate.gains import Gains
from lpv_core.decision.diagnosis import DiagnosisParameters
from lpv_core.model.arm import ArmParameters
from lpv_core.simulation.closed_loop import Run, Transport, run_closed_loop
from lpv_core.simulation.faults import Fault
from lpv_core.simulation.scenario import Scenario

_TUNING = {f'diagnosis.{field.name}': field.name for field in fields(DiagnosisParameters)}


@dataclass(frozen=True)
class RunPlan:
    """What is simulated in one run."""

    number: int  # Number of the run
    values: dict  # Of the factors
    arm: ArmParameters  # Nominal arm, with the run's sample time
    gains: Gains  # Its gains
    scenario: Scenario  # What happens
    parameters: DiagnosisParameters  # Tuning of the diagnosis
    compensation: str  # What the loop closes on
    substeps: int  # As in `lpv_core.simulation.closed_loop.run_closed_loop`
    delay: int  # As in `lpv_core.simulation.closed_loop.run_closed_loop`
    loss: float  # Likewise

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


def plan_run(campaign: Campaign, number: int) -> RunPlan:
    """What is simulated in a run.

    Parameters
    ----------
    campaign : Campaign
        The campaign.
    number : int
        Number of the run; with the campaign it determines everything.

    Returns
    -------
    RunPlan
        Ready to be simulated.
    """
    values, spec = campaign.values(number), campaign.spec
    # Not the generator of the plan's points, which must not depend on what else is random in a run.
    rng = np.random.default_rng([spec.seed, 2, number])
    seed = int(rng.integers(2**31))
    time = values['sample_time'] or campaign.arm.sample_time
    arm = replace(campaign.arm, sample_time=time)
    scenario = _on_path(campaign, arm, values['path'], rng)
    given = {name: values[name] for name in _SCALARS if values[name] is not None}
    scenario = replace(
        scenario,
        name=f'{spec.name} {number}',
        seed=seed,
        mass_factors=_pair(values, 'mass', scenario.mass_factors),
        inertia_factors=_pair(values, 'inertia', scenario.inertia_factors),
        **{_SCALARS[name]: value for name, value in given.items()},
    )
    if 'fault.kind' in spec.factors:
        scenario = replace(scenario, faults=_faults(arm, values, rng))
    tuning = {field: values[name] for name, field in _TUNING.items() if name in values}
    return RunPlan(
        number,
        values,
        arm,
        campaign.gains(values['design'], time),
        scenario,
        DiagnosisParameters(**tuning),
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
}
"""Factors that replace a field of the scenario."""


def _on_path(
    campaign: Campaign, arm: ArmParameters, path: str, rng: np.random.Generator
) -> Scenario:
    """The scenario of a run with its path and its length."""
    spec = campaign.spec
    scenario = campaign.scenario(spec.scenario)
    duration = spec.duration or scenario.duration
    if path == 'random':
        times, points = random_path(arm, rng, duration)
        return replace(
            scenario, duration=duration, times=times, points=points, elbow='positive', obstacle=None
        )
    if path != 'scenario':
        other = campaign.scenario(path)
        scenario = replace(
            scenario,
            times=other.times,
            points=other.points,
            elbow=other.elbow,
            obstacle=other.obstacle,
        )
    return replace(scenario, duration=duration)


def _pair(values: dict[str, Any], name: str, default: tuple[float, float]) -> tuple[float, float]:
    given = values[f'{name}_1'], values[f'{name}_2']
    return (
        default[0] if given[0] is None else given[0],
        default[1] if given[1] is None else given[1],
    )


def _faults(
    arm: ArmParameters, values: dict[str, Any], rng: np.random.Generator
) -> tuple[Fault, ...]:
    signs = rng.choice([-1.0, 1.0], 2).tolist()
    if values['fault.kind'] == NO_FAULT:
        return ()
    if values['fault.sign'] is not None:
        signs = [1.0 if values['fault.sign'] >= 0.0 else -1.0] * 2
    if values['fault.kind'] in ('noise', 'spike'):
        signs = [1.0, 1.0]  # these have no direction
    sensor = values['fault.sensor'] or arm.sensor_names[0]
    sensors = arm.sensor_names if sensor == BOTH else (sensor,)
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
