"""One element of a launch file, the same for XML and YAML."""

from typing import overload

from lpv_ros2cli.errors import CliError

_TRUE, _FALSE = ('true', '1'), ('false', '0')


class LaunchFileError(CliError):
    """Something in a launch file is wrong; the message names file and element."""


class Entity:
    """An element with attributes, lists of elements, and children.

    Every attribute and every kind of nested element must be read: what was not read is a typing
    error, or something that this engine does not cover.
    """

    def __init__(
        self, tag: str, attributes: dict[str, object], nested: list['Entity'], source: str
    ) -> None:
        self.tag, self.source = tag, source
        self._attributes, self._nested = attributes, nested
        self._read: set[str] = set()

    def error(self, reason: str) -> LaunchFileError:
        """A LaunchFileError (to be raised by the caller) that names file and element."""
        name = self._attributes.get('name') or self._attributes.get('exec')
        where = f'<{self.tag}>' if name is None else f'<{self.tag} {name}>'
        return LaunchFileError(f'{self.source}: {where}: {reason}')

    def get(self, name: str, default: object = None) -> object:
        """An optional attribute as text, or as YAML gave it."""
        self._read.add(name)
        return self._attributes.get(name, default)

    @overload
    def text(self, name: str) -> str | None: ...

    @overload
    def text(self, name: str, default: str) -> str: ...

    def text(self, name: str, default: str | None = None) -> str | None:
        """An optional attribute as text."""
        value = self.get(name, default)
        if isinstance(value, bool):
            return str(value).lower()
        if isinstance(value, (dict, list)):
            raise self.error(f"attribute '{name}' must be a text")
        return value if value is None else str(value)

    def required(self, name: str) -> str:
        """An attribute that must be there, as text."""
        value = self.text(name)
        if value is None:
            raise self.error(f"attribute '{name}' is missing")
        return value

    def flag(self, name: str, default: bool) -> bool:
        """An optional attribute that is true or false."""
        return self.boolean(name, self.text(name, str(default)))

    def boolean(self, name: str, text: str) -> bool:
        """Truth of a text: true, false, 1 or 0."""
        lowered = text.strip().lower()
        if lowered not in (*_TRUE, *_FALSE):
            raise self.error(f"'{name}' must be true or false, got {text!r}")
        return lowered in _TRUE

    def all(self, tag: str) -> list['Entity']:
        """Nested elements of one kind."""
        self._read.add(tag)
        return [entity for entity in self._nested if entity.tag == tag]

    def children(self) -> list['Entity']:
        """All nested elements, as actions in their order."""
        self._read.update(entity.tag for entity in self._nested)
        return list(self._nested)

    def finish(self) -> None:
        """Refuse what was not read."""
        unknown = [
            name
            for name in (*self._attributes, *(e.tag for e in self._nested))
            if name not in self._read
        ]
        if unknown:
            raise self.error(f"'{unknown[0]}' is unknown here, or not covered by this ros2")
