"""Markers and transforms of the arms, for RViz and Foxglove, as serialised messages."""

from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from lpv.core.control.path import TimedPath
from lpv.core.export.urdf import BASE, Transform, transforms
from lpv.core.serial_arm.description import SerialArm
from lpv.core.support.limits import QUIET
from lpv.core.support.timestamps import set_stamp
from lpv_node.view.skeleton import Skeleton

ARMS = {
    'true': (0.13, 0.55, 0.30, 0.45),
    'estimated': (0.12, 0.40, 0.85, 1.0),
    'measured': (0.85, 0.40, 0.05, 0.9),
}
"""Colour of each arm: red, green, blue, alpha."""
MARKERS, TRANSFORMS = 'visualization_msgs/msg/MarkerArray', 'tf2_msgs/msg/TFMessage'
_LINE_STRIP, _SPHERE_LIST, _CYLINDER = 4, 7, 3
"""Types of visualization_msgs/Marker."""


class Scene:
    """Makes messages with the definitions of a typestore, whether ROS has them or not."""

    def __init__(self, arm: SerialArm, typestore: Typestore, path: TimedPath | None = None) -> None:
        self._arm, self._store, self._path = arm, typestore, path
        self._skeleton = Skeleton(arm)
        self._width = 0.025 * self._skeleton.reach

    def markers(self, arms: dict[str, Any], stamp: int, with_path: bool = False) -> bytes:
        """MarkerArray of the arms at joint positions [rad] as lines, dots on joints; stamp [ns]."""
        found = []
        for depth, (name, colour) in enumerate(ARMS.items()):
            if (q := arms.get(name)) is None:
                continue
            points = self._skeleton.corners(q)
            # Side by side, or they would hide each other where they agree.
            points[:, 1] += 0.3 * self._width * (1 - depth)
            for kind, width in ((_LINE_STRIP, 1.0), (_SPHERE_LIST, 1.6)):
                marker = self._marker(name, kind, colour, stamp, width * self._width, points)
                marker.id, marker.lifetime.sec = int(kind == _SPHERE_LIST), round(QUIET)
                found.append(marker)
        if with_path and self._path is not None:
            found += self._surroundings(self._path, stamp)
        return self._bytes(MARKERS, markers=found)

    def _surroundings(self, path: TimedPath, stamp: int) -> list[Any]:
        tips = path.sample(np.linspace(path.start, path.end, 151)).tip
        grey, red = (0.5, 0.5, 0.5, 0.8), (0.8, 0.2, 0.2, 0.5)
        result = [self._marker('path', _LINE_STRIP, grey, stamp, 0.2 * self._width, tips)]
        if (obstacle := path.obstacle) is not None:
            marker = self._marker('obstacle', _CYLINDER, red, stamp, 2.0 * obstacle.radius)
            position = marker.pose.position
            position.x, position.y, position.z = map(float, path.in_base(np.array(obstacle.center)))
            marker.pose.orientation.x = marker.pose.orientation.w = 0.5**0.5
            marker.scale.z = 2.0 * self._width
            result.append(marker)
        return result

    def _marker(
        self, name: str, kind: int, colour: Any, stamp: int, width: float, points: Any = ()
    ) -> Any:
        marker = self._new('visualization_msgs/msg/Marker', ns=name, type=kind)
        _set_header(marker.header, stamp, BASE)
        marker.pose.orientation.w = 1.0
        marker.scale.x = marker.scale.y = marker.scale.z = width
        marker.color.r, marker.color.g, marker.color.b, marker.color.a = colour
        point = self._store.types['geometry_msgs/msg/Point']
        marker.points = [point(*map(float, p)) for p in points]
        return marker

    def tree(self, arms: dict[str, Any], stamp: int) -> bytes:
        """TFMessage of the true and the estimated arm, whose names are prefixes of frames."""
        found = []
        for name in ('true', 'estimated'):
            if (q := arms.get(name)) is None or not np.isfinite(q).all():
                continue
            frames: list[Transform] = [(BASE, f'{name}/{BASE}', (0.0,) * 3, (0.0, 0.0, 0.0, 1.0))]
            frames += [
                (f'{name}/{a}', f'{name}/{b}', place, rotation)
                for a, b, place, rotation in transforms(self._arm, q)
            ]
            for parent, child, position, rotation in frames:
                one = self._new('geometry_msgs/msg/TransformStamped', child_frame_id=child)
                _set_header(one.header, stamp, parent)
                for axes, vector, values in (
                    ('xyz', one.transform.translation, position),
                    ('xyzw', one.transform.rotation, rotation),
                ):
                    for axis, value in zip(axes, values):
                        setattr(vector, axis, value)
                found.append(one)
        return self._bytes(TRANSFORMS, transforms=found)

    def text(self, content: str) -> bytes:
        """std_msgs/String in CDR."""
        return self._bytes('std_msgs/msg/String', data=content)

    def _bytes(self, msgtype: str, **fields: Any) -> bytes:
        return bytes(self._store.serialize_cdr(self._new(msgtype, **fields), msgtype))

    def _new(self, msgtype: str, **fields: Any) -> Any:
        """A message that is zero but for some fields."""
        for name, (kind, value) in self._store.fielddefs[msgtype][1]:
            if name not in fields:
                fields[name] = self._zero(kind, value)
        return self._store.types[msgtype](**fields)

    def _zero(self, kind: Nodetype, value: Any) -> Any:
        if kind == Nodetype.NAME:
            return self._new(value)
        if kind != Nodetype.BASE:  # a sequence: all of this file's arrays may be empty
            return np.zeros(0, np.uint8) if value[0][0] == Nodetype.BASE else []
        return {'string': '', 'bool': False}.get(value[0], 0)


def _set_header(header: Any, stamp: int, frame: str) -> None:
    set_stamp(header.stamp, stamp)
    header.frame_id = frame
