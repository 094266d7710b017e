"""The figures on top of the page."""

from typing import Any

from lpv_campaign.report import text


def tiles(numbers: dict[str, Any]) -> list[dict[str, Any]]:
    """What a reader wants to know first.

    Returns ``name``, ``value`` and ``note`` of each.
    """
    head, overall, stability = numbers['head'], numbers['overall'], numbers['stability']
    hours = f'{text.number(head["hours"])} h simulated'
    alarms, detected = numbers['false_alarms'], overall['detected']
    return [
        {'name': 'runs', 'value': head['runs'], 'note': hours},
        {
            'name': 'faults detected',
            'value': text.percent(detected),
            'note': f'of {detected["cases"]}',
        },
        {
            'name': 'detected and isolated',
            'value': text.percent(overall['isolated']),
            'note': 'no alarm of another sensor',
        },
        {
            'name': 'false alarms of healthy arms',
            'value': alarms['before']['events'],
            'note': f'in {text.number(alarms["before"]["hours"])} h; '
            f'{alarms["after"]["events"]} after the end of a fault',
        },
        {
            'name': 'unstable runs',
            'value': stability['unstable'],
            'note': f'safe stops in {stability["stopped"]}',
        },
    ]
