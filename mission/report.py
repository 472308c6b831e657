"""What a flight came to, from its run folder alone: `report.json`, the table and the picture."""

import importlib
import math
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from bus import topics
from bus.messages import LinkReport, Vec3
from mission.flight_log import FlightLog, read
from mission.flyability import Flyability, Total, flyability
from mission.mission_file import Mission, load
from mission.proof_log import Setpoints, setpoints

FILE_NAME = "report.json"
PICTURE_NAME = "report.png"


class User(msgspec.Struct, frozen=True):
    """One user over the flight."""

    region: str
    """Side of the panel at the first slot."""
    mean_rate_bps: float
    below_qos: float
    """Share of the slots with less than the QoS rate, 0 to 1."""


class Displacement(msgspec.Struct, frozen=True):
    """Sum over the slots of the length of each slot's displacement [m]."""

    commanded_m: float
    planned_m: float
    flown_m: float


class Report(msgspec.Struct, frozen=True):
    """Means are over the slots that were reported."""

    mission: str
    seed: int | None
    vehicle: str
    exit_code: int | None
    """What the bridge ended with; None when it never said."""
    ended: str
    """The bridge's last words."""
    slots: int
    slots_planned: int
    users: list[User]
    qos_bps: float
    hfi: float
    """Mean harmonic fairness index."""
    jfi: float
    """Mean Jain's fairness index."""
    sum_rate_bps: float
    """Mean over the slots."""
    energy_j: float
    power_w: float
    """Mean over the slots."""
    efficiency_bit_per_j: float
    """Sum of the rates over sum of the power."""
    reward: float
    """Sum over the slots."""
    displacement: Displacement
    actions: dict[str, int]
    """Slots by what became of their action: flown, clipped, late, missing, rejected."""
    configurations: dict[str, int]
    """Slots by where the surface's configuration came from: action, held, default, closed_form, optimised."""
    ris: str | None
    """The mission's `ris.mode`; None without a mission file."""
    flyability: Flyability | None
    """None without a mission file, which says what world it was, and without slots."""
    setpoints: Setpoints | None
    """None in recordings from before there were any."""
    restarts: int
    """Nodes that came back after they were lost."""
    log_complete: bool
    log_lost_bytes: int


def summarise(run: Path, log: FlightLog, mission: Mission | None) -> Report:
    """Compute the report of a recorded flight; every number is 0 when no slot was flown."""
    links = [report for _, report in sorted(log.by_slot(topics.LINK).items())]
    opened = log.by_slot(topics.SLOT)
    flown = [slot.flown for slot in opened.values() if slot.flown is not None]
    events = log.messages(topics.EVENT)
    ends = [event for event in events if event.kind == "ended"]
    return Report(
        mission=mission.name if mission else run.resolve().name,
        seed=mission.seed if mission else None,
        vehicle=log.vehicle,
        exit_code=ends[-1].exit_code if ends else None,
        ended=ends[-1].text if ends else "the log holds no end of the flight",
        slots=len(links),
        slots_planned=max((slot.slots for slot in opened.values()), default=0),
        users=_users(links),
        qos_bps=links[0].qos_bps if links else 0.0,
        hfi=_mean(link.hfi for link in links),
        jfi=_mean(link.jfi for link in links),
        sum_rate_bps=_mean(link.sum_rate_bps for link in links),
        energy_j=sum(link.energy_j for link in links),
        power_w=_mean(link.power_w for link in links),
        efficiency_bit_per_j=_ratio(
            sum(link.sum_rate_bps for link in links),
            sum(link.power_w for link in links),
        ),
        reward=sum(link.reward for link in links),
        displacement=Displacement(
            commanded_m=_length(slot.commanded_enu for slot in flown),
            planned_m=_length(slot.planned_enu for slot in flown),
            flown_m=_length(slot.flown_enu for slot in flown),
        ),
        actions=dict(Counter(slot.outcome for slot in flown)),
        configurations=dict(Counter(link.configuration for link in links)),
        ris=mission.ris.mode if mission else None,
        flyability=flyability(log, mission) if mission else None,
        setpoints=setpoints(log),
        restarts=sum(event.kind == "node_back" for event in events),
        log_complete=log.complete,
        log_lost_bytes=log.lost_bytes,
    )


def table(report: Report) -> RenderableType:
    """The report as shown after a flight."""
    total = Table(show_header=False)
    total.add_column()
    total.add_column(justify="right")
    for name, value in _slot_rows(report) if report.slots else ():
        total.add_row(name, value)
    if report.setpoints is not None:
        for name, value in _setpoint_rows(report.setpoints):
            total.add_row(name, value)
    if report.slots and report.flyability is None:
        why = "no mission.yaml" if report.seed is None else "no slot was recorded whole and flown by us"
        total.add_row("flyability", f"unknown: {why}")
    if not report.log_complete:
        total.add_row("recording cut short", f"{report.log_lost_bytes} bytes unreadable")
    none = f"{report.mission}: no slot was flown; the flight ended with: {report.ended}"
    parts: list[RenderableType] = [_users_table(report) if report.slots else Text(none)]
    if total.row_count:
        parts.append(total)
    if report.flyability is not None:
        parts.append(_flyability_table(report.flyability))
        left_out = report.flyability.left_out
        if left_out:
            parts.append(f"left out: {len(left_out)} slots that somebody else flew, the first is {left_out[0]}")
        if report.flyability.difference:
            parts.append(f"flyability cannot be trusted: {report.flyability.difference}")
    if report.setpoints is not None:
        parts += [f"proof log: {line}" for line in report.setpoints.contradictions]
    return Group(*parts)


def _users_table(report: Report) -> Table:
    users = Table(title=f"{report.mission}: {report.slots} of {report.slots_planned} slots", title_justify="left")
    users.add_column("user", justify="right")
    users.add_column("side at the start")
    users.add_column("mean rate, kbit/s", justify="right")
    users.add_column(f"slots below {report.qos_bps / 1e3:g} kbit/s", justify="right")
    for number, user in enumerate(report.users):
        users.add_row(str(number), user.region, f"{user.mean_rate_bps / 1e3:.0f}", f"{user.below_qos:.0%}")
    return users


def _slot_rows(report: Report) -> Iterator[tuple[str, str]]:
    moved = report.displacement
    yield from (
        ("harmonic fairness index", f"{report.hfi:.3f}"),
        ("sum rate", f"{report.sum_rate_bps / 1e6:.3f} Mbit/s"),
        ("energy", f"{report.energy_j / 1e3:.2f} kJ ({report.power_w:.0f} W)"),
        ("efficiency", f"{report.efficiency_bit_per_j / 1e3:.2f} kbit/J"),
        (
            "surface set by",
            f"{report.ris or 'unknown'}: "
            + ", ".join(f"{source} {slots}" for source, slots in report.configurations.items()),
        ),
        (
            "displacement commanded / planned / flown",
            f"{moved.commanded_m:.1f} / {moved.planned_m:.1f} / {moved.flown_m:.1f} m",
        ),
        (
            "actions rejected / clipped / late / missing",
            " / ".join(str(report.actions.get(outcome, 0)) for outcome in ("rejected", "clipped", "late", "missing")),
        ),
    )


def _setpoint_rows(sent: Setpoints) -> Iterator[tuple[str, str]]:
    yield "setpoints", str(sent.number)
    if sent.clipped:
        yield "setpoints clipped", ", ".join(f"{reason} {number}" for reason, number in sent.clipped.items())
    action = "none" if sent.max_action_age_s is None else f"{sent.max_action_age_s:.2f}"
    yield (
        "longest interval / action age / state age",
        f"{sent.longest_interval_s:.2f} / {action} / {sent.max_state_age_s:.2f} s",
    )


def _flyability_table(flyable: Flyability) -> Table:
    """What the flight would have been worth where it was sent, planned and flown."""
    anew = "" if flyable.anew_by is None else f", or set anew ({flyable.anew_by.replace('_', ' ')})"
    shown = Table(title=f"flyability: {flyable.slots} slots, surface as set in flight{anew}", title_justify="left")
    shown.add_column("")
    for column in ("commanded", "planned", "flown", "lost to\nlimits", "lost to\ntracking"):
        shown.add_column(column, justify="right")

    def row(name: str, total: Total, unit: float, digits: int) -> None:
        numbers = (total.commanded, total.planned, total.flown, total.lost_to_limits, total.lost_to_tracking)
        shown.add_row(name, *(f"{number / unit:.{digits}f}" for number in numbers))

    shown.add_row("distance, m RMS", "", "", "", f"{flyable.limits_rms_m:.2f}", f"{flyable.tracking_rms_m:.2f}")
    for how, worth in (("as set", flyable.as_set), ("anew", flyable.anew)):
        if worth is not None:
            row(f"rate {how}, Mbit/s", worth.rate_bps, 1e6, 3)
            row(f"reward {how}", worth.reward, 1.0, 2)
    row("energy, kJ", flyable.energy_j, 1e3, 2)
    return shown


def prepare() -> None:
    """Import what `write` needs for flyability and picture: that takes 2 s, which may pass while the vehicle lands."""
    for name in ("mission.figures", "rf_model.slot_radio", "rf_model.reference.uncompiled"):
        importlib.import_module(name)


def write(run: Path) -> Report:
    """Read a run folder and write `report.json` and, when a slot was flown, `report.png` into it.

    Raises FlightLogError when there is no log, MissionError when its mission.yaml is broken, OSError when the folder
    cannot be written; a file is then as it was before.
    """
    log = read(run)
    mission = _mission(run)
    report = summarise(run, log, mission)
    text = msgspec.json.format(msgspec.json.encode(report)) + b"\n"
    with _replacing(run / FILE_NAME) as part:
        part.write_bytes(text)
    if report.slots:
        from mission.figures import draw  # matplotlib takes a second to import

        with _replacing(run / PICTURE_NAME) as part:
            draw(log, report, mission.scenario if mission else None, part)
    return report


@contextmanager
def _replacing(path: Path) -> Iterator[Path]:
    """Where to write what is to become `path` when it is whole."""
    part = path.with_name(f"{path.name}.part")
    try:
        yield part
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def _mission(run: Path) -> Mission | None:
    """The resolved mission; None when it is not there (a recording without the launcher)."""
    path = run / "mission.yaml"
    return load(path) if path.is_file() else None


def _users(links: list[LinkReport]) -> list[User]:
    if not links:
        return []
    return [
        User(
            region=region,
            mean_rate_bps=_mean(link.rate_bps[user] for link in links),
            below_qos=_mean(float(link.below_qos[user]) for link in links),
        )
        for user, region in enumerate(links[0].regions)
    ]


def _mean(values: Iterable[float]) -> float:
    listed = list(values)
    return math.fsum(listed) / len(listed) if listed else 0.0


def _ratio(numerator: float, denominator: float) -> float:
    return numerator / denominator if denominator > 0 else 0.0


def _length(displacements: Iterable[Vec3]) -> float:
    return math.fsum(math.hypot(*vector) for vector in displacements)
