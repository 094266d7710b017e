"""Picture of a study: the trade, the search, what matters."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

_COLOURS = {'good': 'tab:blue', 'beyond limits': 'tab:orange'}


def draw(result: dict[str, Any], path: str | Path) -> None:
    """Draw a study."""
    import matplotlib

    matplotlib.use('Agg')
    import matplotlib.pyplot as plt

    names = list(result['study']['search'])
    figure, axes = plt.subplots(
        2,
        max(3, (len(names) + 3) // 2),
        layout='constrained',
        figsize=(3.4 * max(3, (len(names) + 3) // 2), 6.4),
    )
    axes = axes.ravel()
    _front(axes[0], result)
    _history(axes[1], result)
    _importance(axes[2], result)
    for axis, name in zip(axes[3:], names):
        _slice(axis, result, name)
    for axis in axes[3 + len(names) :]:
        axis.set_axis_off()
    figure.suptitle(f'{result["name"]}: {result["verdict"]}', fontsize=10)
    figure.savefig(path, dpi=100)
    plt.close(figure)


def _points(result: dict[str, Any]) -> Iterator[tuple[str, str, list[dict[str, Any]]]]:
    """State, and trials in it that have a cost."""
    for state, colour in _COLOURS.items():
        trials = [t for t in result['trials'] if t['state'] == state]
        if trials:
            yield state, colour, trials


def _marked(
    axis: Any, result: dict[str, Any], x: Callable[..., float], y: Callable[..., float]
) -> None:
    """The first trial and the picked one."""
    for number, marker, label in ((0, 's', 'before'), (result['picked'], '*', 'picked')):
        if number is not None and result['trials'][number]['state'] != 'infeasible':
            trial = result['trials'][number]
            axis.plot(x(trial), y(trial), marker, color='black', ms=9, mfc='none', label=label)


def _front(axis: Any, result: dict[str, Any]) -> None:
    for state, colour, trials in _points(result):
        axis.plot(
            [t['healthy_score'] for t in trials],
            [t['cost'] for t in trials],
            '.',
            color=colour,
            label=state,
        )
    front = sorted(
        (result['trials'][n]['healthy_score'], result['trials'][n]['cost']) for n in result['front']
    )
    if front:
        axis.step(*zip(*front), where='post', color='tab:blue', lw=0.8)
    _marked(axis, result, lambda t: t['healthy_score'], lambda t: t['cost'])
    axis.axvline(result['study']['limits'].get('healthy_score', 1.0), color='grey', lw=0.8, ls=':')
    axis.set(xlabel='largest estimate / threshold without fault', ylabel='cost')
    axis.set_ylim(top=_top(result))
    if axis.get_legend_handles_labels()[0]:
        axis.legend(fontsize=7)


def _history(axis: Any, result: dict[str, Any]) -> None:
    for _, colour, trials in _points(result):
        axis.plot([t['number'] for t in trials], [t['cost'] for t in trials], '.', color=colour)
    lost = [t['number'] for t in result['trials'] if t['state'] == 'infeasible']
    for number in lost:
        axis.axvline(number, color='lightgrey', lw=1.0, zorder=0)
    axis.set(xlabel=f'trial ({len(lost)} infeasible: grey)', ylabel='cost')
    axis.set_ylim(top=_top(result))


def _importance(axis: Any, result: dict[str, Any]) -> None:
    shares = result['importance']
    axis.barh(list(shares), list(shares.values()), color='tab:blue')
    axis.tick_params(axis='y', labelsize=7)
    axis.set(xlabel='importance for a low cost')


def _slice(axis: Any, result: dict[str, Any], name: str) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter

    for _, colour, trials in _points(result):
        axis.plot(
            [t['values'][name] for t in trials], [t['cost'] for t in trials], '.', color=colour
        )
    _marked(axis, result, lambda t: t['values'][name], lambda t: t['cost'])
    if result['study']['search'][name].get('spacing') == 'log':
        axis.set_xscale('log')
        axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0), numticks=6))
        axis.xaxis.set_major_formatter('{x:g}')
        axis.xaxis.set_minor_formatter(NullFormatter())
    axis.set(xlabel=name, ylabel='cost')
    axis.set_ylim(top=_top(result))


def _top(result: dict[str, Any]) -> float | None:
    """Trials far from good ones must not flatten the rest."""
    costs = [t['cost'] for t in result['trials'] if 'cost' in t]
    return 1.05 * min(max(costs), 3.0 * min(costs)) if costs else None
