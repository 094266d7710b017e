"""Text of a URDF, checked before the parser sees it, which trusts what it reads.

The parser follows links and elements by recursion, takes ``nan`` for a number, and ends the process
where nesting exhausts the stack.
"""

import math
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree
from xml.parsers import expat

from lpv.core.support.config import MAX_BYTES, read_at_most
from lpv.core.support.errors import ConfigError
from lpv.core.support.limits import LARGEST, MAX_DEPTH, TURN

MAX_LINKS = 1000
"""Most links of a URDF, the depth that Python allows: the parser recurses once for each."""
_NUMBERS = ('xyz', 'rpy', 'value', 'ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz', 'damping', 'friction')
_LIMITS = ('lower', 'upper', 'effort', 'velocity')
_NOT_NEGATIVE = (('mass', 'value'), ('dynamics', 'damping'), ('dynamics', 'friction'))


class Mimic(NamedTuple):
    """A joint that follows another one: its position is multiplier * position + offset."""

    joint: str
    multiplier: float
    offset: float


class Urdf(NamedTuple):
    """What of a URDF describes the bodies and joints of a robot."""

    text: str  # without shapes, drives and controllers; continuous joints are revolute ones
    kinds: dict[str, str]  # type of each joint
    mimics: dict[str, Mimic]  # joints that follow others


class _Builder(ElementTree.TreeBuilder):
    """Builds elements; refuses what no URDF has before it costs memory."""

    def __init__(self) -> None:
        super().__init__()
        self._depth = 0

    def doctype(self, *_: object) -> None:
        """Called at a document type, where entities are declared."""
        raise ValueError('a document type is not allowed')

    def start(self, tag: str, attrs: dict[str, str]) -> ElementTree.Element:
        """Called at the begin of each element."""
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise ValueError(f'elements are nested more than {MAX_DEPTH} deep')
        if tag.startswith('xacro:'):  # which may stand for links
            raise ValueError(f'{tag[:100]}: expand it first, by xacro FILE > FILE.urdf')
        return super().start(tag, attrs)

    def end(self, tag: str) -> ElementTree.Element:
        """Called at the end of each element."""
        self._depth -= 1
        return super().end(tag)


def read_urdf_text(path: Path) -> Urdf:
    """Links and joints of a URDF, checked.

    Only children of ``robot`` are links and joints: ``transmission`` and ``ros2_control`` have
    elements of the same names.

    Raises
    ------
    ConfigError
        If the file is not XML, too large, not a tree of links, or holds numbers that are not
        finite.
    """
    root = _parse(path)
    for element in list(root):
        if element.tag not in ('link', 'joint'):
            root.remove(element)
    joints, links = root.findall('joint'), root.findall('link')
    mimics = {}
    for joint in joints:
        name = joint.get('name', '')
        if joint.get('type') == 'continuous':
            _make_revolute(joint)
        if joint.get('type') in ('revolute', 'prismatic') and joint.find('limit') is None:
            raise _error(path, f'joint {name!r} has no limit')
        for mimic in joint.findall('mimic'):
            mimics[name] = _mimic(mimic, name, path)
            joint.remove(mimic)
    if len(links) > MAX_LINKS:
        raise _error(path, f'has {len(links)} links, more than {MAX_LINKS}')
    for link in links:
        for part in ('visual', 'collision'):
            for element in link.findall(part):
                link.remove(element)
    _check_tree(joints, path)
    for element in (*links, *joints):
        _check_numbers(element, path)
    kinds = {joint.get('name', ''): joint.get('type', '') for joint in joints}
    return Urdf(ElementTree.tostring(root, encoding='unicode'), kinds, mimics)


def _mimic(element: ElementTree.Element, name: str, path: Path) -> Mimic:
    try:
        factor, offset = float(element.get('multiplier', 1.0)), float(element.get('offset', 0.0))
    except ValueError:
        factor = offset = math.nan
    if not max(abs(factor), abs(offset)) <= LARGEST:
        raise _error(path, f'joint {name[:100]!r}: multiplier and offset of mimic must be numbers')
    return Mimic(element.get('joint', ''), factor, offset)


def _parse(path: Path) -> ElementTree.Element:
    try:
        data = read_at_most(path, MAX_BYTES + 1)
    except OSError as error:
        raise _error(path, f'cannot be read ({error.strerror})') from error
    if len(data) > MAX_BYTES:
        raise _error(path, f'is larger than {MAX_BYTES} bytes')
    # Without namespaces, as parsers of URDFs read: simulators' prefixes are rarely declared.
    builder, parser = _Builder(), expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    parser.StartDoctypeDeclHandler = builder.doctype
    try:
        parser.Parse(data, True)
        root = builder.close()
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise _error(path, f'is not plain XML ({error})') from error
    if root.tag != 'robot':
        raise _error(path, f'must have the root element robot, has {root.tag[:100]!r}')
    return root


def _make_revolute(joint: ElementTree.Element) -> None:
    """Pinocchio gives a continuous joint two coordinates, cosine and sine."""
    joint.set('type', 'revolute')
    limit = joint.find('limit')
    if limit is None:
        limit = ElementTree.SubElement(joint, 'limit', effort='1e9', velocity='100')
    limit.set('lower', f'{-LARGEST}')
    limit.set('upper', f'{LARGEST}')


def _check_tree(joints: list[ElementTree.Element], path: Path) -> None:
    """Refuse links that have two parents or are their own ancestors."""
    parents: dict[str, str] = {}
    for joint in joints:
        parent, child = (_link_of(joint, end) for end in ('parent', 'child'))
        if child in parents:
            raise _error(path, f'link {child[:100]!r} is the child of two joints')
        parents[child] = parent
    try:
        TopologicalSorter({child: [parent] for child, parent in parents.items()}).prepare()
    except CycleError as error:
        raise _error(path, f'link {error.args[1][0][:100]!r} is in a loop of joints') from None


def _link_of(joint: ElementTree.Element, end: str) -> str:
    element = joint.find(end)
    return '' if element is None else element.get('link', '')


def _check_numbers(element: ElementTree.Element, path: Path) -> None:
    """Refuse numbers without bound, negative masses and friction; the parser what is no number."""
    name = f'{element.tag} {element.get("name", "")[:100]!r}'
    for part in element.iter():
        for key in (*_NUMBERS, *_LIMITS):
            for word in part.get(key, '').split():
                try:
                    value = abs(float(word))
                except ValueError:
                    continue
                if key in _LIMITS and value > LARGEST:
                    continue  # simulators' 1e16 stands for none
                most = TURN if key == 'rpy' else LARGEST
                if not value <= most:
                    raise _error(
                        path, f'{name}: {key} must be at most {most:g} in magnitude, got {word}'
                    )
        for tag, key in _NOT_NEGATIVE:
            if part.tag == tag and part.get(key, '').strip().startswith('-'):
                what = tag if key == 'value' else key
                raise _error(path, f'{name}: {what} must not be negative')


def _error(path: Path, reason: str) -> ConfigError:
    return ConfigError('urdf', reason, str(path))
