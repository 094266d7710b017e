"""Numbers of the report as text; ``-`` where there is none."""

from typing import Any

from lpv_core.support.formatting import number, seconds

__all__ = ['interval', 'middle', 'milli', 'number', 'percent', 'rate', 'seconds']


def milli(value: float | None, digits: int = 3) -> str:
    """A thousand times a number, or ``-``."""
    return '-' if value is None else number(1e3 * value, digits)


def percent(share: dict[str, Any]) -> str:
    """Rate of `lpv_campaign.report.statistics.intervals.proportion`, or ``-``."""
    return '-' if share['rate'] is None else f'{100.0 * share["rate"]:.1f}%'


def interval(share: dict[str, Any]) -> str:
    """Its interval, or ``-``."""
    if share['rate'] is None:
        return '-'
    return f'{100.0 * share["low"]:.1f} to {100.0 * share["high"]:.1f}%'


def middle(values: dict[str, Any], digits: int = 2) -> str:
    """Middle 90 % of `lpv_campaign.report.statistics.intervals.spread`, or nothing."""
    if not values['count']:
        return ''
    return f'{number(values["low"], digits)} to {number(values["high"], digits)}'


def rate(alarms: dict[str, Any]) -> str:
    """Rate of `lpv_campaign.report.statistics.intervals.poisson_rate`, with its interval."""
    if alarms['rate'] is None:
        return 'no time without a fault'
    if not alarms['events']:
        return f'none; fewer than {alarms["high"]:.3g} per hour with 95% confidence'
    return (
        f'{alarms["rate"]:.3g} per hour, 95% interval {alarms["low"]:.3g} to {alarms["high"]:.3g}'
    )
