"""Where launch files are, and reading them whatever their form."""

from pathlib import Path

from lpv_ros2cli.errors import CliError
from lpv_ros2cli.launch.entity import Entity
from lpv_ros2cli.launch.xml_file import read_xml
from lpv_ros2cli.launch.yaml_file import read_yaml_launch
from lpv_ros2cli.packages import share_of

_READERS = {'.xml': read_xml, '.yaml': read_yaml_launch, '.yml': read_yaml_launch}


def launch_files_of(package: str) -> list[Path]:
    """Launch files of a package."""
    share = share_of(package)
    return sorted(
        path
        for pattern in ('*launch.xml', '*launch.yaml', '*launch.yml')
        for path in share.rglob(pattern)
    )


def find_launch_file(package: str, name: str) -> Path:
    """A launch file of a package."""
    share = share_of(package)
    found = sorted(path for path in share.rglob('*') if path.name == name and path.is_file())
    if not found:
        known = ', '.join(path.name for path in launch_files_of(package)) or 'none'
        raise CliError(
            f"file '{name}' was not found in the share directory of package "
            f"'{package}' which is at '{share}'; its launch files: {known}"
        )
    if len(found) > 1:
        raise CliError(
            f"file '{name}' was found more than once in package '{package}': "
            + ', '.join(map(str, found))
        )
    return found[0]


def read_launch_file(path: str | Path) -> Entity:
    """Read a launch file in XML or YAML."""
    path = Path(path)
    reader = _READERS.get(path.suffix)
    if reader is None:
        raise CliError(
            f'{path}: launch files in {path.suffix or "this form"} are not covered by '
            'this ros2; covered are XML and YAML'
        )
    return reader(path)
