"""What a report was written with."""

import platform
from importlib.metadata import PackageNotFoundError, version

_PACKAGES = (
    ('lpv_cli', 'lpv-arm-fdi'),
    ('numpy', 'NumPy'),
    ('numba', 'Numba'),
    ('matplotlib', 'Matplotlib'),
    ('rosbags', 'rosbags'),
    ('mcap', 'mcap'),
)


def installed_versions() -> list[tuple[str, ...]]:
    """Versions of the software that reads, computes and draws."""
    found = [(title, _version(name)) for name, title in _PACKAGES]
    return [found[0], ('Python', platform.python_version()), *found[1:]]


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return 'not installed as a package'
