"""Gains with a certificate: how those of any kind are read, written, verified and proved.

No solver is needed, and none is trusted: every inequality is rebuilt from the numbers of the gains
and of the arm alone.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from lpv.core.serial_arm.description import SerialArm
from lpv.core.support.config import Section, sha256_of, write_parameters
from lpv.core.support.entries import entry, plain_entries, read_entries
from lpv.core.support.errors import ConfigError, LpvError
from lpv.core.support.inequalities import Check, NumberType, is_negative, largest_eigenvalue

_Kind = TypeVar('_Kind', bound='CertifiedGains')
Inequalities = Iterator[tuple[str, list[Any]]]
"""Names, and matrices of floats or fractions that must be negative definite."""


def judged(claims: Inequalities) -> Iterator[Check]:
    """Checks of inequalities in floats, by their largest eigenvalue."""
    for name, matrices in claims:
        yield Check(name, largest_eigenvalue(*matrices))


@dataclass(frozen=True)
class CertifiedGains:
    """Gains that were designed for one arm, and the numbers that prove what they do."""

    arm_name: str = entry('text')
    arm_sha256: str = entry('text')  # hash of its parameters
    # of the numbers as they were written; '' for gains that were not read from a file
    checksum: str = field(default='', kw_only=True)
    format: ClassVar[int]  # of the file; others are not read
    section: ClassVar[str]  # where they stand in their file
    unused: ClassVar[tuple[str, ...]]  # entries of it that the checksum leaves out
    what: ClassVar[str]  # what is certified, for the reader

    def hash_of(self, arm: SerialArm) -> str:
        """Hash of the parameters of an arm that a design depends on."""
        return arm.sha256()

    def claims(self) -> list[list[str]]:
        """What holds where the certificate does: claims, each with its region and evidence."""
        table = Path(__file__).parent / f'claims_{self.section}.md'
        rows = table.read_text(encoding='utf-8').splitlines()[2:]
        return [row.strip('| ').split(' | ') for row in rows]

    def inequalities(self, arm: SerialArm, number: NumberType = float) -> Inequalities:
        """Matrix inequalities of the certificate, in floats or in exact fractions."""
        raise NotImplementedError

    def checks(self, arm: SerialArm) -> Iterator[Check]:
        """All that is claimed, inequalities included; what costs least comes first."""
        raise NotImplementedError

    def facts(self, arm: SerialArm) -> list[str]:
        """The region, and what is certified, for the reader."""
        raise NotImplementedError

    def fits(self, arm: SerialArm) -> bool:
        """Whether they were designed for an arm with exactly these parameters."""
        return self.arm_sha256 == self.hash_of(arm)

    def check_arm(self, arm: SerialArm, source: str = 'gains') -> None:
        """Refuse gains of another arm: ConfigError if the hash of its parameters differs."""
        if not self.fits(arm):
            raise ConfigError(
                f'{self.section}.arm_sha256',
                f'these gains were designed for another arm ({self.arm_name!r}, '
                f'{self.arm_sha256[:12]}) than the one in use ({arm.name!r}, '
                f'{self.hash_of(arm)[:12]}); run lpv design for it',
                source,
            )

    def verify(self, arm: SerialArm) -> list[Check]:
        """Rebuild every inequality that is claimed; ConfigError for another arm's gains."""
        return list(self._all_checks(arm))

    def require(self, arm: SerialArm, source: str = 'gains') -> None:
        """Refuse a certificate that does not hold: ConfigError names the inequality that fails."""
        for check in self._all_checks(arm):
            if not check.holds:
                reason = f'{check.name}, {check.margin:.3g} is not negative; design the gains again'
                raise ConfigError(self.section, f'the certificate does not hold: {reason}', source)

    def prove(self, arm: SerialArm) -> dict[str, bool]:
        """What exact rational arithmetic proves or refutes: rounding cannot hide a violation.

        Every number of an arm file and of a gains file is a float and therefore a fraction: what
        is proved is proved for the arm with exactly these numbers.
        """
        claims = self.inequalities(arm, Fraction)
        return {name: all(map(is_negative, matrices)) for name, matrices in claims}

    def _all_checks(self, arm: SerialArm) -> Iterator[Check]:
        self.check_arm(arm)
        if self.checksum:
            same = self.checksum == self.mapping()['checksum']
            yield Check('gains file: numbers are those of the design', -1.0 if same else 1.0)
        try:
            yield from self.checks(arm)
        except LpvError:
            raise
        except (ArithmeticError, ValueError) as error:
            yield Check(f'numbers of the gains can be computed with ({error})', math.nan)

    def mapping(self) -> dict[str, Any]:
        """What stands in their section of a file, with the checksum of the numbers as they are."""
        data = {'format': self.format, **plain_entries(replace(self, checksum=''))}
        data['checksum'] = sha256_of({k: v for k, v in data.items() if k not in self.unused})
        return data

    @classmethod
    def parse(cls: type[_Kind], data: dict[str, Any], source: str = 'gains') -> _Kind:
        """Gains from the mapping of their section, checked but not verified.

        ConfigError if anything is missing, unknown, of the wrong size, or not finite; ``source``
        names the file.
        """
        top = Section(data, source, cls.section)
        if top.integer('format') != cls.format:
            raise top.error('format', f'must be {cls.format}; design the gains again')
        return read_entries(cls, top, checksum=lambda: top.text('checksum'))

    def parameters(self) -> dict[str, Any]:
        """What they are below ``ros__parameters``."""
        return {self.section: self.mapping()}

    def save(self, path: str | Path, comment: str = '') -> None:
        """Write them as a ROS 2 parameter file (``/**: ros__parameters: ...``).

        ``comment`` is text for the head of the file; parent directories are made.
        """
        write_parameters(path, self.parameters(), comment)
