"""Markers and transforms of the arms, for RViz and Foxglove, as serialised messages."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from rosbags.typesys.store import Typestore

from lpv_core.control.path import CartesianPath
from lpv_core.export.urdf import BASE, transforms
from lpv_core.model.arm import ArmParameters
from lpv_core.serial_arm.any_arm import Arm
from lpv_core.support.timestamps import NANOSECONDS
from lpv_view.skeleton import Skeleton

Colour = tuple[float, float, float, float]
"""Red, green, blue, alpha."""

ARMS = {
    'true': (0.13, 0.55, 0.30, 0.45),
    'estimated': (0.12, 0.40, 0.85, 1.0),
    'measured': (0.85, 0.40, 0.05, 0.9),
}
"""Colour of each arm."""
MARKERS, TRANSFORMS = 'visualization_msgs/msg/MarkerArray', 'tf2_msgs/msg/TFMessage'
_LINE_STRIP, _SPHERE_LIST, _CYLINDER = 4, 7, 3
_LIFETIME = 500_000_000


class Scene:
    """Makes messages with the definitions of a typestore, whether ROS has them or not.

    Parameters
    ----------
    arm : ArmParameters or SerialArm
        The arm.
    typestore : rosbags.typesys.store.Typestore
        As of `lpv_bag.rosbag.interfaces.make_typestore`.
    path : CartesianPath, optional
        Path of the scenario, with its obstacle.
    """

    def __init__(self, arm: Arm, typestore: Typestore, path: CartesianPath | None = None) -> None:
        self._arm, self._store, self._types = arm, typestore, typestore.types
        self._path = path
        self._skeleton = Skeleton(arm)
        self._width = 0.025 * self._skeleton.reach

    def markers(self, arms: dict[str, Any], stamp: int, with_path: bool = False) -> bytes:
        """The arms as lines with dots on the joints.

        Parameters
        ----------
        arms : dict
            Joint positions [rad] by a name of `ARMS`; None for one that is not known.
        stamp : int
            [ns].
        with_path : bool, optional
            Also path and obstacle.

        Returns
        -------
        bytes
            visualization_msgs/MarkerArray in CDR.
        """
        found = []
        for depth, (name, colour) in enumerate(ARMS.items()):
            q = arms.get(name)
            if q is None:
                continue
            # Side by side, or they would hide each other where they agree.
            found_corners = self._skeleton.corners(q)
            corners = np.zeros((len(found_corners), 3))
            corners[:, [0, 2] if found_corners.shape[1] == 2 else [0, 1, 2]] = found_corners
            corners[:, 1] += 0.3 * self._width * (1 - depth)
            found.append(self._marker((name, 0), _LINE_STRIP, colour, self._width, stamp, corners))
            found.append(
                self._marker((name, 1), _SPHERE_LIST, colour, 1.6 * self._width, stamp, corners)
            )
        if with_path and self._path is not None:
            found += self._surroundings(self._path, stamp)
        return self._bytes(MARKERS, self._types[MARKERS](found))

    def _surroundings(self, path: CartesianPath, stamp: int) -> list[Any]:
        tips = path.sample(np.linspace(path.start, path.end, 151)).tip
        line = np.zeros((len(tips), 3))
        line[:, [0, 2]] = tips
        result = [
            self._marker(
                ('path', 0),
                _LINE_STRIP,
                (0.5, 0.5, 0.5, 0.8),
                0.2 * self._width,
                stamp,
                line,
                lifetime=0,
            )
        ]
        obstacle = path.obstacle
        if obstacle is not None:
            marker = self._marker(
                ('obstacle', 0), _CYLINDER, (0.8, 0.2, 0.2, 0.5), 1.0, stamp, (), lifetime=0
            )
            marker.pose.position.x, marker.pose.position.z = map(float, obstacle.center)
            marker.pose.orientation.x = marker.pose.orientation.w = 0.5**0.5
            marker.scale.x = marker.scale.y = 2.0 * obstacle.radius
            marker.scale.z = 2.0 * self._width
            result.append(marker)
        return result

    def tree(self, arms: dict[str, Any], stamp: int) -> bytes:
        """Transforms of the true and the estimated arm, with the frame prefixes of their names.

        The bytes are a tf2_msgs/TFMessage in CDR; without transforms for a serial arm, whose links
        only a robot state publisher with its URDF knows.
        """
        found: list[Any] = []
        for name in ('true', 'estimated'):
            q = arms.get(name)
            if q is None or not isinstance(self._arm, ArmParameters):
                continue
            found.append(
                self._transform(stamp, BASE, f'{name}/{BASE}', (0.0,) * 3, (0.0, 0.0, 0.0, 1.0))
            )
            found += [
                self._transform(stamp, f'{name}/{parent}', f'{name}/{child}', *rest)
                for parent, child, *rest in transforms(self._arm, q)
            ]
        return self._bytes(TRANSFORMS, self._types[TRANSFORMS](found))

    def text(self, content: str) -> bytes:
        """std_msgs/String in CDR."""
        return self._bytes('std_msgs/msg/String', self._types['std_msgs/msg/String'](content))

    def _bytes(self, msgtype: str, message: Any) -> bytes:
        return bytes(self._store.serialize_cdr(message, msgtype))

    def _marker(
        self,
        identity: tuple[str, int],
        kind: int,
        colour: Colour,
        width: float,
        stamp: int,
        corners: Iterable[Sequence[float]],
        lifetime: int = _LIFETIME,
    ) -> Any:
        new = self._new
        point = self._types['geometry_msgs/msg/Point']
        return self._types['visualization_msgs/msg/Marker'](
            header=self._header(stamp, BASE),
            ns=identity[0],
            id=identity[1],
            type=kind,
            action=0,
            pose=self._pose(),
            scale=new('geometry_msgs/msg/Vector3', x=width, y=width, z=width),
            color=new('std_msgs/msg/ColorRGBA', **dict(zip('rgba', colour))),
            lifetime=new('builtin_interfaces/msg/Duration', sec=0, nanosec=lifetime),
            frame_locked=False,
            points=[point(*map(float, c)) for c in corners],
            colors=[],
            texture_resource='',
            text='',
            mesh_resource='',
            mesh_use_embedded_materials=False,
            texture=new(
                'sensor_msgs/msg/CompressedImage',
                header=self._header(0, ''),
                format='',
                data=np.zeros(0, np.uint8),
            ),
            uv_coordinates=[],
            mesh_file=new(
                'visualization_msgs/msg/MeshFile', filename='', data=np.zeros(0, np.uint8)
            ),
        )

    def _pose(self) -> Any:
        return self._new(
            'geometry_msgs/msg/Pose',
            position=self._new('geometry_msgs/msg/Point', x=0.0, y=0.0, z=0.0),
            orientation=self._new('geometry_msgs/msg/Quaternion', x=0.0, y=0.0, z=0.0, w=1.0),
        )

    def _transform(
        self,
        stamp: int,
        parent: str,
        child: str,
        translation: Sequence[float],
        quaternion: Sequence[float],
    ) -> Any:
        new = self._new
        moved = new(
            'geometry_msgs/msg/Transform',
            translation=new('geometry_msgs/msg/Vector3', **dict(zip('xyz', translation))),
            rotation=new('geometry_msgs/msg/Quaternion', **dict(zip('xyzw', quaternion))),
        )
        return new(
            'geometry_msgs/msg/TransformStamped',
            header=self._header(stamp, parent),
            child_frame_id=child,
            transform=moved,
        )

    def _header(self, stamp: int, frame: str) -> Any:
        time = self._types['builtin_interfaces/msg/Time'](*divmod(stamp, NANOSECONDS))
        return self._types['std_msgs/msg/Header'](time, frame)

    def _new(self, name: str, **fields: Any) -> Any:
        return self._types[name](**fields)
