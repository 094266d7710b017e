"""Parameter file of a serial arm's tracker: bandwidth, and the certificate of the loop."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from lpv.core.serial_arm.certificate.model_bounds import ModelBounds
from lpv.core.serial_arm.chain import FloatArray
from lpv.core.support.config import Section, read_yaml, sha256_of, write_parameters
from lpv.core.support.entries import array, entry, part, plain_entries, positive, read_entries
from lpv.core.support.errors import ConfigError

FORMAT = 1
"""Of the file; others are not read."""


@dataclass(frozen=True)
class DesignedForArm:
    """Gains of one arm; ``section`` is where they stand in their file."""

    arm_name: str = entry('text')
    arm_sha256: str = entry('text')  # hash of its parameters
    section: ClassVar[str]

    def check_arm(self, arm: Any, source: str = 'gains') -> None:
        """Refuse gains of another arm: ConfigError if the hash of its parameters differs."""
        if self.arm_sha256 != arm.sha256():
            raise ConfigError(
                f'{self.section}.arm_sha256',
                f'these gains were designed for another arm ({self.arm_name!r}, '
                f'{self.arm_sha256[:12]}) than the one in use ({arm.name!r}, '
                f'{arm.sha256()[:12]}); run lpv design for it',
                source,
            )


@dataclass(frozen=True)
class LoopProof:
    """A Lyapunov function, and what it proves."""

    decay: float = positive()  # alpha: sqrt(V) falls with exp(-alpha t) [1/s]
    lyapunov: FloatArray = array(3, 3)  # P
    multipliers: FloatArray = array(2)  # of the sectors of Gamma and Phi


@dataclass(frozen=True)
class SampledProof(LoopProof):
    """`LoopProof` of the sampled loop."""

    lyapunov: FloatArray = array(4, 4)  # P, of the command, too


@dataclass(frozen=True)
class ErrorProof(LoopProof):
    """`LoopProof` of a region of motion on which the tracking error is bounded."""

    # of the velocity limits, of all joints at once [-]
    rate_share: float = positive(high=1.0)
    acceleration: float = entry('number', low=0.0)  # largest of the reference [rad/s2]
    level: float = positive()  # mu: V ends below mu abs(omega)^2 [-]
    bound: FloatArray = array(-1)  # of the tracking error of each joint, shape (n,) [rad]


@dataclass(frozen=True)
class LoopGains(DesignedForArm):
    """Tracking of a serial arm, with its certificate."""

    bandwidth: float = entry('number', low=0.1, high=100.0)  # w [rad/s]
    # d: of each link's pseudo-inertia, in the matrix order [-]
    model_error: float = entry('number', low=0.0, high=0.5)
    # region: share of the velocity limits, of all joints at once [-]
    rate_share: float = positive(high=1.0)
    motion: LoopProof = part(LoopProof)  # at rate_share
    sampled: LoopProof = part(SampledProof)  # at rate_share
    error: ErrorProof = part(ErrorProof)  # at its own, smaller one
    model: ModelBounds = part(ModelBounds)
    checksum: str = ''  # of the numbers as they were written; '' if not read from a file
    section = 'loop'


def loop_checksum(gains: LoopGains) -> str:
    """Hash of every number."""
    data = loop_to_dict(gains)
    return sha256_of({name: value for name, value in data.items() if name != 'checksum'})


def loop_to_dict(gains: LoopGains) -> dict[str, Any]:
    """The mapping below ``loop`` in the parameter file, and ``bandwidth``; arrays row by row."""
    return {'format': FORMAT, **plain_entries(gains)}


def parse_loop(data: dict[str, Any], source: str = 'gains') -> LoopGains:
    """Rebuild from nested data.

    Parameters
    ----------
    data : dict
        As of `loop_to_dict`.
    source : str, optional
        Name for error messages.

    Returns
    -------
    LoopGains
        Of checked sizes and finite numbers.

    Raises
    ------
    ConfigError
        If anything is missing, unknown, of the wrong size or not finite.
    """
    top = Section(data, source, 'loop')
    if top.integer('format') != FORMAT:
        raise top.error('format', f'must be {FORMAT}; design again')
    gains = read_entries(LoopGains, top, checksum=top.text('checksum'))
    n, forms = len(gains.model.inertia), vars(gains.model.forms).values()
    if len(gains.error.bound) != n or any(len(rows) != n - 1 for rows in forms):
        raise top.error('model', f'must have forms and bounds of {n} joints')
    return gains


def save_loop_gains(gains: LoopGains, path: str | Path, comment: str = '') -> None:
    """Write the parameter file (``/**: ros__parameters: bandwidth, loop``), with its checksum.

    Parameters
    ----------
    gains : LoopGains
        What to write.
    path : str or pathlib.Path
        File to write; parent directories are made.
    comment : str, optional
        Text for the head of the file.
    """
    loop = loop_to_dict(gains)
    loop['checksum'] = loop_checksum(gains)
    bandwidth = loop.pop('bandwidth')
    write_parameters(path, {'bandwidth': bandwidth, 'loop': loop}, comment)


def serial_parameters(path: str | Path) -> dict[str, Any] | None:
    """Parameters of a file that tunes the tracker of a serial arm; None of any other file."""
    nodes = read_yaml(path).get('/**')
    values = nodes.get('ros__parameters') if isinstance(nodes, dict) else None
    if not isinstance(values, dict) or 'bandwidth' not in values:
        return None
    return values if set(values) <= {'bandwidth', 'loop'} else None


def load_loop_gains(path: str | Path) -> LoopGains:
    """Read a parameter file with a certificate.

    Parameters
    ----------
    path : str or pathlib.Path
        As written by `save_loop_gains`.

    Returns
    -------
    LoopGains
        Validated, but not verified.

    Raises
    ------
    ConfigError
        If the file is none, or has a bandwidth and no certificate.
    """
    values = serial_parameters(path)
    if values is None or not isinstance(values.get('loop'), dict):
        raise ConfigError(
            '/**.ros__parameters.loop',
            'is missing: no certificate; lpv design writes one for a serial arm',
            str(path),
        )
    return parse_loop({**values['loop'], 'bandwidth': values['bandwidth']}, str(path))
