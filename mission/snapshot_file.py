"""`aerialstar rf evaluate`: a snapshot file in, tables or one JSON object out."""

import json
import math
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from rich.table import Table

from mission.yaml_file import YamlError, read_mapping
from rf_model.evaluation import Evaluation, Link, evaluate
from rf_model.snapshot import Snapshot, SnapshotError, read_snapshot


def evaluate_file(path: Path) -> Evaluation:
    """Evaluate a snapshot file, or standard input for `-`. Raises SnapshotError."""
    try:
        return evaluate(read_snapshot(read_mapping(path, Snapshot.model_fields)))
    except YamlError as error:
        raise SnapshotError(str(error)) from error
    except SnapshotError as error:
        raise SnapshotError(f"{path}: {error}") from error


def to_json(evaluation: Evaluation) -> str:
    """One JSON object in one line, SI units."""
    return json.dumps(asdict(evaluation), allow_nan=False)


def tables(evaluation: Evaluation) -> Iterator[Table]:
    """What people read: links, users, totals."""
    yield _links(evaluation)
    yield _users(evaluation)
    yield _totals(evaluation)


def _links(evaluation: Evaluation) -> Table:
    table = _table("links", "link", "distance, m", "path loss LoS, dB", "NLoS, dB", "P(LoS)", "in sight")
    links = evaluation.links
    _add_link(table, "base station - surface", links.bs_ris)
    for j, (direct, served) in enumerate(zip(links.direct, links.ris_user, strict=True)):
        _add_link(table, f"base station - user {j}", direct)
        _add_link(table, f"surface - user {j}", served)
    return table


def _add_link(table: Table, name: str, link: Link) -> None:
    losses = ("-" if loss is None else f"{loss:.2f}" for loss in (link.path_loss_los_db, link.path_loss_nlos_db))
    sight = {True: "yes", False: "no", None: "?"}[link.line_of_sight]
    table.add_row(name, f"{link.distance_m:.1f}", *losses, f"{link.line_of_sight_probability:.3f}", sight)


def _users(evaluation: Evaluation) -> Table:
    table = _table("users", "user", "region", "SINR, dB", "rate, Mbit/s", "below QoS")
    columns = (evaluation.regions, evaluation.sinr, evaluation.rate_bps, evaluation.below_qos)
    for j, (region, sinr, rate_bps, below) in enumerate(zip(*columns, strict=True)):
        sinr_db = f"{10 * math.log10(sinr):.2f}" if sinr > 0 else "-"
        table.add_row(str(j), region, sinr_db, f"{rate_bps / 1e6:.4f}", "yes" if below else "no")
    return table


def _totals(evaluation: Evaluation) -> Table:
    table = _table("the slot", "quantity", "value")
    terms = {f"  {name.replace('_', ' ')}, W": f"{power:.2f}" for name, power in evaluation.power_terms_w.items()}
    rows = {
        "sum rate, Mbit/s": f"{evaluation.sum_rate_bps / 1e6:.4f}",
        "fair rate, Mbit/s": f"{evaluation.fair_rate_bps / 1e6:.4f}",
        "HFI": f"{evaluation.hfi:.4f}",
        "JFI": f"{evaluation.jfi:.4f}",
        "transmit power, dBm": f"{10 * math.log10(evaluation.transmit_power_w) + 30:.2f}"
        if evaluation.transmit_power_w > 0
        else "-",
        "noise, dBm": f"{10 * math.log10(evaluation.noise_w) + 30:.2f}",
        "vehicle's power, W": f"{evaluation.power_w:.2f}",
        **terms,
        "energy, J": f"{evaluation.energy_j:.2f}",
        "reward": f"{evaluation.reward:.4f}",
    }
    for name, value in rows.items():
        table.add_row(name, value)
    return table


def _table(title: str, first: str, *others: str) -> Table:
    table = Table(title=title, title_justify="left")
    table.add_column(first)
    for name in others:
        table.add_column(name, justify="left" if name == "region" else "right")
    return table
