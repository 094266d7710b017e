"""Estimates beside the best possible ones, in the runs that compared them."""

from lpv_campaign.report.intervals import spread

PREFIX = 'limit_'
"""Columns that belong here begin so."""


def limit(results):
    """Spread of every figure of the accuracy's limit.

    Parameters
    ----------
    results : Results
        Rows.

    Returns
    -------
    list of dict
        ``name`` (without the prefix), ``count``, ``low``, ``median``, ``high``; none that no run
        has.
    """
    entries = [{'name': name[len(PREFIX):], **spread(results.number(name))}
               for name in sorted(results.columns) if name.startswith(PREFIX)]
    return [entry for entry in entries if entry['count']]
