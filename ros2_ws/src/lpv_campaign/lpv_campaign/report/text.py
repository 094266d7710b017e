"""Numbers of the report as people read them; ``-`` where there is none."""

from lpv_core.support.formatting import number


def milli(value, digits=3):
    """A thousand times a number, or ``-``."""
    return '-' if value is None else number(1e3 * value, digits)


def percent(share):
    """Rate of `lpv_campaign.report.statistics.intervals.proportion`, or ``-``."""
    return '-' if share['rate'] is None else f'{100.0 * share["rate"]:.1f}%'


def interval(share):
    """Its interval, or ``-``."""
    if share['rate'] is None:
        return '-'
    return f'{100.0 * share["low"]:.1f} to {100.0 * share["high"]:.1f}%'


def middle(values, digits=2):
    """Middle 90 % of `lpv_campaign.report.statistics.intervals.spread`, or nothing."""
    if not values['count']:
        return ''
    return f'{number(values["low"], digits)} to {number(values["high"], digits)}'


def rate(alarms):
    """Rate of `lpv_campaign.report.statistics.intervals.poisson_rate`, with its interval."""
    if alarms['rate'] is None:
        return 'no time without a fault'
    if not alarms['events']:
        return f'none; fewer than {alarms["high"]:.3g} an hour with 95% confidence'
    return f'{alarms["rate"]:.3g} an hour, 95% interval {alarms["low"]:.3g} to {alarms["high"]:.3g}'
