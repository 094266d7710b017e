"""Checks of arm, gains and scenario files; no graph is needed."""

from typing import Any

from lpv_cli.doctor.findings import Finding, error, ok, warn
from lpv_core.certificate.conditions import verify
from lpv_core.certificate.gains import load_gains
from lpv_core.serial_arm.any_arm import Arm, load_any_arm
from lpv_core.serial_arm.certificate.conditions import require_loop
from lpv_core.serial_arm.certificate.loop_gains import load_loop_gains, serial_parameters
from lpv_core.serial_arm.description import SerialArm
from lpv_core.serial_arm.diagnosis.monitor import SerialMonitor
from lpv_core.simulation.any_scenario import load_any_scenario, new_simulator
from lpv_core.support.errors import ConfigError, LpvError
from lpv_core.support.resources import bringup_file


def check_files(
    arm_name: str | None, gains_name: str | None, scenario_name: str | None
) -> tuple[Any, ...]:
    """Run the checks of the files that are given."""
    arm, findings = None, []
    if arm_name:
        arm, finding = check_arm(arm_name)
        findings.append(finding)
    if gains_name:
        findings.append(check_gains(gains_name, arm, arm_name))
    elif isinstance(arm, SerialArm):
        findings.append(
            ok(
                'gains',
                'a serial arm needs none: its bounds are statistical; lpv design certifies its '
                'tracking loop',
            )
        )
    elif arm is not None:
        findings.append(
            warn(
                'gains',
                'none given: no node starts without',
                f'lpv design --arm {arm_name} --out gains.yaml; then lpv doctor '
                f'--arm {arm_name} --gains gains.yaml',
            )
        )
    if scenario_name and not isinstance(arm, SerialArm):
        findings.append(check_scenario(scenario_name, arm))
    return arm, findings


def check_arm(name: str) -> tuple[Any, ...]:
    """Whether an arm file can be read."""
    try:
        arm = load_any_arm(bringup_file('arms', name))
        if isinstance(arm, SerialArm):
            SerialMonitor(arm)
    except LpvError as problem:
        return None, error('arm', str(problem), 'correct the field; docs/arm-file.md describes all')
    return arm, ok('arm', f'{arm.name!r}, joints {", ".join(arm.joint_names)}')


def check_gains(name: str, arm: Arm | None, arm_name: str | None = 'ARM') -> Finding:
    """Whether gains can be read, belong to the arm, and have a certificate that holds."""
    if isinstance(arm, SerialArm):
        return _check_loop(name, arm, arm_name)
    again = f'lpv design --arm {arm_name or "ARM"} --out {name}'
    try:
        gains = load_gains(name)
    except (LpvError, OSError) as problem:
        return error('gains', str(problem), again)
    if arm is None:
        return ok('gains', f'for arm {gains.arm_name!r}; give --arm to verify them')
    try:
        gains.check_arm(arm, name)
    except LpvError as problem:
        return error('gains', str(problem), f'{again}, or give the arm file that they are for')
    failed = [check.name for check in verify(arm, gains) if not check.holds]
    if failed:
        return error(
            'gains',
            f'the certificate does not hold: {"; ".join(failed)}',
            f'the numbers were changed after the design: {again}',
        )
    return ok('gains', f'certificate for arm {arm.name!r} holds')


def _check_loop(name: str, arm: SerialArm, arm_name: str | None) -> Finding:
    """As `check_gains`, of a serial arm's tracking loop."""
    again = f'lpv design --arm {arm_name or "ARM"} --out {name}'
    try:
        if serial_parameters(name) is None:
            raise ConfigError('gains', f'{arm.name!r} is a serial arm, these are for another kind')
        require_loop(arm, load_loop_gains(name), name)
    except (LpvError, OSError) as problem:
        return error('gains', str(problem), again)
    return ok('gains', f'certificate of the tracking loop of arm {arm.name!r} holds')


def check_scenario(name: str, arm: Arm | None) -> Finding:
    """Whether a scenario can be run with the arm."""
    remedy = 'correct the field; docs/scenario-file.md describes all'
    try:
        scenario = load_any_scenario(bringup_file('scenarios', name), arm)
        if arm is not None:
            new_simulator(arm, scenario)
    except LpvError as problem:
        return error('scenario', str(problem), remedy)
    return ok('scenario', f'{scenario.name!r}, {scenario.duration:g} s')
