"""Sum rate over power against the number of elements."""

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.table import Table

from agent.experiments.efficiency_vs_elements import (
    ITERATIONS,
    METHODS,
    SIDES,
    SPEEDS_MPS,
    Best,
    Method,
    Size,
    best,
    power_w,
    sizes,
)
from mission.reproduce.reproduction import Data, Reproduction, table
from mission.style import LINES

WORLDS = 64
METHOD_TITLES: dict[Method, str] = {
    "closed_form": "RZF and closed form",
    "sum_rate": f"reference on sum rate, {ITERATIONS} iterations",
    "harmonic": f"reference on fair rate, {ITERATIONS} iterations",
}
PROTOTYPE_BEST = {0.0: "none", 5.0: "400", 7.5: "256", 10.0: "144", 15.0: "100"}
SHADES = ("#7b8794", "#08306b", "#2171b5", "#d9822b", "#a63603")
MARKERS = ("x", "o", "s", "^", "D")


def reproduce(seed: int, episodes: int | None) -> Reproduction:
    """`episodes` counts worlds, each one slot."""
    worlds = episodes or WORLDS
    found = sizes(worlds, seed)
    bests = best(found, seed)
    return Reproduction(
        data={"efficiency_vs_elements": _data(found), "efficiency_vs_elements_best": _best_data(bests)},
        figure=_figure(found, bests),
        tables=[_table(bests)],
        note=(
            "The paper: a best N, lower at higher speed. So it is for the closed form and for the reference on the sum "
            "of rates, near the prototype's; at rest none is found. For users served evenly the best N lies far above "
            "what the paper shows: a larger surface also parts the users from each other, and up to there its rates "
            f"outgrow the drag. Seed {seed}, {worlds} worlds of one slot (physical_1km, "
            "18 dB, mu = 2), hovering at the start for the rates, face-on at the speed for the power; [95 % interval] "
            "by bootstrap over worlds."
        ),
    )


def _data(found: list[Size]) -> Data:
    rows = []
    for size in found:
        rate = size.sum_rate_bps
        for speed in SPEEDS_MPS:
            power = power_w(size.elements, speed)
            rows.append((size.method, speed, size.elements, power, *rate, rate.value / power, rate.half_width / power))
    return Data(
        (
            "method",
            "speed_mps",
            "elements",
            "power_w",
            "sum_rate_bps",
            "sum_rate_half_width_95_bps",
            "efficiency_bit_per_j",
            "efficiency_half_width_95_bit_per_j",
        ),
        rows,
    )


def _best_data(bests: list[Best]) -> Data:
    return Data(
        ("method", "speed_mps", "best_elements", "low_95", "high_95", "largest_tried"),
        [(one.method, one.speed_mps, one.elements, one.low, one.high, SIDES[-1] ** 2) for one in bests],
    )


def _figure(found: list[Size], bests: list[Best]) -> Figure:
    figure = Figure(figsize=(13.5, 4.4), layout="constrained")
    axes = figure.subplots(1, len(METHODS))
    for ax, method in zip(axes, METHODS, strict=True):
        ax.set_title(METHOD_TITLES[method])
        _curves(ax, [size for size in found if size.method == method], [one for one in bests if one.method == method])
    axes[0].set_ylabel("sum rate over power [kbit/J]")
    axes[-1].legend(loc="upper left")
    return figure


def _curves(axes: Axes, found: list[Size], bests: list[Best]) -> None:
    elements = [size.elements for size in found]
    for number, (speed, one) in enumerate(zip(SPEEDS_MPS, bests, strict=True)):
        power = [power_w(size.elements, speed) * 1e3 for size in found]
        rates = [size.sum_rate_bps for size in found]
        values = [rate.value / watts for rate, watts in zip(rates, power, strict=True)]
        widths = [rate.half_width / watts for rate, watts in zip(rates, power, strict=True)]
        axes.errorbar(
            elements,
            values,
            yerr=widths,
            color=SHADES[number],
            linestyle=LINES[number % len(LINES)],
            marker=MARKERS[number],
            markersize=3.5,
            linewidth=1.3,
            elinewidth=0.6,
            label=f"{speed:g} m/s",
        )
        if one.interior:
            at = elements.index(one.elements)
            axes.plot(one.elements, values[at], "o", markersize=12, markerfacecolor="none", color=SHADES[number])
            axes.annotate(
                str(one.elements),
                (one.elements, values[at]),
                xytext=(0, 9),
                textcoords="offset points",
                ha="center",
                color=SHADES[number],
                fontsize=8,
                fontweight="bold",
                bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.5},
            )
    axes.set_xscale("log", base=2)
    ticks = (16, 64, 256, 1024)
    axes.set_xticks(ticks, [str(tick) for tick in ticks])
    axes.set_xlabel("elements N [1]; rings: most efficient N")
    axes.set_yscale("log")


def _table(bests: list[Best]) -> Table:
    shown = table(
        "most efficient number of elements",
        "speed, m/s",
        *METHOD_TITLES.values(),
        "prototype",
        "paper",
    )
    for speed in SPEEDS_MPS:
        cells = [_cell(one) for method in METHODS for one in bests if (one.method, one.speed_mps) == (method, speed)]
        shown.add_row(f"{speed:g}", *cells, PROTOTYPE_BEST[speed], "lower at higher speed" if speed else "")
    return shown


def _cell(one: Best) -> str:
    middle = str(one.elements) if one.interior else f"none up to {one.elements}"
    return middle if one.low == one.high else f"{middle} ({one.low} to {one.high})"
