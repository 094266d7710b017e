"""Markers of the arms, for RViz and Foxglove."""

from typing import Any

import numpy as np
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from lpv.core.control.path import SerialPath
from lpv.core.export.urdf import BASE
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


class Scene:
    """Draws the arms, and the path with its obstacle."""

    def __init__(self, arm: SerialArm, path: SerialPath | None = None) -> None:
        self._path, self._skeleton = path, Skeleton(arm)
        self._width = 0.025 * self._skeleton.reach

    def markers(self, arms: dict[str, Any], stamp: int, with_path: bool = False) -> MarkerArray:
        """The arms at joint positions [rad] as lines with dots on joints; stamp [ns]."""
        found = []
        for depth, (name, colour) in enumerate(ARMS.items()):
            if (q := arms.get(name)) is None:
                continue
            points = self._skeleton.corners(q)
            # Side by side, or they would hide each other where they agree.
            points[:, 1] += 0.3 * self._width * (1 - depth)
            for kind, width in ((Marker.LINE_STRIP, 1.0), (Marker.SPHERE_LIST, 1.6)):
                marker = _marker(name, kind, colour, stamp, width * self._width, points)
                marker.id, marker.lifetime.sec = int(kind == Marker.SPHERE_LIST), round(QUIET)
                found.append(marker)
        if with_path and self._path is not None:
            path, grey, red = self._path, (0.5, 0.5, 0.5, 0.8), (0.8, 0.2, 0.2, 0.5)
            tips = path.sample(np.linspace(path.start, path.end, 151)).tip
            found.append(_marker('path', Marker.LINE_STRIP, grey, stamp, 0.2 * self._width, tips))
            if (obstacle := path.obstacle) is not None:
                marker = _marker('obstacle', Marker.CYLINDER, red, stamp, 2.0 * obstacle.radius)
                marker.pose.position = _point(path.in_base(np.array(obstacle.center)))
                marker.pose.orientation.x = marker.pose.orientation.w = 0.5**0.5
                marker.scale.z = 2.0 * self._width
                found.append(marker)
        return MarkerArray(markers=found)


def _marker(
    name: str, kind: int, colour: tuple[float, ...], stamp: int, width: float, points: Any = ()
) -> Marker:
    marker = Marker(header=Header(frame_id=BASE), ns=name, type=kind)
    set_stamp(marker.header.stamp, stamp)
    marker.pose.orientation.w = 1.0
    marker.scale.x = marker.scale.y = marker.scale.z = width
    marker.color = ColorRGBA(**dict(zip('rgba', colour)))
    marker.points = [_point(point) for point in points]
    return marker


def _point(place: np.ndarray) -> Point:
    return Point(**dict(zip('xyz', place.tolist())))
