"""The arm file: reading, writing."""

import math
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from lpv.core.serial_arm.chain import MAX_JOINTS, compile_chain
from lpv.core.serial_arm.description import (
    INERTIA_KEYS,
    JOINT_TYPES,
    JointLimits,
    JointSensors,
    LinkInertia,
    ParameterCovariance,
    SerialArm,
    SerialJoint,
    Uncertainty,
)
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.core.serial_arm.old_arm_file import parse_two_links
from lpv.core.serial_arm.urdf_chain import read_urdf_chain
from lpv.core.support.config import Section, read_yaml, write_yaml
from lpv.core.support.entries import plain_entries, read_entries
from lpv.core.support.errors import ConfigError, each, kept, raise_all
from lpv.core.support.limits import FAR, TURN

_OLD_FORM = (
    '{} is of the form of two-link arms that the next version does not read; write it anew: '
    'python -m lpv.core.serial_arm.arm_file OLD.yaml NEW.yaml'
)
_SMALLEST_DETERMINANT = 1e-6
"""Of a matrix of sensors that tell the joints' positions; smaller ones count as singular."""
_ROUNDED = 1e-14
"""Share of the largest joint inertia that rounding leaves of none."""
_HEADER = 'docs/arm-file.md describes the fields.'


def load_arm(path: str | Path) -> SerialArm:
    """Read an arm file.

    Parameters
    ----------
    path : str or pathlib.Path
        YAML file; see ``docs/arm-file.md`` for its fields.  Files of two links in the form of
        older versions are read, too, with a warning.

    Returns
    -------
    SerialArm
        The validated arm.

    Raises
    ------
    ConfigError
        If a field is missing, unknown, of the wrong type or out of range; it names the field.
    """
    if Path(path).suffix in ('.urdf', '.xacro'):
        raise ConfigError('arm', 'is a URDF: lpv init --urdf makes an arm file of it', str(path))
    return parse_arm(read_yaml(path), str(path), Path(path).parent)


def parse_arm(data: dict[str, Any], source: str = 'arm', folder: str | Path = '.') -> SerialArm:
    """Build an arm from the mapping of an arm file, of the present form or an older one.

    Parameters
    ----------
    data : dict
        Content of the file.
    source : str, optional
        Name for error messages.
    folder : str or pathlib.Path, optional
        Where a relative ``urdf`` is looked for.

    Returns
    -------
    SerialArm
        The validated arm.

    Raises
    ------
    ConfigError
        As `load_arm`.
    """
    if isinstance(data, dict) and 'links' in data:
        warnings.warn(_OLD_FORM.format(source), FutureWarning, stacklevel=2)
        return parse_two_links(data, source)
    return _parse(data, source, folder)


def check_inertia(arm: SerialArm, source: str) -> None:
    """Refuse a joint that moves no inertia, ConfigError: no torque says what it does."""
    # In a posture without symmetries: bodies that are points on the axis have no inertia about it.
    posture = np.linspace(0.3, 1.3, len(arm.joints))
    own = np.abs(SerialModel(compile_chain(arm)).mass_matrix(posture).diagonal())
    for i, joint in enumerate(arm.joints):
        if own[i] <= _ROUNDED * own.max():
            why = f'{joint.name} moves no mass off its axis; a URDF may lack inertias'
            raise ConfigError(f'joints[{i}].link', why, source)


def _parse(data: dict[str, Any], source: str, folder: str | Path) -> SerialArm:
    top = Section(data, source)
    errors: list[ConfigError] = []
    joints: tuple[SerialJoint, ...] = ()
    urdf = top.text('urdf') if 'urdf' in top else ''
    held, locked = top.plain('locked'), top.section('locked', required=False)
    angles = {str(name): locked.number(name, None, -1e3, 1e3) for name in sorted(held)}
    with kept(errors):
        joints = _joints(top, urdf, Path(folder), angles)
    n = len(joints)
    with kept(errors):
        arm = read_entries(
            SerialArm,
            top,
            name=lambda: top.text('name'),
            joints=joints,
            urdf=urdf,
            locked=tuple(angles.items()),
            uncertainty=lambda: _uncertainty(top, n),
            sensor_matrix=lambda: _sensor_matrix(top, n),
            covariance=lambda: _covariance(top, 15 * n),
        )
    raise_all(errors)
    if arm.lpv is not None and n != 2:
        raise top.error('lpv', f'is for planar arms of two joints, this one has {n}')
    for names, field in ((arm.joint_names, 'joints'), (arm.sensor_names, 'sensors')):
        if len(set(names)) < len(names):
            raise top.error(field, 'use a name twice')
    if joints[0].rotor_coupling != 0.0:
        raise top.error('joints[0].rotor_coupling', 'must be 0: there is no joint before')
    check_inertia(arm, source)
    return arm


def _uncertainty(top: Section, n: int) -> Uncertainty:
    varying = top.section('uncertainty', required=False)
    errors: dict[str, Any] = {
        key: varying.vector(key, n, low=0.0, high=1e9)
        for key in ('torque_error', 'torque_error_speed')
        if key in varying and n > 0
    }
    return read_entries(Uncertainty, varying, **errors)


def _sensor_matrix(top: Section, n: int) -> tuple[tuple[float, ...], ...] | None:
    if 'sensor_matrix' not in top or n == 0:
        return None
    rows = top.rows('sensor_matrix', n, n)
    if np.abs(rows).max() > FAR:
        raise top.error('sensor_matrix', f'must lie within +-{FAR:g}')
    if len(rows) != n or abs(np.linalg.det(np.array(rows))) < _SMALLEST_DETERMINANT:
        raise top.error('sensor_matrix', f'must have {n} rows and an inverse')
    return tuple(tuple(row) for row in rows)


def save_arm(arm: SerialArm, path: str | Path) -> None:
    """Write an arm file, from which `load_arm` reads the same arm, bit by bit.

    Parameters
    ----------
    arm : SerialArm
        The arm.
    path : str or pathlib.Path
        File to write; an existing one is replaced.

    Raises
    ------
    ConfigError
        If `load_arm` would refuse the file; nothing is written.
    """
    path, content = Path(path), to_mapping(arm)
    parse_arm(content, f'{path} is not written', path.parent)
    write_yaml(path, content, _HEADER)


def to_mapping(arm: SerialArm) -> dict[str, Any]:
    """Content of the arm file of an arm, for `parse_arm`."""
    result = plain_entries(arm)
    if arm.locked:
        result['locked'] = dict(arm.locked)
    for joint in result['joints']:
        joint['link']['inertia'] = dict(zip(INERTIA_KEYS, joint['link']['inertia']))
        for name, usual in (('rotor_coupling', 0.0), ('type', JOINT_TYPES[0])):
            if joint[name] == usual:
                del joint[name]
    last = ('joints', 'sensor_matrix', 'lpv', 'covariance')
    return {name: result[name] for name in sorted(result, key=lambda name: name in last)}


def _joints(
    top: Section, urdf: str, folder: Path, locked: dict[str, float]
) -> tuple[SerialJoint, ...]:
    sections = top.sections('joints', [] if urdf else None)
    if len(sections) > MAX_JOINTS or not (sections or urdf):
        raise top.error('joints', f'must describe 1 to {MAX_JOINTS} joints, or urdf be given')
    if all('position' in s and 'link' in s for s in sections) and sections:
        return each(lambda section: _joint(section, None), sections)
    if not urdf:
        raise top.error(
            'joints', 'must have position, orientation, axis and link each, or urdf be given'
        )
    names = [section.text('name') for section in sections]
    chain = read_urdf_chain(folder / urdf, locked, names or None)
    if not sections:
        return chain.joints
    if list(chain.joint_names) != names:
        raise top.error(
            'joints', 'must be in the order of the URDF: ' + ', '.join(chain.joint_names)
        )
    return each(lambda one: _joint(*one), zip(sections, chain.joints))


def _joint(section: Section, base: SerialJoint | None) -> SerialJoint:
    """A joint of the file; what it does not say comes from the URDF's joint ``base``."""
    given: dict[str, Any] = {'name': lambda: section.text('name')}
    # What places the frame comes from one source: a mix of both would fit neither.
    if base is None or any(key in section for key in ('position', 'orientation', 'axis')):
        given['position'] = lambda: section.vector('position', 3, None, -FAR, FAR)
        given['orientation'] = lambda: section.vector('orientation', 3, (0.0,) * 3, -TURN, TURN)
        given['axis'] = lambda: _axis(section)
    if base is None or 'link' in section:
        given['link'] = lambda: read_entries(LinkInertia, section.section('link'))
    limits = None if base is None else base.limits
    given['limits'] = lambda: read_entries(
        JointLimits, section.section('limits', required=False), limits
    )
    given['sensors'] = lambda: _sensors(section)
    joint = read_entries(SerialJoint, section, base, **given)
    if base is not None and joint.type != base.type:
        raise section.error('type', f'is {base.type} in the URDF')
    if not joint.friction.is_dissipative(joint.limits.velocity):
        raise section.error(
            'friction',
            'drives the joint below its velocity limit: viscous is too negative for coulomb',
        )
    if joint.torque_gain == 0.0:
        raise section.error('torque_gain', 'must not be 0')
    return joint


def _axis(section: Section) -> tuple[float, float, float]:
    x, y, z = section.vector('axis', 3, (0.0, 0.0, 1.0), -1e6, 1e6)
    length = math.sqrt(x * x + y * y + z * z)
    if not 1e-6 < length < 1e6:
        raise section.error('axis', 'must not be 0')
    return (x, y, z) if abs(length - 1.0) < 1e-12 else (x / length, y / length, z / length)


def _sensors(section: Section) -> JointSensors:
    sensors = section.section('sensors', required=False)
    name = sensors.text('name', f'{section.text("name")}_encoder')
    return read_entries(JointSensors, sensors, name=name)


def _covariance(top: Section, size: int) -> ParameterCovariance | None:
    if 'covariance' not in top or size == 0:
        return None
    part = top.section('covariance')
    rows = part.rows('factor', size, size)
    return read_entries(ParameterCovariance, part, factor=tuple(map(tuple, rows)))


if __name__ == '__main__':
    save_arm(load_arm(sys.argv[1]), sys.argv[2])
