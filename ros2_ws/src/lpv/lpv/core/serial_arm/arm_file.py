"""The arm file: reading, writing."""

import math
import sys
import warnings
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from lpv.core.serial_arm.chain import MAX_JOINTS
from lpv.core.serial_arm.description import (
    JOINT_TYPES,
    JointFriction,
    JointLimits,
    JointSensors,
    LinkInertia,
    LpvRegion,
    ParameterCovariance,
    SerialArm,
    SerialJoint,
    TorqueTolerance,
    Uncertainty,
)
from lpv.core.serial_arm.old_arm_file import parse_two_links
from lpv.core.serial_arm.urdf_chain import read_urdf_chain
from lpv.core.support.config import Section, names_all_errors, read_yaml, write_whole
from lpv.core.support.entries import read_entries
from lpv.core.support.limits import LARGEST

_OLD_FORM = (
    '{} is of the form of two-link arms that the next version does not read; write it anew: '
    'python -m lpv.core.serial_arm.arm_file OLD.yaml NEW.yaml'
)
INERTIA_KEYS = ('xx', 'xy', 'yy', 'xz', 'yz', 'zz')
FAR = 1e3
"""Range of coordinates, angles and gears in files [m], [rad], [1]."""
_SMALLEST_DETERMINANT = 1e-6
"""Of a matrix of sensors that tell the joints' positions; smaller ones count as singular."""
_HEADER = '# docs/arm-file.md describes the fields.\n'


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


@names_all_errors
def _parse(data: dict[str, Any], source: str, folder: str | Path) -> SerialArm:
    top = Section(data, source)
    name = top.text('name')
    urdf = top.text('urdf') if 'urdf' in top else ''
    locked = _locked(top)
    joints = _joints(top, urdf, Path(folder), dict(locked))
    effort = top.section('effort', required=False)
    varying = top.section('uncertainty', required=False)
    errors = ('torque_error', 'torque_error_speed')
    uncertainty = read_entries(
        Uncertainty, varying, **{key: _per_joint(varying, key, len(joints)) for key in errors}
    )
    arm = SerialArm(
        name=name,
        joints=joints,
        urdf=urdf,
        locked=locked,
        base_orientation=_triple(top, 'base_orientation', -2 * math.pi, 2 * math.pi),
        gravity=top.number('gravity', 9.81, 0.0, 100.0),
        tip=_triple(top, 'tip', -FAR, FAR),
        effort_includes_gravity=effort.flag('includes_gravity', True),
        effort_unit=effort.text('unit', 'N m'),
        effort_bandwidth=effort.number('bandwidth', above=0.0, high=1e6)
        if 'bandwidth' in effort
        else math.inf,
        uncertainty=uncertainty,
        covariance=_covariance(top, 15 * len(joints)),
        sample_time=top.number('sample_time', 0.002, 1e-5, 1.0),
        sensor_matrix=_sensor_matrix(top, len(joints)),
        lpv=_lpv(top, len(joints)),
    )
    for section in (effort, top):
        section.finish()
    for names, field in ((arm.joint_names, 'joints'), (arm.sensor_names, 'sensors')):
        if len(set(names)) < len(names):
            raise top.error(field, 'use a name twice')
    if joints[0].rotor_coupling != 0.0:
        raise top.error('joints[0].rotor_coupling', 'must be 0: there is no joint before')
    for i, joint in enumerate(joints):
        carried = np.array([one.link.to_vector() for one in joints[i:]])
        if joint.rotor_inertia == 0.0 and not carried.any():
            why = f'{joint.name} moves no mass; a URDF may lack <inertial>'
            raise top.error(f'joints[{i}].link', why)
    return arm


def _sensor_matrix(top: Section, n: int) -> tuple[tuple[float, ...], ...] | None:
    if 'sensor_matrix' not in top:
        return None
    rows = top.rows('sensor_matrix', n, n)
    if np.abs(rows).max() > FAR:
        raise top.error('sensor_matrix', f'must lie within +-{FAR:g}')
    if len(rows) != n or abs(np.linalg.det(np.array(rows))) < _SMALLEST_DETERMINANT:
        raise top.error('sensor_matrix', f'must have {n} rows and an inverse')
    return tuple(tuple(row) for row in rows)


def _lpv(top: Section, n: int) -> LpvRegion | None:
    if 'lpv' not in top:
        return None
    if n != 2:
        raise top.error('lpv', f'is for planar arms of two joints, this one has {n}')
    part = top.section('lpv')
    disturbance = part.section('disturbance', required=False)
    region = LpvRegion(
        part.text('orientation', choices=('upright', 'hanging')),
        part.pair('cos_min', low=0.01, high=0.999),
        disturbance.pair('direction', 0.0, -1e3, 1e3),
        disturbance.number('mean', 0.0, -1e4, 1e4),
        disturbance.number('variance', 0.0, 0.0, 1e8),
        part.number('velocity_error', 0.0, 0.0, 0.5),
    )
    for section in (disturbance, part):
        section.finish()
    return region


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
    text = yaml.dump(
        content,
        Dumper=_Dumper,
        sort_keys=False,
        width=110,
        default_flow_style=False,
        allow_unicode=True,
    )
    write_whole(path, _HEADER + text)


def to_mapping(arm: SerialArm) -> dict[str, Any]:
    """Content of the arm file of an arm, for `parse_arm`."""
    result: dict[str, Any] = {'name': arm.name}
    if arm.urdf:
        result['urdf'] = arm.urdf
    if arm.locked:
        result['locked'] = dict(arm.locked)
    result.update(
        {
            'base_orientation': list(arm.base_orientation),
            'gravity': arm.gravity,
            'tip': list(arm.tip),
            'sample_time': arm.sample_time,
            'effort': {'unit': arm.effort_unit, 'includes_gravity': arm.effort_includes_gravity},
            'uncertainty': _lists(_stated(asdict(arm.uncertainty))),
            'joints': [_joint_mapping(joint) for joint in arm.joints],
        }
    )
    if math.isfinite(arm.effort_bandwidth):
        result['effort']['bandwidth'] = arm.effort_bandwidth
    if arm.sensor_matrix is not None:
        result['sensor_matrix'] = _lists(arm.sensor_matrix)
    if arm.lpv is not None:
        region = _lists(asdict(arm.lpv))
        result['lpv'] = {
            'orientation': region['orientation'],
            'cos_min': region['cos_min'],
            'disturbance': {
                key: region[f'disturbance_{key}'] for key in ('direction', 'mean', 'variance')
            },
            'velocity_error': region['velocity_error'],
        }
    if arm.covariance is not None:
        result['covariance'] = {
            'determined': arm.covariance.determined,
            'factor': [list(row) for row in arm.covariance.factor],
        }
    return result


class _Dumper(yaml.SafeDumper):
    """Safe dumper that writes lists of numbers in one line."""

    def ignore_aliases(self, data: Any) -> bool:
        return True

    def represent_sequence(self, tag: str, sequence: Any, flow_style: bool | None = None) -> Any:
        plain = all(isinstance(value, (int, float, str)) for value in sequence)
        return super().represent_sequence(tag, sequence, flow_style=plain)


def _joint_mapping(joint: SerialJoint) -> dict[str, Any]:
    result = asdict(joint)
    result['link']['inertia'] = dict(zip(INERTIA_KEYS, joint.link.inertia))
    result['limits'] = {
        key: value for key, value in result['limits'].items() if math.isfinite(value)
    }
    if joint.rotor_coupling == 0.0:
        del result['rotor_coupling']
    if not joint.is_prismatic:
        del result['type']
    if joint.sensors.second_encoder is None:
        del result['sensors']['second_encoder']
    return _lists(result)


def _stated(values: dict[str, Any]) -> dict[str, Any]:
    """The values without those that are None."""
    return {key: value for key, value in values.items() if value is not None}


def _lists(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _lists(item) for key, item in value.items()}
    return [_lists(item) for item in value] if isinstance(value, (tuple, list)) else value


def _triple(
    section: Section,
    key: str,
    low: float = -math.inf,
    high: float = math.inf,
    default: tuple[float, float, float] | None = (0.0, 0.0, 0.0),
) -> tuple[float, float, float]:
    x, y, z = section.vector(key, 3, default, low, high)
    return x, y, z


def _per_joint(section: Section, key: str, count: int) -> tuple[float, ...] | None:
    return tuple(section.vector(key, count, low=0.0, high=1e9)) if key in section else None


def _locked(top: Section) -> tuple[tuple[str, float], ...]:
    held = top.plain('locked')
    section = top.section('locked', required=False)
    return tuple(sorted((str(name), section.number(name, None, -1e3, 1e3)) for name in held))


def _joints(
    top: Section, urdf: str, folder: Path, locked: dict[str, float]
) -> tuple[SerialJoint, ...]:
    sections = top.sections('joints', [] if urdf else None)
    if len(sections) > MAX_JOINTS or not (sections or urdf):
        raise top.error('joints', f'must describe 1 to {MAX_JOINTS} joints, or urdf be given')
    if all('position' in s and 'link' in s for s in sections) and sections:
        return tuple(_joint(section, None) for section in sections)
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
    return tuple(_joint(section, base) for section, base in zip(sections, chain.joints))


def _joint(section: Section, base: SerialJoint | None) -> SerialJoint:
    """A joint of the file; what it does not say comes from the URDF's joint ``base``."""
    name = section.text('name')
    # What places the frame comes from one source: a mix of both would fit neither.
    if base is None or any(key in section for key in ('position', 'orientation', 'axis')):
        position = _triple(section, 'position', -FAR, FAR, default=None)
        orientation = _triple(section, 'orientation', -FAR, FAR)
        axis = _axis(section)
    else:
        position, orientation, axis = base.position, base.orientation, base.axis
    link = _link(section) if base is None or 'link' in section else base.link
    limits = _limits(section, JointLimits() if base is None else base.limits)
    sensors = section.section('sensors', required=False)
    friction = read_entries(JointFriction, section.section('friction', required=False))
    if base is not None and 'friction' not in section:
        friction = base.friction
    joint = SerialJoint(
        name=name,
        position=position,
        orientation=orientation,
        axis=axis,
        link=link,
        friction=friction,
        rotor_inertia=section.number('rotor_inertia', 0.0, 0.0, 1e5),
        rotor_coupling=section.number('rotor_coupling', 0.0, -1e5, 1e5),
        torque_gain=section.number('torque_gain', 1.0, -1e6, 1e6),
        effort_delay=section.number('effort_delay', 0.0, -1.0, 1.0),
        limits=limits,
        torque_tolerance=_tolerance(section),
        sensors=read_entries(JointSensors, sensors, name=sensors.text('name', f'{name}_encoder')),
        type=section.text('type', 'revolute' if base is None else base.type, JOINT_TYPES),
    )
    if base is not None and joint.type != base.type:
        raise section.error('type', f'is {base.type} in the URDF')
    if not joint.friction.is_dissipative(limits.velocity):
        raise section.error(
            'friction',
            'drives the joint below its velocity limit: viscous is too negative for coulomb',
        )
    if joint.torque_gain == 0.0:
        raise section.error('torque_gain', 'must not be 0')
    section.finish()
    return joint


def _axis(section: Section) -> tuple[float, float, float]:
    x, y, z = axis = _triple(section, 'axis', -1e6, 1e6, default=(0.0, 0.0, 1.0))
    length = math.sqrt(x * x + y * y + z * z)
    if not 1e-6 < length < 1e6:
        raise section.error('axis', 'must not be 0')
    return axis if abs(length - 1.0) < 1e-12 else (x / length, y / length, z / length)


def _link(section: Section) -> LinkInertia:
    link = section.section('link')
    inertia = link.section('inertia')
    xx, xy, yy, xz, yz, zz = (inertia.number(key, None, -1e7, 1e7) for key in INERTIA_KEYS)
    result = LinkInertia(
        link.number('mass', low=0.0, high=1e5),
        _triple(link, 'first_moment', -1e6, 1e6, default=None),
        (xx, xy, yy, xz, yz, zz),
    )
    inertia.finish()
    link.finish()
    if min(xx, yy, zz) < 0.0:
        raise link.error('inertia', 'must not have a negative moment')
    return result


def _limits(section: Section, base: JointLimits) -> JointLimits:
    limits = section.section('limits', required=False)
    lower = limits.number('lower', None, -LARGEST, LARGEST) if 'lower' in limits else base.lower
    upper = limits.number('upper', high=LARGEST, above=lower) if 'upper' in limits else base.upper
    if not lower < upper:
        raise limits.error('lower', f'must be below {upper}, the upper limit, got {lower}')
    result = JointLimits(
        lower,
        upper,
        limits.number('velocity', base.velocity, above=0.0, high=1e4),
        limits.number('torque', base.torque, above=0.0, high=1e9),
    )
    limits.finish()
    return result


def _tolerance(section: Section) -> TorqueTolerance:
    if 'torque_tolerance' not in section:
        return TorqueTolerance()
    part = section.section('torque_tolerance')
    speed = part.numbers('speed', 64, 0.0, 1e4)
    if any(b <= a for a, b in zip(speed, speed[1:])):
        raise part.error('speed', 'must increase')
    result = TorqueTolerance(tuple(speed), tuple(part.vector('torque', len(speed), None, 0.0, 1e9)))
    part.finish()
    return result


def _covariance(top: Section, size: int) -> ParameterCovariance | None:
    if 'covariance' not in top:
        return None
    part = top.section('covariance')
    factor = tuple(tuple(row) for row in part.rows('factor', size, size))
    result = ParameterCovariance(factor, part.integer('determined', low=0))
    part.finish()
    return result


if __name__ == '__main__':
    save_arm(load_arm(sys.argv[1]), sys.argv[2])
