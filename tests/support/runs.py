"""Small recorded runs, and reading of the pages that reports make of them."""

import html
import re

from lpv.bag.replay.replay import Replay
from lpv.bag.rosbag.reading import open_bag
from lpv.bag.rosbag.writing import BagWriter
from lpv.campaign.execution.run_to_bag import write_signals
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.simulation.closed_loop import run_closed_loop

MEASURED = {'joint_states', 'torque_command', 'state_estimate', 'fault_estimate', 'fault_alarm'}
FORBIDDEN = {'srcset', 'data', 'poster', 'action', 'formaction', 'background'}
"""Attributes that load."""
ALL = MEASURED | {'ground_truth', 'reference'}


def record(path, arm, gains, scenario):
    measured = path.with_name(f'{path.name}_measured')
    write_signals(arm, run_closed_loop(arm, scenario, gains), measured)
    Replay(SerialSensorMonitor('/lpv/uio', arm, gains=gains)).run(measured, path)
    return path


def copied(bag, out, keep=lambda topic: True, change=lambda topic, data: data, **options):
    """A bag with the topics that are kept, and with other bytes; None leaves a message out."""
    with open_bag(bag) as reader, BagWriter(out, **options) as writer:
        kept = [c for c in reader.connections if keep(c.topic)]
        for connection in kept:
            writer.copy_topic(connection)
        for connection, time, data in reader.messages(kept):
            if (data := change(connection.topic, bytes(data))) is not None:
                writer.write_raw(connection.topic, time, data)
    return out


def rows(page):
    found = re.findall(r'<tr>(.*?)</tr>', page, re.DOTALL)
    cells = [re.findall(r'<t[dh][^>]*>(.*?)</t[dh]>', row, re.DOTALL) for row in found]
    return [[html.unescape(re.sub('<[^>]*>', '', one)).strip() for one in row] for row in cells]


def text(page):
    return ' '.join(html.unescape(re.sub('<[^>]*>', ' ', page)).split())


def assert_stands_alone(page):
    """A page of HTML loads nothing from elsewhere, runs nothing, and links to itself alone."""
    assert page.startswith('<!DOCTYPE html>')
    tags = re.findall(r'<(\w+)((?:\s+[\w:-]+(?:="[^"]*")?)*)\s*/?>', page)
    assert not {'script', 'link', 'iframe', 'object', 'embed', 'base'} & {tag for tag, _ in tags}
    attributes = re.findall(r'([\w:-]+)="([^"]*)"', ' '.join(found for _, found in tags))
    for name, value in attributes:
        assert name not in FORBIDDEN and not name.startswith('on'), (name, value)
        assert name != 'src' or value.startswith('data:image/png;base64,')
        assert name != 'href' or value[0] == '#' and ('id', value[1:]) in attributes
    for outside in ('://', '<script', '@import', 'url('):
        assert outside not in page
