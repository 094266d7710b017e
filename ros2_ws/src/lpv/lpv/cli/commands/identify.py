"""``lpv identify``: from recordings to an arm file."""

import argparse
import sys
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

from rich.console import Console

from lpv.bag.run.csv_import import ColumnMap, load_column_map
from lpv.cli.arm_choice import chosen_arm
from lpv.core.serial_arm.arm_file import save_arm
from lpv.core.serial_arm.description import SerialArm
from lpv.core.support.errors import ConfigError
from lpv.core.support.resources import bringup_file
from lpv.identify.estimation.gains import rescaled
from lpv.identify.estimation.identification import STEPS, Identification, Options, identify
from lpv.identify.estimation.mistakes import find_mistakes
from lpv.identify.estimation.payload import identify_payload, with_payload
from lpv.identify.estimation.torque_error import calibrate
from lpv.identify.recordings.recording import Recording, continued, read_recording
from lpv.identify.results.summary import calibration_table, table
from lpv.identify.sensors import describe, find_second_encoders, with_second_encoders


def run(arguments: argparse.Namespace) -> int:
    """Identify, show, write."""
    console = Console(stderr=True)
    if arguments.out:  # what fails is said before minutes of fitting
        Path(arguments.out).parent.mkdir(parents=True, exist_ok=True)
    files = [*arguments.recordings, *arguments.test]
    console.print(f'reading {len(files)} recording{"s" if len(files) > 1 else ""}: {files[0]} ...')
    arm, columns = _arm(arguments), None
    if arguments.columns:
        columns = load_column_map(bringup_file('columns', arguments.columns))
        _check_units(arm, columns, arguments.columns)

    def read(path: str) -> Recording:
        return continued(arm, read_recording(path, arm.joint_names, arguments.topic, columns))

    recordings = [read(path) for path in arguments.recordings]
    if arguments.payload:
        return _payload(arguments, arm, recordings)
    if arguments.calibrate:
        return _calibrate(arguments, arm, recordings)
    tests = [read(path) for path in arguments.test]
    options = Options(
        arguments.train_share, arguments.refit, arguments.without_gravity or arguments.with_gravity
    )
    with console.status('identifying') as status:
        number = count(1)

        def step(text: str) -> None:
            said = f'identifying, {next(number)} of {STEPS}: {text}'
            status.update(said)
            if not console.is_terminal:
                console.print(said)

        result = identify(arm, recordings, options, tests, step)
    print(table(result))
    for text in result.warnings:
        print(f'warning: {text}', file=sys.stderr)
    result = _with_second_encoders(arguments, result, columns)
    _save(result.arm, arguments)
    if arguments.report:
        from lpv.identify.results.report import write_report  # only here: it loads Matplotlib

        print(f'report: {write_report(result, Path(arguments.report))}')
    return 0


def _check_units(arm: SerialArm, columns: ColumnMap, source: str) -> None:
    for joint in arm.joints:
        if joint.is_prismatic and columns.unit(joint.name) == 'deg':
            raise ConfigError(f'joints.{joint.name}.unit', 'must be m: it is prismatic', source)


def _with_second_encoders(
    arguments: argparse.Namespace, result: Identification, columns: ColumnMap | None
) -> Identification:
    """The result with the second encoders that were named; says what they are."""
    pairs = dict(_pair(text) for text in arguments.second_encoder)
    if not pairs:
        return result
    found = find_second_encoders(arguments.recordings[0], pairs, arguments.topic, columns)
    for reading in found:
        print(describe(reading))
    return replace(result, arm=with_second_encoders(result.arm, found))


def _pair(text: str) -> tuple[str, str]:
    joint, _, name = text.partition('=')
    if not joint or not name:
        raise ConfigError('--second-encoder', f'{text!r} is not JOINT=NAME')
    return joint, name


def _arm(arguments: argparse.Namespace) -> SerialArm:
    """The arm that the fit starts from."""
    arm, gains = chosen_arm(arguments), arguments.gain
    changes: dict[str, Any] = {'name': arguments.name or arm.name}
    if arguments.base_rpy:
        changes['base_orientation'] = tuple(arguments.base_rpy)
    if arguments.without_gravity or arguments.with_gravity:
        changes['effort_includes_gravity'] = arguments.with_gravity
    if arguments.effort_unit == 'A':
        changes['effort_unit'] = 'A'
    if gains:
        count = len(arm.joints)
        if len(gains) not in (1, count) or 0.0 in gains:
            raise ConfigError('--gain', f'needs 1 or {count} numbers other than 0')
        gains = gains * count if len(gains) == 1 else gains
        changes['joints'] = tuple(replace(j, torque_gain=k) for j, k in zip(arm.joints, gains))
    return replace(arm, **changes)


def _payload(arguments: argparse.Namespace, arm: SerialArm, recordings: list[Recording]) -> int:
    found = identify_payload(arm, recordings)
    x, y, z = found.center
    spread = ' '.join(f'{2 * s:.4f}' for s in found.center_sigma)
    print(f'mass    {found.mass:8.3f} kg    +- {2 * found.mass_sigma:.3f}')
    print(
        f'centre  {x:8.4f} {y:.4f} {z:.4f} m +- {spread}    in the frame of {arm.joint_names[-1]}'
    )
    print(f'torque residual {found.rms_before:.3f} -> {found.rms_after:.3f} N m RMS')
    for text in found.warnings:
        print(f'warning: {text}', file=sys.stderr)
    result, what = with_payload(arm, found), 'arm with its tool'
    if arguments.known_mass is not None:
        factor = arguments.known_mass / found.mass
        result, what = rescaled(arm, factor), f'arm with its scale corrected by {factor:.4f}'
    _save(result, arguments, what)
    return 0


def _calibrate(arguments: argparse.Namespace, arm: SerialArm, recordings: list[Recording]) -> int:
    found = calibrate(arm, recordings)
    print(calibration_table(found))
    for text in (*found.warnings, *(m.text for m in find_mistakes(arm, recordings))):
        print(f'warning: {text}', file=sys.stderr)
    _save(found.arm, arguments)
    return 0


def _save(arm: SerialArm, arguments: argparse.Namespace, what: str = 'arm file') -> None:
    """Write the arm, unless nobody could read it."""
    if arguments.out:
        save_arm(arm, arguments.out)
        print(f'{what} written to {arguments.out}')
