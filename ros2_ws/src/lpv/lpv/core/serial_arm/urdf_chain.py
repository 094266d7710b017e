"""From a URDF to the description of a serial arm; Pinocchio reads the URDF."""

import contextlib
import math
import os
import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from lpv.core.serial_arm.chain import MAX_JOINTS
from lpv.core.serial_arm.description import (
    JointFriction,
    JointLimits,
    JointSensors,
    LinkInertia,
    SerialArm,
    SerialJoint,
)
from lpv.core.serial_arm.urdf_text import Urdf, read_urdf_text
from lpv.core.support.errors import ConfigError
from lpv.core.support.limits import LARGEST

if TYPE_CHECKING:
    import pinocchio

_CHOOSE = (
    'lock what is not of the arm, name the joints of the arm, or name the link at its tip '
    '(--lock, --joints, --tip)'
)
"""What to do about a URDF that holds more than an arm."""
_LONGEST = 100.0
"""No arm reaches farther; that of the space station reaches 17 m, desktop arms in mm 300 [m]."""


def read_urdf_chain(
    path: str | Path,
    locked: Mapping[str, float] | None = None,
    joints: Sequence[str] | None = None,
    tip: str | None = None,
) -> SerialArm:
    """Kinematics, inertias, friction and limits of an arm from its URDF.

    Fixed joints are merged into the links before them, and so are locked ones.

    Parameters
    ----------
    path : str or pathlib.Path
        URDF file (xacro must be expanded).
    locked : mapping of str to float, optional
        Joints that are held, and their angles [rad] (or positions [m]).
    joints : sequence of str, optional
        The joints of the arm; all others are locked at 0 if they are not in ``locked``.
    tip : str, optional
        Link at the arm's end, of several branches; joints that do not lead to it are locked at 0
        if they are not in ``locked``. Without it, the first of `read_urdf_ends`.

    Returns
    -------
    SerialArm
        Sensors are named after the joints.  The name is the URDF's, followed by that of the tip
        where the URDF holds another arm of as many joints or more.

    Raises
    ------
    ConfigError
        If the file cannot be read, or the joints that move are no chain of revolute and prismatic
        ones.
    """
    return read_urdf_ends(path, locked, joints, tip)[0]


def read_urdf_ends(
    path: str | Path,
    locked: Mapping[str, float] | None = None,
    joints: Sequence[str] | None = None,
    tip: str | None = None,
) -> tuple[SerialArm, tuple[str, ...]]:
    """The arm of a URDF as of `read_urdf_chain`, and the links where it may end.

    These are behind its last joint, with no link behind them.  The tip is the first; without
    ``tip`` that with fewest locked joints before it, of several that with most links before it.
    """
    urdf = read_urdf_text(Path(path))
    model, name, held, ends, place = _read_model(urdf, str(path), locked, joints, tip)
    if model.njoints == 1:
        raise ConfigError('urdf', 'has no joint that moves', str(path))
    if model.njoints - 1 > MAX_JOINTS:
        count = f'has {model.njoints - 1} joints that move, more than {MAX_JOINTS}'
        raise ConfigError('urdf', f'{count}; {_CHOOSE}', str(path))
    described = tuple(_joint(model, i, urdf, str(path)) for i in range(1, model.njoints))
    arm = SerialArm(
        name=name, joints=described, tip=place, urdf=str(path), locked=tuple(sorted(held.items()))
    )
    if (reach := _reach(arm)) > _LONGEST:
        raise ConfigError(
            'urdf',
            f'has an arm that reaches {reach:.4g} m: lengths, also to centres of mass, must be in '
            'metres; are these millimetres?',
            str(path),
        )
    return arm, ends


def _reach(arm: SerialArm) -> float:
    """Lengths of the links, each to the next joint or its centre of mass, in a row [m]."""
    ends = np.array([*(joint.position for joint in arm.joints[1:]), arm.tip])
    ways = np.array([ends, [joint.link.center() for joint in arm.joints]])
    return float(np.linalg.norm(ways, axis=2).max(axis=0).sum())


def _read_model(
    urdf: Urdf,
    source: str,
    locked: Mapping[str, float] | None,
    joints: Sequence[str] | None,
    tip: str | None,
) -> 'tuple[pinocchio.Model, str, dict[str, float], tuple[str, ...], tuple[float, float, float]]':
    """Pinocchio's model of the joints that move, name, angles of the others, ends, tip's place."""
    import pinocchio

    held = dict(locked or {})
    reason = ''
    with _quiet() as sink:
        try:
            model = pinocchio.buildModelFromXML(urdf.text)
        except (ValueError, RuntimeError, IndexError) as error:
            reason = str(error)
        sink.seek(0)
        said = re.findall('^Error:(.*)', sink.read().decode(errors='replace'), re.MULTILINE)
    # An <inertial> that it cannot read is one of mass 0 to the parser.
    if said or reason:
        reason = ' '.join(';'.join(said or [reason]).split())[:300]
        raise ConfigError('urdf', f'is not a model ({reason})', source)
    names = list(model.names)[1:]
    for name in (*held, *(joints or ())):
        if name not in names:
            raise ConfigError(
                'urdf',
                f'has no moving joint {name!r}; it has ' + (', '.join(names) or 'none'),
                source,
            )
    moving = set(names if joints is None else joints)
    if tip is not None:
        if not model.existFrame(tip, pinocchio.FrameType.BODY):
            links = ', '.join(f.name for f in model.frames if f.type == pinocchio.FrameType.BODY)
            raise ConfigError('tip', f'the URDF has no link {tip!r}; it has {links}', source)
        end = model.frames[model.getFrameId(tip, pinocchio.FrameType.BODY)].parentJoint
        moving &= {model.names[i] for i in model.supports[end]}
    held |= {name: 0.0 for name in names if name not in {*moving, *held, *urdf.mimics}}
    # A joint that follows a held one is where that one puts it, others that follow are refused.
    for _ in urdf.mimics:
        for name, mimic in urdf.mimics.items():
            if name in names and name not in held and mimic.joint in held:
                held[name] = mimic.multiplier * held[mimic.joint] + mimic.offset
    reference = pinocchio.neutral(model)
    for name, angle in held.items():
        joint = model.joints[model.getJointId(name)]
        if joint.nq == 1:
            reference[joint.idx_q] = angle
            _check_held(name, urdf.kinds[name], model, joint.idx_q, angle)
        elif angle != 0.0:
            raise ConfigError('locked', f'{urdf.kinds[name]} joint {name!r} must be at 0')
    last, ends = _ends(model, held)
    if tip is not None:
        ends = (tip, *(end for end in ends if end != tip))
    name = model.name or 'arm'
    if ends and _is_one_of_several(model, last, held):
        name = f'{name}_{ends[0]}'
    place = pinocchio.SE3.Identity()
    if ends:
        data = model.createData()
        end = model.frames[model.getFrameId(ends[0], pinocchio.FrameType.BODY)]
        pinocchio.forwardKinematics(model, data, reference)
        place, joint = end.placement, end.parentJoint
        while joint not in (0, last):  # 0 where the arm is refused below
            place, joint = data.liMi[joint] * place, model.parents[joint]
    if held:
        # Pinocchio looks parents up by name alone, and joints may be called as links are, or by
        # numbers: no name of a URDF, which is XML, holds this character.
        for number, frame in enumerate(model.frames):
            if frame.type != pinocchio.FrameType.JOINT:
                frame.name = f'\x01{number}'
        model = pinocchio.buildReducedModel(
            model, [model.getJointId(name) for name in held], reference
        )
    return model, name, held, ends, _triple(place.translation)


def _check_held(name: str, kind: str, model: 'pinocchio.Model', index: int, angle: float) -> None:
    """ConfigError for a joint that is held at degrees or millimetres."""
    ends = _endless(model.lowerPositionLimit[index]), _endless(model.upperPositionLimit[index])
    kind = 'prismatic' if kind == 'prismatic' else 'revolute'
    nowhere, body = (0.0, 0.0, 0.0), LinkInertia.from_vector(np.zeros(10))
    limits = JointLimits(*ends)
    one = SerialJoint(name, nowhere, nowhere, nowhere, body, limits=limits, type=kind)
    if abs(angle) > one.farthest:
        unit = 'millimetres' if one.is_prismatic else 'degrees'
        raise ConfigError(
            'locked',
            f'joint {name!r} is held at {angle:g} {one.units[0]}, beyond its limits: {unit}?',
        )


def _is_one_of_several(model: 'pinocchio.Model', last: int, held: Mapping[str, float]) -> bool:
    """Whether joints that are held are another arm: as many in a row, beside two or more."""
    # Fewer are a head, wheels or a finger; grippers are behind the arm, lifts before it.
    arm = {*model.supports[last]}
    others = ({*model.supports[model.getJointId(name)]} for name in held)
    return any(
        2 <= sum(model.names[i] not in held for i in arm - way) <= len(way - arm) for way in others
    )


def _ends(model: 'pinocchio.Model', held: Mapping[str, float]) -> tuple[int, tuple[str, ...]]:
    """The last joint that moves, and the links that no other is behind, as of `read_urdf_ends`."""
    import pinocchio

    ways, inner = dict[str, tuple[int, int, int]](), set[str]()
    for frame in model.frames:
        links, locks, at = 0, 0, frame
        while at.parentFrame and (at.type != pinocchio.FrameType.JOINT or at.name in held):
            links += at.type == pinocchio.FrameType.BODY
            locks += at.type == pinocchio.FrameType.JOINT
            at = model.frames[at.parentFrame]
            if at.type == pinocchio.FrameType.BODY:
                inner.add(at.name)
        if frame.type == pinocchio.FrameType.BODY and at.type == pinocchio.FrameType.JOINT:
            ways[frame.name] = at.parentJoint, locks, -links
    last = max((joint for joint, *_ in ways.values()), default=0)
    ends = [name for name, (joint, *_) in ways.items() if joint == last and name not in inner]
    return last, tuple(sorted(ends, key=ways.__getitem__))


@contextlib.contextmanager
def _quiet() -> Iterator[IO[bytes]]:
    """File of the URDF parser's complaints, which it writes to the process's standard error."""
    with tempfile.TemporaryFile() as sink:
        kept = os.dup(2)
        os.dup2(sink.fileno(), 2)
        try:
            yield sink
        finally:
            os.dup2(kept, 2)
            os.close(kept)


def _joint(model: 'pinocchio.Model', index: int, urdf: Urdf, source: str) -> SerialJoint:
    import pinocchio

    name, refused = model.names[index], ''
    if name in urdf.mimics:
        leader = urdf.mimics[name].joint
        refused = f'follows {leader!r} (mimic), with which it can be held (--lock {leader})'
    elif urdf.kinds[name] not in ('revolute', 'continuous', 'prismatic'):
        refused = f'is {urdf.kinds[name]}, neither revolute nor prismatic'
    elif model.parents[index] != index - 1:
        parents = list(model.parents)
        others = list(zip(model.names, parents))[1:]  # the first is the world
        beside = [n for n, p in others if p == parents[index] and n != name]
        before = repr(model.names[parents[index]]) if parents[index] else 'the base'
        refused = f'branches off {before} beside {", ".join(beside)}: '
        refused += 'the arm is not a chain'
    elif not model.lowerPositionLimit[index - 1] < model.upperPositionLimit[index - 1]:
        refused = 'has no lower limit below an upper one (continuous joints have none)'
    if refused:
        raise ConfigError('urdf', f'joint {name!r} {refused}; {_CHOOSE}', source)
    placement = model.jointPlacements[index]
    inertia = model.inertias[index].toDynamicParameters()
    limits = JointLimits(
        _endless(model.lowerPositionLimit[index - 1]),
        _endless(model.upperPositionLimit[index - 1]),
        # What no drive reaches stands for none.
        _within(model.velocityLimit[index - 1], 1e4, 100.0),
        _within(model.upperEffortLimit[index - 1], LARGEST, LARGEST),
    )
    data = model.createData()
    pinocchio.computeJointJacobians(model, data, np.zeros(model.nq))
    jacobian = pinocchio.getJointJacobian(model, data, index, pinocchio.LOCAL)
    kind = 'prismatic' if urdf.kinds[name] == 'prismatic' else 'revolute'
    rows = slice(0, 3) if kind == 'prismatic' else slice(3, 6)
    axis = np.round(np.reshape(jacobian, (6, -1))[rows, index - 1], 12)  # turns leave 1e-16
    if not abs(np.linalg.norm(axis) - 1.0) < 1e-6:
        raise ConfigError('urdf', f'joint {name!r} has an axis without a direction', source)
    return SerialJoint(
        name=name,
        position=_triple(placement.translation),
        orientation=_triple(pinocchio.rpy.matrixToRpy(placement.rotation)),
        axis=_triple(axis),
        link=LinkInertia.from_vector(inertia),
        friction=JointFriction(
            viscous=float(model.damping[index - 1]), coulomb=float(model.friction[index - 1])
        ),
        limits=limits,
        sensors=JointSensors(f'{name}_encoder'),
        type=kind,
    )


def _endless(value: float) -> float:
    return float(value) if abs(value) < LARGEST else math.copysign(math.inf, value)


def _within(value: Any, highest: float, default: float) -> float:
    return float(value) if 0.0 < value <= highest else default


def _triple(values: Any) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z
