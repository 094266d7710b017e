"""Replays an archive of bags: here, on all cores, or on a cluster; one row per bag."""

import contextlib
import json
import logging
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import lpv_bag
import lpv_campaign
import lpv_core
from lpv_bag.replay.replay import Replay, ReplayOptions
from lpv_campaign.execution.cluster import on_cluster
from lpv_campaign.fleet.find import FoundBag, unit_of
from lpv_campaign.fleet.tally import Tally, alarm_rows
from lpv_campaign.fleet.truth import STREAMS, TruthKeeper, scenario_of
from lpv_core.certificate.conditions import require
from lpv_core.certificate.gains import Gains, gains_to_dict, parse_gains
from lpv_core.decision.diagnosis import AlarmEvent, DiagnosisParameters
from lpv_core.model.arm import ArmParameters, arm_from_json
from lpv_core.monitoring.monitor import SensorMonitor
from lpv_core.support.config import sha256_of
from lpv_core.support.errors import LpvError
from lpv_core.support.jit import source_digest

_LONGEST_ERROR = 500


@dataclass(frozen=True)
class FleetSettings:
    """What observes, and what of each bag is read."""

    arm: ArmParameters  # Arm of all bags
    gains: Gains  # Its gains
    diagnosis: DiagnosisParameters = DiagnosisParameters()  # Tuning
    max_gap: float = 0.1  # Longest interval that is integrated [s]
    initial_samples: int = 1  # Samples that the start value is averaged over
    options: ReplayOptions = ReplayOptions()  # What is read

    def to_json(self) -> str:
        """All of it as one line; `settings_from_json` reads it back."""
        return json.dumps(
            {
                'arm': self.arm.to_json(),
                'gains': gains_to_dict(self.gains),
                'diagnosis': asdict(self.diagnosis),
                'max_gap': self.max_gap,
                'initial_samples': self.initial_samples,
                'options': asdict(self.options),
            },
            sort_keys=True,
        )

    @property
    def key(self) -> str:
        """Hash of everything that can change a result but the bags and the software."""
        return sha256_of(json.loads(self.to_json()))

    def monitor(self) -> SensorMonitor:
        """A fresh monitor."""
        return SensorMonitor(
            '/uio', self.arm, self.gains, self.diagnosis, self.max_gap, self.initial_samples
        )


@lru_cache(maxsize=2)
def settings_from_json(text: str) -> FleetSettings:
    """`FleetSettings` of a text; a worker parses it once."""
    data = json.loads(text)
    arm, gains = arm_from_json(data['arm']), parse_gains(data['gains'])
    require(arm, gains, 'gains')
    return FleetSettings(
        arm,
        gains,
        DiagnosisParameters(**data['diagnosis']),
        data['max_gap'],
        data['initial_samples'],
        ReplayOptions(**data['options']),
    )


def software() -> str:
    """Hash of everything that makes the numbers."""
    return '-'.join(
        source_digest(Path(module).parent)
        for module in (lpv_core.__file__, lpv_bag.__file__, lpv_campaign.__file__)
    )


def watch_bag(settings: FleetSettings, root: str, bag: FoundBag) -> dict[str, Any]:
    """Replay a bag and measure it.

    Returns a row of the results; what is wrong with a bag that cannot be read is in ``error``.
    """
    row = {'bag': bag.name, 'fingerprint': bag.fingerprint, 'unit': '', 'error': ''}
    try:
        row['unit'] = unit_of(root, bag.name)
        row.update(_figures(settings, Path(root) / bag.name))
    except LpvError as error:
        row['error'] = _line(str(error).replace(f'{Path(root) / bag.name}: ', ''))
    except Exception as error:  # one bag must not end all others
        row['error'] = _line(f'{type(error).__name__}: {error}')
    return row


def _figures(settings: FleetSettings, path: Path) -> dict[str, Any]:
    monitor = settings.monitor()
    tally = Tally(settings.arm.sample_time, settings.max_gap)
    truth = TruthKeeper(settings.arm)

    def take(*parts: Any) -> None:
        tally.take(*parts)
        truth.take(*parts)

    with _quiet():
        result = Replay(monitor, settings.options).watch(path, take, STREAMS)
    rejected = sum(result.rejected.values())
    if rejected >= result.measurements:
        raise LpvError('no measurement could be used: ' + next(iter(result.rejected)))
    row = tally.row()
    alarms = alarm_rows(result.events, row['start'])
    raised = [e.sensor_index for e in result.events if e.event == AlarmEvent.RAISED]
    row.update(
        topic=result.topic,
        measurements=result.measurements,
        rejected=rejected,
        recorder_lost=result.lost,
        **vars(monitor.counters),
        alarms=len(raised),
        alarms_1=raised.count(0),
        alarms_2=raised.count(1),
        alarm_list=alarms,
        warnings=_line('; '.join(result.warnings)),
        has_truth='ground_truth' in result.streams,
        has_reference='reference' in result.streams,
    )
    row.update(truth.row(result.events, scenario_of(path, settings.arm)))
    if truth.is_too_long:
        row['warnings'] = _line('too long to be compared with its ground truth; ' + row['warnings'])
    return row


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Without the log of what is wrong with a bag, which is in its row."""
    logger = logging.getLogger('lpv_bag')
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(level)


def _line(text: str) -> str:
    text = ' '.join(text.split())
    return text if len(text) <= _LONGEST_ERROR else text[: _LONGEST_ERROR - 3] + '...'


def watch_chunk(text: str, chunk: tuple[Any, ...]) -> tuple[Any, ...]:
    """Some bags, as a worker runs them."""
    root, bags = chunk
    settings = settings_from_json(text)
    return software(), [watch_bag(settings, root, FoundBag(*bag)) for bag in bags]


def watch_fleet(
    settings: FleetSettings,
    root: str | Path,
    bags: list[FoundBag],
    workers: int | None = None,
    scheduler: str | None = None,
) -> Iterator[list[dict[str, Any]]]:
    """Replay bags.

    Parameters
    ----------
    settings : FleetSettings
        What observes.
    root : str or pathlib.Path
        Archive; workers on other machines must find it under the same name.
    bags : list of FoundBag
        Bags to do.
    workers : int, optional
        Processes of a cluster on this machine; 0: none, all in this process; by default as many as
        there are cores.
    scheduler : str, optional
        Address of a Dask scheduler to use instead.

    Yields
    ------
    list of dict
        Rows, as bags are done, in any order.

    Raises
    ------
    WorkerError
        If a worker runs other software, or workers die of the same bag again and again.
    """
    text, root = settings.to_json(), str(Path(root).resolve())
    chunks = ((root, [(bag.name, bag.fingerprint)]) for bag in bags)
    if scheduler is None and workers == 0:
        for chunk in chunks:
            yield watch_chunk(text, chunk)[1]
        return
    yield from on_cluster(watch_chunk, text, chunks, software(), workers, scheduler)
