"""Simulation of arm, observer, diagnosis and tracking controller in closed loop."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from lpv.core.monitoring.parameters import DiagnosisParameters, check_parameters
from lpv.core.serial_arm.description import SerialArm
from lpv.core.simulation.closed_loop import Run, run_closed_loop
from lpv.core.simulation.faults import Fault
from lpv.core.simulation.scenario import Scenario
from lpv.core.uio.certificate.gains import Gains
from lpv.files import load_scenario


def simulate(
    arm: SerialArm,
    gains: Gains | None = None,
    scenario: Scenario | str | Path = 'two_faults',
    faults: Sequence[Fault] | None = None,
    compensation: str = 'confirmed',
    parameters: DiagnosisParameters | None = None,
) -> Run:
    """Simulate a scenario in closed loop.

    Parameters
    ----------
    arm : SerialArm
        The arm as it is modelled.
    gains : Gains, optional
        Of an arm with designed gains.
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
        If gains and arm do not belong together, the certificate of the gains does not hold,
        the scenario is wrong, or a parameter is out of range.
    """
    check_parameters(parameters)
    if gains is not None:
        gains.require(arm)
    chosen = load_scenario(scenario) if isinstance(scenario, (str, Path)) else scenario
    if faults is not None:
        chosen = replace(chosen, faults=tuple(faults))
    return run_closed_loop(arm, chosen, gains, compensation, parameters=parameters)
