"""``lpv identify``: from recordings to an arm file."""

import argparse
import sys
from collections.abc import Iterable
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

from rich.console import Console

from lpv.bag.run.csv_import import ColumnMap, load_column_map
from lpv.cli.arm_choice import chosen_arm
from lpv.cli.options import refuse
from lpv.core.serial_arm.arm_file import save_arm
from lpv.core.serial_arm.description import SerialArm
from lpv.core.support.errors import ConfigError
from lpv.core.support.resources import bringup_file
from lpv.identify.errors import IdentificationError
from lpv.identify.estimation.gains import rescaled
from lpv.identify.estimation.identification import STEPS, identify
from lpv.identify.estimation.mistakes import find_mistakes
from lpv.identify.estimation.payload import identify_payload, unknown_load, with_payload
from lpv.identify.estimation.torque_error import calibrate
from lpv.identify.recordings.recording import Recording, continued, read_recording
from lpv.identify.results.summary import calibration_table, table
from lpv.identify.sensors import SecondReading, describe, find_second_encoders, with_second_encoders

_LARGEST_GAIN = 1e6
"""Joint torque per unit of effort that an arm file may have [N m per unit]."""


def run(arguments: argparse.Namespace) -> int:
    """Identify, show, write."""
    console = Console(stderr=True, markup=False)
    if arguments.payload or arguments.calibrate:
        reason = 'has no effect on --calibrate and --payload: parameters are not fitted'
        refuse(arguments, ('report', 'test', 'refit'), reason)
    if not arguments.payload:
        refuse(arguments, ['known_mass'], 'is that of a tool: give --payload')
    if arguments.out:  # what fails is said before minutes of fitting
        if Path(arguments.out).is_dir():
            raise ConfigError('--out', 'must be a file, not a folder', arguments.out)
        Path(arguments.out).parent.mkdir(parents=True, exist_ok=True)
    files = [*arguments.recordings, *arguments.test]
    console.print(f'reading {len(files)} recording{"s" if len(files) > 1 else ""}: {files[0]} ...')
    arm, columns = _arm(arguments), None
    if arguments.columns:
        columns = load_column_map(bringup_file('columns', arguments.columns))
        for joint in arm.joints:
            if joint.is_prismatic and columns.units.get(joint.name) == 'deg':
                field = f'joints.{joint.name}.unit'
                raise ConfigError(field, 'must be m or mm: it is prismatic', arguments.columns)

    second = _second_encoders(arguments, arm, columns)

    def read(path: str) -> Recording:
        return continued(arm, read_recording(path, arm.joint_names, arguments.topic, columns))

    recordings, what, result = [read(path) for path in arguments.recordings], 'arm file', None
    if arguments.payload:
        arm, what = _payload(arm, recordings, arguments.known_mass)
    elif arguments.calibrate:
        found = calibrate(arm, recordings)
        print(calibration_table(found))
        mistakes = [one.text for one in find_mistakes(arm, recordings)]
        _warn((*found.warnings, *(mistakes or unknown_load(arm, recordings))))
        arm = found.arm
    else:
        tests = [read(path) for path in arguments.test]
        weight_is_known = arguments.without_gravity or arguments.with_gravity
        with console.status('identifying') as status:
            number = count(1)

            def step(text: str) -> None:
                said = f'identifying, {next(number)} of {STEPS}: {text}'
                status.update(said)
                if not console.is_terminal:
                    console.print(said)

            result = identify(
                *(arm, recordings, tests, step),
                *(arguments.train_share, arguments.refit, weight_is_known),
            )
        print(table(result))
        _warn(result.warnings)
        arm = result.arm
    arm = with_second_encoders(arm, second)
    if arguments.out:
        save_arm(arm, arguments.out)
        print(f'{what} written to {arguments.out}')
    if result is not None and arguments.report:
        from lpv.identify.results.report import write_report  # only here: it loads Matplotlib

        print(f'report: {write_report(replace(result, arm=arm), Path(arguments.report))}')
    return 0


def _second_encoders(
    arguments: argparse.Namespace, arm: SerialArm, columns: ColumnMap | None
) -> list[SecondReading]:
    """The second encoders that were named; says what they are."""
    pairs = {}
    for text in arguments.second_encoder:
        joint, _, name = text.partition('=')
        if not joint or not name:
            raise ConfigError('--second-encoder', f'{text!r} is not JOINT=NAME')
        pairs[joint] = name
    if not pairs:
        return []
    found = find_second_encoders(arguments.recordings[0], pairs, arguments.topic, columns)
    arm, units = with_second_encoders(arm, found), dict(zip(arm.joint_names, arm.position_units))
    for reading in found:
        print(describe(reading, units[reading.joint]))
    return found


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
        if len(gains) not in (1, count) or not all(0.0 < abs(k) <= _LARGEST_GAIN for k in gains):
            reason = f'needs 1 or {count} numbers other than 0, to {_LARGEST_GAIN:g} in magnitude'
            raise ConfigError('--gain', reason)
        gains = gains * count if len(gains) == 1 else gains
        changes['joints'] = tuple(replace(j, torque_gain=k) for j, k in zip(arm.joints, gains))
    return replace(arm, **changes)


def _payload(
    arm: SerialArm, recordings: list[Recording], known_mass: float | None
) -> tuple[SerialArm, str]:
    try:
        found = identify_payload(arm, recordings)
    except IdentificationError:
        _warn(mistake.text for mistake in find_mistakes(arm, recordings))
        raise
    x, y, z = found.center
    spread = ' '.join(f'{2 * s:.4f}' for s in found.center_sigma)
    print(f'mass    {found.mass:8.3f} kg    +- {2 * found.mass_sigma:.3f}')
    print(
        f'centre  {x:8.4f} {y:.4f} {z:.4f} m +- {spread}    in the frame of {arm.joint_names[-1]}'
    )
    print(f'torque residual {found.rms_before:.3f} -> {found.rms_after:.3f} N m RMS')
    loaded = with_payload(arm, found)
    _warn((*found.warnings, *(m.text for m in find_mistakes(loaded, recordings))))
    if known_mass is None:
        return loaded, 'arm with its tool'
    factor = known_mass / found.mass
    return rescaled(arm, factor), f'arm with its scale corrected by {factor:.4f}'


def _warn(texts: Iterable[str]) -> None:
    for text in texts:
        print(f'warning: {text}', file=sys.stderr)
