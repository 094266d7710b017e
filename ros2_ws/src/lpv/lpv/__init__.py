"""Sensor-fault diagnosis of robot arms for Python scripts: no ROS is needed.

>>> import lpv
>>> arm = lpv.load_arm('paper')
>>> gains = lpv.design(arm)
>>> run = lpv.simulate(arm, gains, scenario='two_faults')
>>> run.alarms
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lpv.api import *  # noqa: F403


def __getattr__(name: str) -> Any:
    """The API; nodes and commands, which import parts, do not wait for all of it."""
    api = import_module('lpv.api') if name == '__all__' or not name.startswith('_') else None
    if api is None or name not in (*api.__all__, '__all__'):
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    return getattr(api, name)


def __dir__() -> list[str]:
    return [*globals(), *__getattr__('__all__')]
