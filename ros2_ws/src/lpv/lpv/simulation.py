"""Simulation of arm, observer, diagnosis and tracking controller in closed loop."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from lpv.files import load_scenario
from lpv_core.certificate.conditions import require
from lpv_core.certificate.gains import Gains
from lpv_core.decision.diagnosis import DiagnosisParameters
from lpv_core.model.arm import ArmParameters
from lpv_core.simulation.closed_loop import Run, run_closed_loop
from lpv_core.simulation.faults import Fault
from lpv_core.simulation.scenario import Scenario


def simulate(
    arm: ArmParameters,
    gains: Gains,
    scenario: Scenario | str | Path = 'two_faults',
    faults: Sequence[Fault] | None = None,
    compensation: str = 'confirmed',
    parameters: DiagnosisParameters | None = None,
) -> Run:
    """Simulate a scenario in closed loop.

    Parameters
    ----------
    arm : ArmParameters
        The arm as it is modelled.
    gains : Gains
        Its gains.
    scenario : Scenario or str or pathlib.Path, optional
        Path, plant, noise, disturbance and faults; a file, or the name of a shipped one.
    faults : sequence of Fault, optional
        In place of the scenario's.
    compensation : {'off', 'confirmed', 'always'}, optional
        Whether the controller uses measured positions, positions without confirmed faults, or
        positions without any fault estimate.
    parameters : DiagnosisParameters, optional
        Tuning of the diagnosis.

    Returns
    -------
    Run
        All signals, one row per sample [rad], [rad/s], [N m], [s], and ``alarms``.

    Raises
    ------
    ConfigError
        If gains and arm do not belong together, the certificate of the gains does not hold, or
        the scenario is wrong.
    """
    require(arm, gains, 'gains')
    chosen = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    if faults is not None:
        chosen = replace(chosen, faults=tuple(faults))
    return run_closed_loop(arm, gains, chosen, compensation, parameters)
