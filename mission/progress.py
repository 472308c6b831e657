"""What a mission looks like while it flies: one live panel in a terminal, a few plain lines elsewhere."""

import contextlib

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from bus.messages import LinkReport, MissionEvent, SlotOpened, VehicleState

QUIET_SLOTS = 5
"""Outside a terminal every so many slots make a line."""


class FlightView:
    """Shows what its vehicles' views collect; all calls from one thread."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._live = Live(console=console, auto_refresh=False, transient=True) if console.is_terminal else None
        self._vehicles: dict[str, VehicleView] = {}

    def __enter__(self) -> "FlightView":
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.stop()

    @property
    def live(self) -> bool:
        """Whether there is a panel."""
        return self._live is not None

    def vehicle(self, name: str, label: str) -> "VehicleView":
        """The view of one vehicle; `label` begins its lines."""
        self._vehicles[name] = VehicleView(self, label)
        return self._vehicles[name]

    def show(self) -> None:
        """Draw what has come since."""
        if self._live is not None:
            with contextlib.suppress(OSError):
                self._live.update(self.panel(), refresh=True)

    def note(self, text: str) -> None:
        """A line worth reading; in a terminal it stays above the panel. Output that is full or gone ends no flight."""
        with contextlib.suppress(OSError):
            self._console.print(text, highlight=False, markup=False, soft_wrap=True)

    def result(self, table: RenderableType) -> None:
        """What came of it."""
        with contextlib.suppress(OSError):
            self._console.print(table)

    def panel(self) -> RenderableType:
        """All that is known: of one vehicle in full, of several a line each."""
        if len(self._vehicles) == 1:
            (only,) = self._vehicles.values()
            return only.panel()
        table = Table("vehicle", "phase", "slot", "east", "north", "up", "mode", "battery", "rates", box=None)
        for name, view in self._vehicles.items():
            table.add_row(name, *view.row())
        return table


class VehicleView:
    """Collects what the bus says of one vehicle."""

    def __init__(self, flight: FlightView, label: str) -> None:
        self._flight, self._label = flight, label
        self._phase = "starting"
        self._state: VehicleState | None = None
        self._slot: SlotOpened | None = None
        self._link: LinkReport | None = None

    def note(self, text: str) -> None:
        """A line about this vehicle."""
        self._flight.note(self._label + text)

    def event(self, event: MissionEvent) -> None:
        if event.kind == "phase":
            self._phase = event.text
            if not self._flight.live:
                self._timed(event.time_s, event.text)
        elif event.kind != "ended":
            self._timed(event.time_s, f"{event.kind}: {event.text}")

    def state(self, state: VehicleState) -> None:
        self._state = state

    def slot(self, slot: SlotOpened) -> None:
        self._slot = slot

    def link(self, link: LinkReport) -> None:
        self._link = link
        if not self._flight.live and (link.slot + 1) % QUIET_SLOTS == 0:
            rates = " ".join(f"{rate / 1e3:.0f}" for rate in link.rate_bps)
            total = self._slot.slots if self._slot else 0
            self._timed(link.time_s, f"slot {link.slot + 1} of {total}: {rates} kbit/s, {self._battery}")

    def panel(self) -> RenderableType:
        """All of it."""
        grid = Table.grid(padding=(0, 2))
        grid.add_column(style="dim", justify="right")
        grid.add_column()
        grid.add_row("phase", Text(self._phase, style="bold"))
        if self._slot is not None:
            bar = ProgressBar(total=self._slot.slots, completed=self._slot.slot, width=40)
            grid.add_row("slot", Group(Text(f"{self._slot.slot} of {self._slot.slots}"), bar))
        if self._state is not None:
            east, north, up = self._state.position_enu
            where = f"{east:7.1f} m east  {north:7.1f} m north  {up:6.1f} m up   {self._state.mode}"
            grid.add_row("vehicle", f"{where}   {self._battery}")
        if self._link is not None:
            grid.add_row("rates", self._rates())
        return grid

    def row(self) -> tuple[RenderableType, ...]:
        """The same in one line: phase, slot, east, north, up, mode, battery, rates."""
        slot = f"{self._slot.slot} of {self._slot.slots}" if self._slot else ""
        where = [f"{metres:.1f}" for metres in self._state.position_enu] if self._state else [""] * 3
        mode = self._state.mode if self._state else ""
        battery = self._battery.removeprefix("battery ") if self._state else ""
        return Text(self._phase, style="bold"), slot, *where, mode, battery, self._rates()

    def _timed(self, time_s: float, text: str) -> None:
        self._flight.note(f"{time_s:8.1f} s  {self._label}{text}")

    @property
    def _battery(self) -> str:
        remaining = self._state.battery_remaining if self._state else None
        return "battery unknown" if remaining is None else f"battery {remaining:.0%}"

    def _rates(self) -> Text:
        rates = Text()
        if self._link is not None:
            for rate, below in zip(self._link.rate_bps, self._link.below_qos, strict=True):
                rates.append(f"{rate / 1e3:7.0f} ", style="red" if below else "green")
            rates.append(" kbit/s", style="dim")
        return rates
