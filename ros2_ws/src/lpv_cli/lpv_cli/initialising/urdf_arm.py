"""What a URDF says of a planar arm with two revolute joints."""

import math
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from lpv_core.support.errors import ConfigError

_MOST_BYTES = 4 << 20
_PARALLEL = 1e-3


@dataclass(frozen=True)
class UrdfLink:
    """One moving link and the joint that carries it."""

    joint: str  # name
    mass: float  # [kg]
    length: float  # from this joint to the next one, or to the tip [m]
    center_of_mass: float  # distance from the joint along the link [m]
    inertia: float  # about the centre of mass, across the plane of motion [kg m2]
    viscous: float = 0.0  # [N m s/rad]
    coulomb: float = 0.0  # [N m]
    torque_limit: float = 100.0  # [N m]
    velocity_limit: float = 10.0  # [rad/s]


@dataclass(frozen=True)
class UrdfArm:
    """A planar arm with two links."""

    name: str
    links: tuple[UrdfLink, UrdfLink]
    zero_angle: float  # of link 1 from the upper vertical where joint 1 is zero [rad]

    def values(self, name: str, origin: str) -> dict[str, str]:
        """Values for the template of an arm file."""
        found = {'name': name, 'origin': origin, 'zero_angle': f'{self.zero_angle:.9g}'}
        for number, link in enumerate(self.links, start=1):
            found[f'joint_{number}'] = link.joint
            for key, value in (
                ('mass', link.mass),
                ('length', link.length),
                ('center', link.center_of_mass),
                ('inertia', link.inertia),
                ('viscous', link.viscous),
                ('coulomb', link.coulomb),
                ('torque', link.torque_limit),
            ):
                found[f'{key}_{number}'] = f'{value:.9g}'
        found['velocity_limit'] = f'{min(link.velocity_limit for link in self.links):.9g}'
        return found


EXAMPLE = UrdfArm(
    'my_arm',
    (
        UrdfLink('joint1', 10.0, 1.0, 0.5, 0.83, 0.1, 0.2, 1500.0, 20.0),
        UrdfLink('joint2', 5.0, 1.0, 0.5, 0.41, 0.1, 0.2, 600.0, 20.0),
    ),
    -math.pi / 2,
)


def read_urdf_arm(path: str | Path) -> UrdfArm:
    """Read the arm of a URDF.

    Raises
    ------
    ConfigError
        If the file is no URDF of two parallel, horizontal revolute joints, stretched where joint 2
        is zero.
    """
    root = _parse(Path(path))
    source = str(path)
    joints = _revolute(root)
    if len(joints) != 2:
        raise ConfigError('joint', f'must be two revolute joints, there are {len(joints)}', source)
    if _end(joints[0], 'parent', source) == _end(joints[1], 'child', source):
        joints.reverse()
    pose = np.eye(4)
    for joint in _chain(root, _end(joints[0], 'parent', source), source):
        pose = pose @ _origin(joint)
    one = pose @ _origin(joints[0])
    two = one @ _origin(joints[1])
    if _end(joints[1], 'parent', source) != _end(joints[0], 'child', source):
        raise ConfigError('joint', 'one must carry the other, without a link between', source)
    axes = [place[:3, :3] @ _axis(joint, source) for place, joint in zip((one, two), joints)]
    if np.abs(axes[0] - axes[1]).max() > _PARALLEL or abs(axes[0][2]) > _PARALLEL:
        raise ConfigError('axis', 'of both joints must be the same, and horizontal', source)
    tip = two @ _tip(root, joints[1], source)
    along = [two[:3, 3] - one[:3, 3], tip[:3, 3] - two[:3, 3]]
    angles = [_angle(step, axes[0]) for step in along]
    if abs(math.remainder(angles[1] - angles[0], 2.0 * math.pi)) > 0.01:
        raise ConfigError('origin', 'the arm must be stretched where joint 2 is zero', source)
    links = tuple(
        _link(root, joint, step, place, axes[0], source)
        for joint, step, place in zip(joints, along, (one, two))
    )
    return UrdfArm(root.get('name') or 'my_arm', (links[0], links[1]), angles[0])


def count_joints(path: str | Path) -> int:
    """Number of joints of a URDF that turn; ConfigError if it cannot be read."""
    return len(_revolute(_parse(Path(path))))


def _revolute(root: ElementTree.Element) -> list[ElementTree.Element]:
    return [j for j in root.findall('joint') if j.get('type') in ('revolute', 'continuous')]


def _parse(path: Path) -> ElementTree.Element:
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise ConfigError('--urdf', 'is larger than 4 MiB', str(path))
        text = path.read_text(encoding='utf-8')
        if '<!DOCTYPE' in text or '<!ENTITY' in text:
            raise ConfigError('--urdf', 'must not declare entities', str(path))
        return ElementTree.fromstring(text)
    except (OSError, UnicodeDecodeError, ElementTree.ParseError) as error:
        raise ConfigError('--urdf', f'cannot be read ({error})', str(path)) from error


def _chain(root: ElementTree.Element, link: str, source: str) -> list[ElementTree.Element]:
    """Fixed joints from the root of the tree to a link."""
    above = {
        _end(j, 'child', source): j for j in root.findall('joint') if j.find('child') is not None
    }
    chain: list[ElementTree.Element] = []
    while link in above and len(chain) < len(above):
        chain.insert(0, above[link])
        link = _end(above[link], 'parent', source)
    return chain


def _tip(root: ElementTree.Element, joint: ElementTree.Element, source: str) -> np.ndarray:
    """From joint 2 to the farthest frame that is fixed to link 2, or twice its centre of mass."""
    link = _end(joint, 'child', source)
    fixed = [
        _origin(j)
        for j in root.findall('joint')
        if j.get('type') == 'fixed' and _end(j, 'parent', source) == link
    ]
    if fixed:
        return max(fixed, key=lambda place: float(np.linalg.norm(place[:3, 3])))
    place = np.eye(4)
    place[:3, 3] = 2.0 * _inertial(root, link, source)[1][:3, 3]
    return place


def _link(
    root: ElementTree.Element,
    joint: ElementTree.Element,
    step: np.ndarray,
    place: np.ndarray,
    axis: np.ndarray,
    source: str,
) -> UrdfLink:
    mass, center, inertia = _inertial(root, _end(joint, 'child', source), source)
    length = float(np.linalg.norm(step))
    if not length > 0.0:
        raise ConfigError('origin', f'{joint.get("name")}: its link has no length', source)
    across = place[:3, :3] @ center[:3, :3]
    limit, dynamics = joint.find('limit'), joint.find('dynamics')
    return UrdfLink(
        joint.get('name') or 'joint',
        mass,
        length,
        float(place[:3, :3] @ center[:3, 3] @ step) / length,
        float(axis @ across @ inertia @ across.T @ axis),
        _number(dynamics, 'damping', 0.0, source),
        _number(dynamics, 'friction', 0.0, source),
        _number(limit, 'effort', 100.0, source) or 100.0,
        _number(limit, 'velocity', 10.0, source) or 10.0,
    )


def _inertial(
    root: ElementTree.Element, name: str, source: str
) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, pose of the centre of mass in the link's frame, inertia matrix about it."""
    element = root.find(f'./link[@name="{name}"]/inertial')
    if element is None:
        raise ConfigError('inertial', f'of link {name!r} is missing', source)
    i = {
        key: _number(element.find('inertia'), key, 0.0, source)
        for key in ('ixx', 'iyy', 'izz', 'ixy', 'ixz', 'iyz')
    }
    matrix = np.array(
        [
            [i['ixx'], i['ixy'], i['ixz']],
            [i['ixy'], i['iyy'], i['iyz']],
            [i['ixz'], i['iyz'], i['izz']],
        ]
    )
    return _number(element.find('mass'), 'value', 0.0, source), _origin(element), matrix


def _end(joint: ElementTree.Element, side: str, source: str) -> str:
    element = joint.find(side)
    if element is None or not element.get('link'):
        raise ConfigError(f'joint.{side}', f'of {joint.get("name")!r} is missing', source)
    return str(element.get('link'))


def _axis(joint: ElementTree.Element, source: str) -> np.ndarray:
    element = joint.find('axis')
    axis = _vector('1 0 0' if element is None else element.get('xyz', '1 0 0'), source)
    size = float(np.linalg.norm(axis))
    if not size > 0.0:
        raise ConfigError('axis', f'of {joint.get("name")!r} has no direction', source)
    return axis / size


def _origin(element: ElementTree.Element) -> np.ndarray:
    """Transform of an element's origin."""
    place, origin = np.eye(4), element.find('origin')
    if origin is None:
        return place
    roll, pitch, yaw = _vector(origin.get('rpy', '0 0 0'), 'origin')
    place[:3, 3] = _vector(origin.get('xyz', '0 0 0'), 'origin')
    place[:3, :3] = _about(2, yaw) @ _about(1, pitch) @ _about(0, roll)
    return place


def _about(axis: int, angle: float) -> np.ndarray:
    rotation = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    rotation[i, i] = rotation[j, j] = math.cos(angle)
    rotation[j, i], rotation[i, j] = math.sin(angle), -math.sin(angle)
    return rotation


def _angle(step: np.ndarray, axis: np.ndarray) -> float:
    """Angle of a link from the upper vertical, in the sense of the joint's rotation."""
    up = np.array([0.0, 0.0, 1.0])
    return math.atan2(float(axis @ np.cross(up, step)), float(up @ step))


def _vector(text: str, source: str) -> np.ndarray:
    try:
        vector = np.array([float(part) for part in text.split()])
    except ValueError as error:
        raise ConfigError('--urdf', f'{text!r} are not three numbers', source) from error
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ConfigError('--urdf', f'{text!r} are not three numbers', source)
    return vector


def _number(element: ElementTree.Element | None, key: str, default: float, source: str) -> float:
    text = None if element is None else element.get(key)
    try:
        value = default if text is None else float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or value < 0.0 and key not in ('ixy', 'ixz', 'iyz'):
        raise ConfigError(key, f'must be a number from 0, got {text!r}', source)
    return value
