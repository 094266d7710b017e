"""Gains of observer and controller of a planar arm, and files with gains of either kind."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from lpv.core.serial_arm.certificate.certified import CertifiedGains, Inequalities
from lpv.core.serial_arm.certificate.loop_gains import LoopGains
from lpv.core.serial_arm.description import SerialArm
from lpv.core.support.config import read_yaml
from lpv.core.support.entries import part, part_by
from lpv.core.support.errors import ConfigError
from lpv.core.support.inequalities import Check, NumberType
from lpv.core.uio.certificate.conditions import (
    ControllerGains,
    controller_checks,
    controller_inequalities,
    observer_checks,
    observer_inequalities,
)
from lpv.core.uio.observer.exact_observer import ExactObserverGains
from lpv.core.uio.observer.paper_observer import PaperObserverGains
from lpv.core.uio.observer.sampled_observer import ObserverGains
from lpv.core.uio.planar import planar_model


@dataclass(frozen=True)
class Gains(CertifiedGains):
    """Everything that a design hands to the nodes."""

    observer: ObserverGains = part_by('method', paper=PaperObserverGains, exact=ExactObserverGains)
    controller: ControllerGains = part(ControllerGains)
    # margins, solver and versions, as text and numbers: information, nothing is computed from it
    certificate: dict = field(default_factory=dict, metadata={'entry': ('plain', (), {})})
    format = 3
    section = 'gains'
    unused = ('format', 'arm_name', 'certificate')
    what = 'gains'

    def hash_of(self, arm: SerialArm) -> str:
        """As of `CertifiedGains`: of the planar arm."""
        return planar_model(arm).sha256()

    def mapping(self) -> dict[str, Any]:
        """As of `CertifiedGains`; information comes last."""
        data = super().mapping()
        data['certificate'] = data.pop('certificate')
        return data

    def inequalities(self, arm: SerialArm, number: NumberType = float) -> Inequalities:
        """As of `CertifiedGains`.

        The sampled controller's spectral radius is not a definiteness and stays a matter of floats.
        """
        planar = planar_model(arm)
        yield from observer_inequalities(planar, self.observer, number)
        yield from controller_inequalities(planar, self.controller, number)

    def checks(self, arm: SerialArm) -> Iterator[Check]:
        """As of `CertifiedGains`."""
        planar = planar_model(arm)
        yield from observer_checks(planar, self.observer)
        yield from controller_checks(planar, self.controller)

    def facts(self, arm: SerialArm) -> list[str]:
        """As of `CertifiedGains`."""
        planar, observer, controller = planar_model(arm), self.observer, self.controller
        way = 'upwards' if planar.sign > 0 else 'downwards'
        degrees = ', '.join(f'{np.degrees(np.arccos(low)):.1f}°' for low in planar.cos_min)
        return [
            f'method: observer {observer.method}, controller {controller.method}',
            f'certified region: links within {degrees} of the vertical {way}',
            f'decay: estimation error {observer.decay:g} /s, tracking error {controller.decay:g} '
            '/s',
        ]


def gains_in(path: str | Path) -> Gains | LoopGains | None:
    """Gains of either kind in a file; None where it has the bandwidth of a loop alone.

    ConfigError if it is no gains file, or a wrong one.
    """
    nodes, where = read_yaml(path).get('/**'), '/**.ros__parameters'
    values = nodes.get('ros__parameters') if isinstance(nodes, dict) else None
    if isinstance(values, dict) and 'gains' in values:
        return Gains.parse(values['gains'], str(path))
    if not isinstance(values, dict) or not {'bandwidth'} <= set(values) <= {'bandwidth', 'loop'}:
        raise ConfigError(f'{where}.gains', 'is missing: not a gains file', str(path))
    if 'loop' not in values:
        return None
    if not isinstance(values['loop'], dict):
        raise ConfigError(f'{where}.loop', 'must be a mapping', str(path))
    return LoopGains.parse({**values['loop'], 'bandwidth': values['bandwidth']}, str(path))


def load_certified(path: str | Path) -> Gains | LoopGains:
    """Gains of either kind from a file; ConfigError if it has none."""
    found = gains_in(path)
    if found is None:
        reason = 'is missing: no certificate; lpv design writes one for a serial arm'
        raise ConfigError('/**.ros__parameters.loop', reason, str(path))
    return found


def load_gains(path: str | Path) -> Gains:
    """Gains of an observer from a file; ConfigError if it has none."""
    found = gains_in(path)
    if not isinstance(found, Gains):
        reason = 'is missing: it certifies a tracking loop; this arm has no observer with gains'
        raise ConfigError('/**.ros__parameters.gains', reason, str(path))
    return found
