"""Checks of arm, gains and scenario files; no graph is needed."""

from pathlib import Path

from lpv.cli.doctor.finding import Finding, error, ok, warn
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.serial_arm.arm_file import load_arm
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.dynamics.aligned_axes import aligned_axes
from lpv.core.simulation.arm_simulator import ArmSimulator
from lpv.core.simulation.scenario import load_scenario
from lpv.core.support.errors import ConfigError, LpvError
from lpv.core.support.resources import bringup_file

_CORRECT = 'correct the field; docs/{}-file.md describes all'


def check_files(
    arm_name: str | None, gains_name: str | None, scenario_name: str | None
) -> tuple[SerialArm | None, list[Finding]]:
    """Run the checks of the files that are given."""
    arm, found = check_arm(arm_name) if arm_name else (None, None)
    findings = [found] if found else []
    if gains_name:
        findings.append(check_gains(gains_name, arm, arm_name))
    elif arm is not None:
        what = 'designs them' if arm.lpv is not None else 'certifies the tracking loop'
        offer = f'lpv design {what}'
        if any(joint.is_prismatic for joint in arm.joints):
            offer = 'loops of joints that slide have no certificate'
        elif len(arm.joints) < 2:
            offer = 'loops of one joint have no certificate'
        findings.append(ok('gains', f'none given: the moving horizon observes alone; {offer}'))
    if scenario_name:
        findings.append(check_scenario(scenario_name, arm))
    return arm, findings


def check_arm(name: str) -> tuple[SerialArm | None, Finding]:
    """Whether an arm file can be read, and the arm be watched."""

    try:
        arm = load_arm(bringup_file('arms', name))
        SerialSensorMonitor('doctor', arm)
    except LpvError as problem:
        return None, error('arm', str(problem), _CORRECT.format('arm'))
    if odd := [joint.name for joint in arm.joints if not joint.link.is_physical]:
        text = f'{arm.name!r}: no body has the inertia of the link of {", ".join(odd)}'
        return arm, warn('arm', text, 'give first moments and inertia about the joint frame')
    if aligned := aligned_axes(arm):
        what, _, remedy = aligned.partition('; ')
        return arm, warn('arm', f'{arm.name!r}: {what}', remedy)
    return arm, ok('arm', f'{arm.name!r}, joints {", ".join(arm.joint_names)}')


def check_gains(name: str, arm: SerialArm | None, arm_name: str | None) -> Finding:
    """Whether gains can be read, belong to the arm, and have a certificate that holds."""
    from lpv.core.uio.certificate.gains import load_certified
    from lpv.report.certificate import examine

    out = name if Path(name).suffix else f'{name}.yaml'
    again = f'lpv design --arm {arm_name or "ARM"} --out {out}'
    try:
        file = bringup_file('gains', name)
        text = load_certified(file).arm_name
    except (LpvError, OSError) as problem:
        return error('gains', str(problem), again)
    if arm is None:
        return ok('gains', f'for arm {text!r}; give --arm to verify them')
    found = examine(file, arm)
    if found.problem:
        return error('gains', found.problem, f'{again}, or give the arm file that they are for')
    if not found.holds:
        failed = f'the certificate does not hold: {"; ".join(found.failed)}'
        return error('gains', failed, f'the numbers were changed after the design: {again}')
    return ok('gains', f'certificate of the {found.what} of arm {arm.name!r} holds')


def check_scenario(name: str, arm: SerialArm | None) -> Finding:
    """Whether a scenario can be run with the arm."""
    try:
        scenario = load_scenario(bringup_file('scenarios', name))
        if arm is not None:
            ArmSimulator(arm, scenario)
    except LpvError as problem:
        # What cannot be simulated may be the arm itself.
        of_arm = isinstance(problem, ConfigError) and problem.field.startswith('joints[')
        file = 'arm' if of_arm else 'scenario'
        return error(file, str(problem), _CORRECT.format(file))
    return ok('scenario', f'{scenario.name!r}, {scenario.duration:g} s')
