"""What observes, and what of a bag is read: of several commands."""

import argparse
from typing import Any

from rich.console import Console

from lpv.bag.replay.replay import ReplayOptions
from lpv.bag.rosbag.output_folder import GAINS_NAME
from lpv.core.monitoring import parameters
from lpv.core.serial_arm.description import SerialArm
from lpv.core.support.config import Section, read_yaml
from lpv.core.support.resources import bringup_file, shipped_files
from lpv.core.uio.certificate.gains import Gains, gains_in, load_gains
from lpv.report.certificate import beside_bag, named_arm, shipped_arm


def reading_options(arguments: argparse.Namespace, **others: Any) -> ReplayOptions:
    """What of a bag is read, as the replay takes it."""
    topics, start = (arguments.topic, arguments.effort_topic), vars(arguments)['from']
    commanded = arguments.torque_source == 'command'
    return ReplayOptions(*topics, start, arguments.to, commanded, **others)


def arm_and_gains(
    arguments: argparse.Namespace, console: Console
) -> tuple[SerialArm, Gains | None]:
    """Arm and gains as arguments or bag say; gains only of an arm with a region, and certified."""
    gains = load_gains(bringup_file('gains', arguments.gains)) if arguments.gains else None
    arm, bag, kept = arguments.arm, getattr(arguments, 'bag', None), None
    if bag and not gains and not arguments.requirement:
        file = beside_bag(bag, GAINS_NAME)
        found = gains_in(file) if file is not None else None
        kept = found if isinstance(found, Gains) else None  # of an observer
    if arm is None:
        named = gains or kept
        arm = shipped_arm(named.arm_name if named else named_arm(bag) if bag else '')
        if not gains:
            console.print(f'arm {arm.name!r}{" and gains" if kept else ""} as in the bag')
    if arm.lpv is None and not (gains or arguments.requirement):
        return arm, None
    if kept and kept.fits(arm):
        gains = kept
    elif kept and not arguments.arm:
        kept.check_arm(arm, f'{bag}: {GAINS_NAME}')  # another arm of this name: say so
    gains = gains or _gains_of(arguments, arm, console)
    if gains is not None:  # as nodes do
        gains.require(arm, arguments.gains or GAINS_NAME)
    return arm, gains


def _gains_of(arguments: argparse.Namespace, arm: SerialArm, console: Console) -> Gains | None:
    """Gains that are designed for the requirement, if one is given or shipped."""
    # The solver is imported only where it is needed.
    from lpv_design.design_flow import design
    from lpv_design.requirement import load_requirement

    name = arguments.requirement or arm.name
    if not arguments.requirement and name not in shipped_files('requirements'):
        console.print(f'no gains of arm {arm.name!r}: the moving horizon observes alone')
        return None
    requirement = load_requirement(name)
    console.print(f'designing gains for arm {arm.name!r} ...')
    return design(arm, requirement).gains


def diagnosis_parameters(path: str | None) -> tuple[parameters.DiagnosisParameters, dict[str, Any]]:
    """Tuning in a parameter file of the node; its ``max_gap``, ``initial_samples`` if given."""
    if not path:
        return parameters.DiagnosisParameters(), {}
    nodes = Section(read_yaml(path), path).section('/**')
    values = nodes.section('ros__parameters')
    tuning, prefix = values.plain('diagnosis'), 'diagnosis.'
    for name, value in nodes.plain('ros__parameters').items():  # which ROS takes, too
        if name.startswith(prefix):
            tuning[name.removeprefix(prefix)] = value
    parameters.check_names(tuning, path)
    section, given = Section(tuning, path, 'diagnosis'), parameters.given_values
    diagnosis = parameters.DiagnosisParameters(**given(section, parameters.DIAGNOSIS))
    return diagnosis, given(values, parameters.SAMPLING)
