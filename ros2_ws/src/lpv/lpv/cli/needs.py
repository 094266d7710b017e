"""What a command needs that is not installed, and how it is installed."""

import importlib.util
import platform

from lpv.core.support.resources import installed_version

DISTRIBUTION = 'lpv-arm-fdi'
_EXTRAS = {
    'pyarrow': 'campaign',
    'distributed': 'campaign',
    'cmaes': 'campaign',
    'optuna': 'tune',
    'sqlalchemy': 'tune',
    'mujoco': 'mujoco',
    'pinocchio': 'identify',
}
_ROS = (
    'ROS 2 is needed and not installed here: run "make setup" in a checkout of lpv-arm-fdi, or '
    'build its packages with colcon in your ROS 2 workspace and source it'
)


def require_ros() -> None:
    """ModuleNotFoundError where there is no ROS 2, or no messages of this software."""
    for name in ('rclpy', 'lpv_msgs'):
        if importlib.util.find_spec(name) is None:
            raise ModuleNotFoundError(name=name)


def remedy(module: str | None) -> str:
    """One sentence for a module that cannot be imported."""
    name = (module or '').split('.')[0]
    if name in _EXTRAS:
        if not installed_version(DISTRIBUTION):
            return f'{name} is not installed: run "make setup-extras" in the checkout'
        return f"{name} is not installed: pip install '{DISTRIBUTION}[{_EXTRAS[name]}]'"
    if name == 'lpv_design':
        return f'{name}, which designs gains, is not installed: build its package, too'
    if name.endswith('_msgs') or name.startswith(('rcl', 'ros', 'lpv_')):
        return f'{name}: {_ROS}'
    return f'{name} is not installed: pip install {name}'


def version() -> str:
    """Version of this software and of what its figures depend on."""
    own = installed_version(DISTRIBUTION) or installed_version('lpv', '-')
    parts = [f'{name} {installed_version(name, "-")}' for name in ('numpy', 'numba')]
    return f'lpv {own} ({", ".join([f"Python {platform.python_version()}", *parts])})'
