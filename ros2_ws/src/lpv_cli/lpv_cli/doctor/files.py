"""Checks of arm, gains and scenario files; no graph is needed."""

from lpv_cli.doctor.finding import Finding, error, ok, warn
from lpv_core.serial_arm.any_arm import Arm, load_any_arm
from lpv_core.support.errors import LpvError
from lpv_core.support.resources import bringup_file


def check_files(
    arm_name: str | None, gains_name: str | None, scenario_name: str | None
) -> tuple[Arm | None, list[Finding]]:
    """Run the checks of the files that are given."""
    arm, found = check_arm(arm_name) if arm_name else (None, None)
    findings = [found] if found else []
    if gains_name:
        findings.append(check_gains(gains_name, arm, arm_name))
    elif arm is not None and needs_gains(arm):
        remedy = f'lpv design --arm {arm_name} --out gains.yaml; then lpv doctor --arm {arm_name} '
        remedy += '--gains gains.yaml'
        findings.append(warn('gains', 'none given: no node starts without', remedy))
    elif arm is not None:
        text = 'it needs none: its bounds are statistical; lpv design certifies its tracking loop'
        findings.append(ok('gains', text))
    if scenario_name:
        findings.append(check_scenario(scenario_name, arm))
    return arm, findings


def needs_gains(arm: Arm) -> bool:
    """Whether an arm is diagnosed with gains: two links in a plane."""
    return hasattr(arm, 'links')


def check_arm(name: str) -> tuple[Arm | None, Finding]:
    """Whether an arm file can be read, and the arm be watched."""
    from lpv_core.monitoring.factory import make_monitor

    try:
        arm = load_any_arm(bringup_file('arms', name))
        if not needs_gains(arm):
            make_monitor('doctor', arm)
    except LpvError as problem:
        return None, error('arm', str(problem), 'correct the field; docs/arm-file.md describes all')
    return arm, ok('arm', f'{arm.name!r}, joints {", ".join(arm.joint_names)}')


def check_gains(name: str, arm: Arm | None, arm_name: str | None = 'ARM') -> Finding:
    """Whether gains can be read, belong to the arm, and have a certificate that holds."""
    from lpv_report.certificate import examine, load_certified

    again = f'lpv design --arm {arm_name or "ARM"} --out {name}'
    try:
        text = load_certified(name).gains.arm_name
    except (LpvError, OSError) as problem:
        return error('gains', str(problem), again)
    if arm is None:
        return ok('gains', f'for arm {text!r}; give --arm to verify them')
    found = examine(name, arm)
    if found.problem:
        return error('gains', found.problem, f'{again}, or give the arm file that they are for')
    if not found.holds:
        failed = f'the certificate does not hold: {"; ".join(found.failed)}'
        return error('gains', failed, f'the numbers were changed after the design: {again}')
    return ok('gains', f'certificate of the {found.what} of arm {arm.name!r} holds')


def check_scenario(name: str, arm: Arm | None) -> Finding:
    """Whether a scenario can be run with the arm."""
    from lpv_core.simulation.any_scenario import load_any_scenario, new_simulator

    try:
        scenario = load_any_scenario(bringup_file('scenarios', name), arm)
        if arm is not None:
            new_simulator(arm, scenario)
    except LpvError as problem:
        remedy = 'correct the field; docs/scenario-file.md describes all'
        return error('scenario', str(problem), remedy)
    return ok('scenario', f'{scenario.name!r}, {scenario.duration:g} s')
