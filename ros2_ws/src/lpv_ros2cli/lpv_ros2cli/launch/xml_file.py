"""Launch files in XML."""

import xml.etree.ElementTree as ET
from pathlib import Path

from lpv_ros2cli.command_line.yaml_text import read_text
from lpv_ros2cli.errors import CliError
from lpv_ros2cli.launch.entity import Entity


class _Builder(ET.TreeBuilder):
    """Refuses document types: entities could expand without end, and launch files need none."""

    def doctype(self, *_: object) -> None:
        raise CliError('document types are not allowed in launch files')


def read_xml(path: Path) -> Entity:
    """Read a launch file."""
    parser = ET.XMLParser(target=_Builder())
    try:
        root = ET.fromstring(read_text(path, 'launch file'), parser)  # noqa: S314 - no entities
    except ET.ParseError as error:
        raise CliError(f'{path}: is not valid XML: {error}') from error
    if root.tag != 'launch':
        raise CliError(f'{path}: the root element must be <launch>, not <{root.tag}>')
    return _entity(root, str(path))


def _entity(element: ET.Element, source: str) -> Entity:
    text = ''.join([element.text or '', *(child.tail or '' for child in element)]).strip()
    if text:
        raise CliError(f'{source}: <{element.tag}>: text {text[:40]!r} is not expected')
    return Entity(
        element.tag, dict(element.attrib), [_entity(child, source) for child in element], source
    )
