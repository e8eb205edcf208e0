"""Layout of the rerun viewer, so that nothing has to be clicked."""

from __future__ import annotations

from collections.abc import Sequence

import rerun.blueprint as rrb

from humoslope.replay.rerun.scene import FOLLOWED, TIME

PLOTS = {
    "speed": "forward speed, m/s",
    "height": "height above the ground, m",
    "zmp": "ZMP deviation, m",
    "ground": "ground, degrees",
    "force": "force on the feet, and of the robot on itself, N",
    "load": "joint load, % of its limit",
    "reward": "rewards, per second",
}
"""Titles of the plots, by the last part of their entity path."""
EYE = (1.1, -2.9, 0.7)
"""Position of the camera relative to the robot, m: on its right, a little ahead."""
WINDOW_S = 4.0
"""Time that plots show before and after the current moment, s: a few steps."""


def single(name: str) -> rrb.Blueprint:
    """Returns the layout for one rollout: 3D view on the left, events and origin below it, all plots on the right."""
    world = rrb.Vertical(
        _world("", name),
        rrb.Horizontal(
            _log("", "events"),
            rrb.TextDocumentView(origin="about", name="about"),
        ),
        row_shares=[4, 1],
    )
    plots = rrb.Vertical(*(_plot(name, [""]) for name in PLOTS), row_shares=[2, 2, 2, 2, 2, 3, 4])
    return _whole(rrb.Horizontal(world, plots, column_shares=[3, 2]))


def comparison(names: Sequence[str], prefixes: Sequence[str]) -> rrb.Blueprint:
    """Returns the layout for two rollouts side by side on one timeline; comparable quantities share a plot."""
    worlds = [_world(prefix, name) for prefix, name in zip(prefixes, names, strict=True)]
    shared = [_plot(name, prefixes) for name in ("speed", "height", "zmp", "ground")]
    own = [
        _plot(plot, [prefix], f"{i}: {PLOTS[plot]}")
        for plot in ("load", "reward")
        for i, prefix in enumerate(prefixes, start=1)
    ]
    logs = [_log(prefix, f"{i}: events") for i, prefix in enumerate(prefixes, start=1)]
    return _whole(
        rrb.Vertical(
            rrb.Horizontal(*worlds),
            rrb.Horizontal(*shared),
            rrb.Horizontal(*own),
            rrb.Horizontal(*logs),
            row_shares=[10, 4, 4, 3],
        )
    )


def _whole(content: rrb.Container) -> rrb.Blueprint:
    # Without a state to start in, a browser begins at the end, where the camera is not.
    time = rrb.TimePanel(timeline=TIME, state="collapsed", play_state="playing", loop_mode="all")
    return rrb.Blueprint(content, time, collapse_panels=True)


def _world(prefix: str, name: str) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        # With a moving origin the robot stays in the centre. An eye that tracks an entity also works, but may stop
        # anywhere while the recording is loading.
        origin=f"/{prefix}world/{FOLLOWED}",
        contents=f"/{prefix}world/**",
        name=name,
        background=rrb.Background(kind="GradientBright"),
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=rrb.EyeControls3D(position=EYE, look_target=(0.0, 0.0, -0.1), eye_up=(0.0, 0.0, 1.0)),
    )


def _plot(name: str, prefixes: Sequence[str], title: str = "") -> rrb.TimeSeriesView:
    edges = [rrb.TimeRangeBoundary.cursor_relative(seconds=seconds) for seconds in (-WINDOW_S, WINDOW_S)]
    window = rrb.TimeRange(start=edges[0], end=edges[1])
    return rrb.TimeSeriesView(
        origin="/",
        contents=[f"+ /{prefix}plots/{name}" for prefix in prefixes],
        name=title or PLOTS[name],
        axis_x=rrb.TimeAxis(view_range=window),
        plot_legend=rrb.PlotLegend(corner="LeftTop"),
    )


def _log(prefix: str, name: str) -> rrb.TextLogView:
    columns = [rrb.encodings.TextLogColumn(kind) for kind in ("LogLevel", "Body")]
    return rrb.TextLogView(
        origin=f"/{prefix}events", name=name, columns=rrb.archetypes.TextLogColumns(text_log_columns=columns)
    )
