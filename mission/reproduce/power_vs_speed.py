"""Power against speed and size of the surface."""

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.table import Table

from agent.experiments.power_vs_speed import ELEMENTS, READINGS, Curve, curves
from mission.reproduce.reproduction import Data, Reproduction, table
from mission.style import INK, LINES

CSV_STEP = 100
"""Every 0.1 m/s."""
PROTOTYPE_RANGE_MPS = {0: 19.0, 16: 15.3, 64: 10.8, 256: 7.15, 1024: 4.5}
"""Of the design's prototype, sqrt form."""
TITLES = {"sqrt": "eq. 16b with both roots, v_i = 4.504 m/s", "printed": "eq. 16b as printed, v_i = 4.028 m/s"}
SHADES = ("#08306b", "#2171b5", "#6baed6", "#d9822b", "#a63603")


def reproduce(seed: int, episodes: int | None) -> Reproduction:
    """Nothing is random: seed and episodes change nothing."""
    del seed, episodes
    drawn = curves()
    return Reproduction(
        data={"power_vs_speed": _data(drawn)},
        figure=_figure(drawn),
        tables=[_table(drawn)],
        note=(
            "The paper's figure gives no numbers; that drag moves the most economic speed down, as it says, holds. "
            "The whole speed counts as face-on (v_perp: speed), as in that figure: flown edge-on a panel costs "
            "nothing. Nothing here is random."
        ),
    )


def _data(drawn: list[Curve]) -> Data:
    rows: list[tuple[str | int | float, ...]] = []
    for curve in drawn:
        markers = {curve.endurance: "max_endurance", curve.range: "max_range"}
        for index in sorted({*range(0, len(curve.speed_mps), CSV_STEP), *markers}):
            speed, power = curve.speed_mps[index].item(), curve.power_w[index].item()
            rows.append((curve.reading, curve.elements, speed, power, markers.get(index, "")))
    return Data(("induced", "elements", "speed_mps", "power_w", "marker"), rows)


def _figure(drawn: list[Curve]) -> Figure:
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    for ax, reading in zip(axes, READINGS, strict=True):
        _panel(ax, [curve for curve in drawn if curve.reading == reading])
        ax.set_title(TITLES[reading])
    axes[0].set_ylabel("total power [W]")
    axes[0].legend(loc="lower right")
    return figure


def _panel(axes: Axes, drawn: list[Curve]) -> None:
    top = 700.0
    for number, curve in enumerate(drawn):
        speed, power = curve.speed_mps.numpy()[::50], curve.power_w.numpy()[::50]
        axes.plot(speed, power, color=SHADES[number], linestyle=LINES[number % len(LINES)], linewidth=1.7)
        last = int((power < 0.92 * top).nonzero()[0][-1])
        axes.annotate(
            f"N = {curve.elements}",
            (speed[last], power[last]),
            color=SHADES[number],
            fontsize=8,
            fontweight="bold",
            xytext=(4, 0),
            textcoords="offset points",
        )
        for index, marker in ((curve.endurance, "o"), (curve.range, "s")):
            axes.plot(
                curve.speed_mps[index], curve.power_w[index], marker, color="white", markeredgecolor=INK, markersize=6
            )
    axes.plot([], [], "o", color="white", markeredgecolor=INK, label="maximum endurance (least power)")
    axes.plot([], [], "s", color="white", markeredgecolor=INK, label="maximum range (least energy a metre)")
    axes.set_ylim(0, top)
    axes.set_xlim(0, 31.5)
    axes.set_xlabel("speed through the air [m/s]")


def _table(drawn: list[Curve]) -> Table:
    shown = table(
        "speeds of maximum endurance and range, m/s",
        "N",
        "endurance",
        "range",
        "range, prototype",
        "power there, W",
        "as printed: endurance",
        "range",
    )
    by_reading = {(curve.reading, curve.elements): curve for curve in drawn}
    for elements in ELEMENTS:
        sound, printed = by_reading["sqrt", elements], by_reading["printed", elements]
        shown.add_row(
            str(elements),
            f"{sound.speed_mps[sound.endurance]:.2f}",
            f"{sound.speed_mps[sound.range]:.2f}",
            f"{PROTOTYPE_RANGE_MPS[elements]:g}",
            f"{sound.power_w[sound.range]:.1f}",
            f"{printed.speed_mps[printed.endurance]:.2f}",
            f"{printed.speed_mps[printed.range]:.2f}",
        )
    return shown
