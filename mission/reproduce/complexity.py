"""Operations and parameters of the networks."""

from matplotlib.figure import Figure
from rich.table import Table

from agent.experiments.complexity import Complexity, Cost, complexities
from mission.reproduce.reproduction import Data, Reproduction, table
from mission.style import INK, PLANNED

NETWORKS = {
    "continuous": "continuous actor",
    "discrete": "discrete actor",
    "actors": "both actors, the sum",
    "ddpg_actor": "DDPG's one actor",
    "critic": "critic",
}


def reproduce(seed: int, episodes: int | None) -> Reproduction:
    """Nothing is random: seed and episodes change nothing."""
    del seed, episodes
    counted = complexities()
    return Reproduction(
        data={"complexity": _data(counted)},
        figure=_figure(counted),
        tables=[_operations_table(counted), _parameters_table(counted)],
        note=(
            "The paper gives the two actors' complexity as max(C_c, C_d) and finds it below DDPG's. That is the time "
            "of two processors; what is computed is the sum, nearly twice as much (the prototype: +93 %), and more "
            "than DDPG's one actor takes. Counted by the paper's formula: one operation for a multiplication with its "
            "addition, 6, 1 and 5 for a node of tanh, ReLU and batch norm. M = J = 4; a forward pass of one state. "
            "Nothing here is random."
        ),
    )


def _data(counted: list[Complexity]) -> Data:
    rows = []
    for one in counted:
        for network in NETWORKS:
            cost: Cost = getattr(one, network)
            rows.append((one.elements, one.hidden, network, cost.operations, 2 * cost.multiply_adds, cost.parameters))
    return Data(("elements", "hidden", "network", "operations", "flops_of_matrix_products", "parameters"), rows)


def _figure(counted: list[Complexity]) -> Figure:
    figure = Figure(figsize=(11, 4.4), layout="constrained")
    sizes = sorted({one.elements for one in counted})
    for ax, elements in zip(figure.subplots(1, len(sizes)), sizes, strict=True):
        ones = [one for one in counted if one.elements == elements]
        ax.set_title(f"One decision, N = {elements}")
        width, places = 0.26, range(len(ones))
        claimed = [one.claimed_operations / 1e6 for one in ones]
        ddpg = [one.ddpg_actor.operations / 1e6 for one in ones]
        discrete = [one.discrete.operations / 1e6 for one in ones]
        continuous = [one.continuous.operations / 1e6 for one in ones]
        first = [place - width for place in places]
        last = [place + width for place in places]
        drawn = [ax.bar(first, claimed, width, color="white", edgecolor=INK, label="dual, the paper's max(C_c, C_d)")]
        ax.bar(places, continuous, width, color="#2171b5", edgecolor="white", hatch="//", label="dual: continuous")
        drawn.append(
            ax.bar(
                places,
                discrete,
                width,
                bottom=continuous,
                color="#9ecae1",
                edgecolor="white",
                hatch="..",
                label="+ discrete: the sum",
            )
        )
        drawn.append(ax.bar(last, ddpg, width, color=PLANNED, edgecolor="white", hatch="xx", label="DDPG's one actor"))
        totals = (claimed, [one.actors.operations / 1e6 for one in ones], ddpg)
        for bars, values in zip(drawn, totals, strict=True):
            ax.bar_label(bars, [f"{value:.2f}" for value in values], padding=2, fontsize=8, color=INK)
        ax.set_xticks(places, [str(one.hidden) for one in ones])
        ax.set_xlabel("neurons in each of two hidden layers [1]")
        ax.set_ylabel("operations a forward pass [10⁶]")
        ax.grid(visible=False, axis="x")
        ax.set_axisbelow(True)
        ax.legend(loc="upper left")
    return figure


def _operations_table(counted: list[Complexity]) -> Table:
    shown = table(
        "thousands of operations a forward pass",
        "N",
        "hidden",
        "C_c",
        "C_d",
        "max",
        "sum",
        "sum / max",
        "DDPG",
        "sum / DDPG",
        "critic",
    )
    for one in counted:
        shown.add_row(
            str(one.elements),
            str(one.hidden),
            _thousands(one.continuous.operations),
            _thousands(one.discrete.operations),
            _thousands(one.claimed_operations),
            _thousands(one.actors.operations),
            f"{one.actors.operations / one.claimed_operations - 1:+.0%}",
            _thousands(one.ddpg_actor.operations),
            f"{one.actors.operations / one.ddpg_actor.operations - 1:+.0%}",
            _thousands(one.critic.operations),
        )
    return shown


def _parameters_table(counted: list[Complexity]) -> Table:
    shown = table("thousands of parameters", "N", "hidden", *NETWORKS.values())
    for one in counted:
        costs: list[Cost] = [getattr(one, network) for network in NETWORKS]
        shown.add_row(str(one.elements), str(one.hidden), *(_thousands(cost.parameters) for cost in costs))
    return shown


def _thousands(count: int) -> str:
    return f"{count / 1e3:.0f}"
