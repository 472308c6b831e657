"""The picture of a flight, `report.png`."""

import math
from collections.abc import Mapping
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D  # type: ignore[import-untyped]  # matplotlib types all but this
from mpl_toolkits.mplot3d.art3d import Line3DCollection  # type: ignore[import-untyped]
from numpy.typing import NDArray

from bus import topics
from bus.messages import LinkReport, RisConfiguration, TrackSample, Vec3
from mission.flight_log import FlightLog
from mission.flyability import Flyability
from mission.report import Report
from mission.style import INK, LINES, MUTED, PLANNED, STYLE
from rf_model.scenario import Scenario

Floats = NDArray[np.float64]

SIDES = {"reflection": "#0072b2", "transmission": "#cc4c8f"}
COMPASS = ("east", "north-east", "north", "north-west", "west", "south-west", "south", "south-east")


def draw(log: FlightLog, report: Report, scenario: Scenario | None, path: Path) -> None:
    """Draw a flight of at least one slot. Without `scenario` the base station is left out."""
    slots = [slot for _, slot in sorted(log.by_slot(topics.SLOT).items())]
    links = [link for _, link in sorted(log.by_slot(topics.LINK).items())]
    configurations = [entry for _, entry in sorted(log.by_slot(topics.CONFIGURATION).items())]
    start_s = slots[0].time_s
    flown = [sample for slot in slots if slot.flown for sample in slot.flown.track]
    planned = [sample for slot in slots if slot.flown for sample in slot.flown.plan]

    with mpl.rc_context(STYLE):
        rows = 3 if report.flyability is None else 4
        figure = Figure(figsize=(13.5, 8.6 * rows / 3), layout="constrained")
        grid = figure.add_gridspec(rows, 2, width_ratios=(1.15, 1.0))
        scene = figure.add_subplot(grid[:2, 0], projection="3d")
        assert isinstance(scene, Axes3D)
        _trajectory(scene, flown, links, scenario)
        rates = figure.add_subplot(grid[0, 1])
        _rates(rates, links, report.qos_bps, start_s)
        altitude = figure.add_subplot(grid[1, 1], sharex=rates)
        speed = figure.add_subplot(grid[2, 1], sharex=rates)
        _altitude(altitude, flown, planned, start_s)
        _speed(speed, flown, planned, start_s)
        phases = grid[2, 0].subgridspec(1, 2)
        _phases(figure, [figure.add_subplot(phases[0]), figure.add_subplot(phases[1])], configurations)
        if report.flyability is not None:
            opened_s = {slot.slot: slot.time_s - start_s for slot in slots}
            _displacements(figure.add_subplot(grid[3, 0]), report.flyability, opened_s)
            _flyable_rates(figure.add_subplot(grid[3, 1], sharex=rates), report.flyability, opened_s)
        figure.suptitle(
            f"{report.mission}   ·   {report.slots} slots   ·   sum rate {report.sum_rate_bps / 1e6:.2f} Mbit/s   ·   "
            f"HFI {report.hfi:.2f}   ·   {report.energy_j / 1e3:.1f} kJ",
            color=INK,
            fontsize=12,
            fontweight="bold",
            x=0.01,
            ha="left",
        )
        figure.savefig(path, format="png", dpi=120, facecolor="white")


def _trajectory(axes: Axes3D, flown: list[TrackSample], links: list[LinkReport], scenario: Scenario | None) -> None:
    axes.set_title("Trajectory, users and base station")
    axes.set_xlabel("east [m]")
    axes.set_ylabel("north [m]")
    axes.set_zlabel("up [m]")
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color((0.97, 0.98, 0.99, 1.0))

    for user, region in enumerate(links[0].regions):
        walk = np.array([link.users_enu[user] for link in links])
        axes.plot(*walk.T, color=SIDES[region], linewidth=1.2)
        axes.scatter(*walk[-1], color=SIDES[region], s=26, depthshade=False)
        axes.text(*(walk[-1] + (0.0, 0.0, 5.0)), f"user {user}", color=SIDES[region], fontsize=8, ha="center")
    for side, colour in SIDES.items():
        axes.plot([], [], "o", color=colour, markersize=5, label=f"user, {side} side at the start")

    track = _positions(flown)
    if len(track):
        axes.plot(track[:, 0], track[:, 1], 0.0, color=MUTED, linewidth=0.8, linestyle=":")
        segments = np.stack([track[:-1], track[1:]], axis=1)
        coloured = Line3DCollection(list(segments), cmap="viridis", linewidth=2.6)
        coloured.set_array(np.arange(len(segments)))
        axes.add_collection3d(coloured)
        for point, marker, name in ((track[0], "^", "first slot"), (track[-1], "s", "last slot")):
            axes.scatter(*point, color=INK, s=34, marker=marker, depthshade=False, label=name)
            axes.plot([point[0]] * 2, [point[1]] * 2, [0.0, point[2]], color=MUTED, linewidth=0.8)
    axes.scatter(0.0, 0.0, 0.0, color=INK, marker="+", s=50, label="home")

    everything = np.concatenate([track, *(np.array(link.users_enu) for link in links), np.zeros((1, 3))])
    half = max(40.0, 1.15 * float(np.abs(everything[:, :2]).max()))
    top = 1.15 * float(everything[:, 2].max())
    axes.set_xlim(-half, half)
    axes.set_ylim(-half, half)
    axes.set_zlim(0.0, top)
    axes.set_box_aspect((1.0, 1.0, 0.55), zoom=1.15)
    if scenario is not None:
        _base_station(axes, scenario.base_station_enu, half)
    axes.view_init(elev=24, azim=-58)
    axes.legend(loc="upper right", ncols=1)


def _base_station(axes: Axes3D, station: Vec3, half: float) -> None:
    """Where it stands, or, when that is off the picture, the way to it."""
    east, north, up = station
    distance = math.hypot(east, north)
    if max(abs(east), abs(north)) <= half:
        axes.scatter(east, north, up, color=PLANNED, marker="^", s=70, depthshade=False, label="base station")
        return
    unit = np.array([east, north]) / distance
    edge = unit * half / max(abs(unit))
    axes.quiver(*(edge * 0.66), up, *(edge * 0.34), 0.0, color=PLANNED, linewidth=2.0, arrow_length_ratio=0.35)
    heading = COMPASS[round(math.atan2(north, east) / (math.pi / 4)) % 8]
    text = f"base station\n{distance / 1e3:.2g} km {heading}, {up:.0f} m high"
    axes.text(*(edge * 0.98), up + 8.0, text, color=PLANNED, fontsize=8, fontweight="bold")


def _rates(axes: Axes, links: list[LinkReport], qos_bps: float, start_s: float) -> None:
    axes.set_title("Rate of each user")
    axes.set_ylabel("[kbit/s]")
    times = [link.time_s - start_s for link in links]
    end = times[-1] + (times[-1] - times[0]) / max(len(times) - 1, 1)  # the last slot's rate holds to its end
    for user, region in enumerate(links[0].regions):
        rates = [max(link.rate_bps[user], 1.0) / 1e3 for link in links]
        line = LINES[links[0].regions[:user].count(region) % len(LINES)]
        axes.step(
            [*times, end],
            [*rates, rates[-1]],
            linestyle=line,
            where="post",
            color=SIDES[region],
            label=f"user {user}",
        )
    axes.axhline(qos_bps / 1e3, color=PLANNED, linewidth=1.4, linestyle=(0, (6, 3)), label="QoS")
    axes.set_yscale("log")
    axes.set_ylim(bottom=max(axes.get_ylim()[0], qos_bps / 1e3 / 100))
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=len(links[0].regions) + 1)


def _altitude(axes: Axes, flown: list[TrackSample], planned: list[TrackSample], start_s: float) -> None:
    axes.set_title("Altitude")
    axes.set_ylabel("[m]")
    axes.plot(_times(planned, start_s), _positions(planned)[:, 2], color=PLANNED, linestyle="--", label="planned")
    axes.plot(_times(flown, start_s), _positions(flown)[:, 2], color=INK, label="flown")
    axes.legend(loc="best", ncols=2)


def _speed(axes: Axes, flown: list[TrackSample], planned: list[TrackSample], start_s: float) -> None:
    axes.set_title("Speed")
    axes.set_ylabel("[m/s]")
    axes.set_xlabel("vehicle time since slot 0 [s]")
    for samples, colour, line, name in ((planned, PLANNED, "--", "planned"), (flown, INK, "-", "flown")):
        speeds = np.linalg.norm(np.array([sample.velocity_enu for sample in samples]).reshape(-1, 3), axis=1)
        axes.plot(_times(samples, start_s), speeds, line, color=colour, label=name)
    axes.legend(loc="best", ncols=2)


def _displacements(axes: Axes, flyable: Flyability, opened_s: Mapping[int, float]) -> None:
    axes.set_title("Displacement of each slot")
    axes.set_ylabel("[m]")
    _by_place(axes, flyable, opened_s, [(slot.commanded_m, slot.planned_m, slot.flown_m) for slot in flyable.by_slot])


def _flyable_rates(axes: Axes, flyable: Flyability, opened_s: Mapping[int, float]) -> None:
    how = "surface as flown" if flyable.anew_by is None else flyable.anew_by.replace("_", " ")
    axes.set_title(f"Sum rate by place, {how}")
    axes.set_ylabel("[kbit/s]")
    rates = [(slot.anew or slot.as_set).rate_bps for slot in flyable.by_slot]
    _by_place(axes, flyable, opened_s, [(rate.commanded / 1e3, rate.planned / 1e3, rate.flown / 1e3) for rate in rates])


def _by_place(
    axes: Axes, flyable: Flyability, opened_s: Mapping[int, float], values: list[tuple[float, float, float]]
) -> None:
    """A step for each slot: commanded, planned, flown. Slots that are not in it leave a gap."""
    axes.set_xlabel("vehicle time since slot 0 [s]")
    shown = {slot.slot: value for slot, value in zip(flyable.by_slot, values, strict=True)}
    nothing = (math.nan, math.nan, math.nan)
    slots = range(min(shown), max(shown) + 2)
    edges = [opened_s.get(slot, math.nan) for slot in slots]
    heights = np.array([shown.get(slot, nothing) for slot in slots[:-1]]).T
    looks = (("commanded", MUTED, ":", 1.4), ("planned", PLANNED, "--", 1.4), ("flown", INK, "-", 1.4))
    for (name, colour, line, width), height in zip(looks, heights, strict=True):
        axes.stairs(height, edges, baseline=None, color=colour, linestyle=line, linewidth=width, label=name)
    axes.set_ylim(bottom=0.0)
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=3)


def _phases(figure: Figure, axes: list[Axes], configurations: list[RisConfiguration]) -> None:
    sides = (
        ("RIS phase, reflection", [entry.theta_reflection for entry in configurations]),
        ("RIS phase, transmission", [entry.theta_transmission for entry in configurations]),
    )
    for ax, (title, phases) in zip(axes, sides, strict=True):
        image = ax.imshow(
            np.array(phases).T,
            cmap="twilight",
            vmin=-math.pi,
            vmax=math.pi,
            aspect="auto",
            interpolation="nearest",
            origin="lower",
        )
        ax.set_title(title)
        ax.set_xlabel("slot")
        ax.grid(visible=False)
    axes[0].set_ylabel("element")
    bar = figure.colorbar(image, ax=axes, ticks=(-math.pi, 0.0, math.pi), pad=0.01)
    bar.ax.set_yticklabels(["−π", "0", "π"])


def _times(samples: list[TrackSample], start_s: float) -> Floats:
    return np.array([sample.time_s for sample in samples]) - start_s


def _positions(samples: list[TrackSample]) -> Floats:
    return np.array([sample.position_enu for sample in samples], dtype=np.float64).reshape(-1, 3)
