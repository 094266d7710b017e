"""One run of a campaign: from its number to its signals and figures."""

import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lpv_campaign.execution.run_metrics import figures
from lpv_campaign.plan.arms import ArmKind
from lpv_campaign.plan.campaign import Campaign
from lpv_campaign.plan.spec import BOTH, NO_FAULT, TUNING
from lpv_core.certificate.gains import Gains
from lpv_core.decision.diagnosis import DiagnosisParameters
from lpv_core.simulation.any_scenario import AnyScenario, parse_any_scenario
from lpv_core.support.errors import LpvError

_PLANT = {
    'plant': 'model',
    'payload': 'payload',
    'friction': 'friction_factor',
    'noise': 'noise_factor',
    'disturbance': 'disturbance_factor',
    'parameter_error': 'parameter_error',
}
"""Factors that replace a field of the scenario's plant."""


@dataclass(frozen=True)
class RunPlan:
    """What is simulated in one run."""

    number: int  # Number of the run
    values: dict  # Of the factors
    kind: ArmKind  # How the arm is simulated
    arm: Any  # Nominal arm, with the run's sample time
    gains: Gains | None  # Its gains, if it needs any
    files: dict  # Content of the run's ``arm`` and ``scenario`` files
    scenario: AnyScenario  # The latter, parsed
    parameters: DiagnosisParameters  # Tuning of the diagnosis
    compensation: str  # What the loop closes on
    substeps: int  # Least number of plant steps per sample
    delay: int  # Samples from a measurement to the effect of its command
    loss: float  # Probability that a measurement is lost

    def simulate(self, faults: bool = True) -> Any:
        """Run the closed loop; ``faults=False``: its healthy twin."""
        scenario = self.scenario if faults else replace(self.scenario, faults=())
        return self.kind.simulate(self, scenario)


def plan_run(campaign: Campaign, number: int) -> RunPlan:
    """What is simulated in a run; campaign and number determine everything."""
    values, spec = campaign.values(number), campaign.spec
    # Not the generator of the plan's points, which must not depend on what else is random in a run.
    rng = np.random.default_rng([spec.seed, 2, number])
    seed = int(rng.integers(2**31))
    time = values['sample_time'] or campaign.arm.sample_time
    arm = replace(campaign.arm, sample_time=time)
    content = copy.deepcopy(campaign.content['scenarios'][spec.scenario])
    content.update(name=f'{spec.name} {number}', seed=seed)
    content['duration'] = duration = spec.duration or content['duration']
    path = values['path']
    if path == 'random':
        content['path'] = campaign.kind.random_path(arm, rng, duration)
    elif path != 'scenario':
        content['path'] = campaign.content['scenarios'][path]['path']
    plant = content.setdefault('plant', {})
    plant.update({_PLANT[name]: values[name] for name in _PLANT if values[name] is not None})
    for name in ('mass', 'inertia'):
        given = [values[f'{name}_{i}'] for i in (1, 2)]
        if given != [None, None]:
            old = np.broadcast_to(plant.get(f'{name}_factors', 1.0), 2).tolist()
            pair = [before if new is None else new for new, before in zip(given, old)]
            plant[f'{name}_factors'] = pair
    if 'fault.kind' in spec.factors:
        content['faults'] = _faults(arm.sensor_names, values, rng)
    tuning = {field: values[name] for name, field in TUNING.items() if name in values}
    return RunPlan(
        number,
        values,
        campaign.kind,
        arm,
        campaign.gains(values['design'], time),
        {'arm': {**campaign.content['arm'], 'sample_time': time}, 'scenario': content},
        parse_any_scenario(content, f'run {number}', arm),
        DiagnosisParameters(**tuning),
        values['compensation'],
        spec.substeps,
        round(values['command_delay']),
        values['sample_loss'],
    )


def _faults(
    names: tuple[str, ...], values: dict[str, Any], rng: np.random.Generator
) -> list[dict[str, Any]]:
    kind, signs = values['fault.kind'], rng.choice([-1.0, 1.0], 2).tolist()
    if kind == NO_FAULT:
        return []
    if values['fault.sign'] is not None:
        signs = [1.0 if values['fault.sign'] >= 0.0 else -1.0] * 2
    if kind in ('noise', 'spike'):
        signs = [1.0, 1.0]  # these have no direction
    sensors = [values['fault.sensor'] or names[0]]
    if sensors == [BOTH]:
        # The two of a two-link arm; of more, two by chance.
        count = len(names)
        chosen = range(2) if count == 2 else sorted(rng.choice(count, min(2, count), replace=False))
        sensors = [names[i] for i in chosen]
    return [
        {
            'sensor': sensor,
            'kind': kind,
            'onset': values['fault.onset'],
            'duration': values['fault.duration'],
            'size': sign * values['fault.size'],
            'rate': values['fault.rate'] * (sign if kind == 'drift' else 1.0),
        }
        for sensor, sign in zip(sensors, signs)
    ]


def run_one(campaign: Campaign, number: int) -> dict[str, Any]:
    """Simulate a run and measure it; a row of the results."""
    try:
        plan = plan_run(campaign, number)
        run = plan.simulate()
        twin = plan.simulate(faults=False) if campaign.spec.twin and plan.scenario.faults else None
    except LpvError as error:
        raise LpvError(f'run {number}: {error}') from error
    return {'number': number, **plan.values, **figures(plan, run, twin)}
