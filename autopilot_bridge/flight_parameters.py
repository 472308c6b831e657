"""Parameters set for one flight: in the journal first, then on the autopilot, and put back after it."""

from collections.abc import Callable, Mapping

from autopilot_bridge.parameter_journal import Change, ParameterJournal, same
from autopilot_bridge.vehicle import SilentError, Vehicle, VehicleError

Tell = Callable[[str, str], None]
"""Takes an event's kind and its text."""


class FlightParameters:
    """Sets and puts back. All calls take vehicle time."""

    def __init__(self, vehicle: Vehicle, journal: ParameterJournal | None, tell: Tell) -> None:
        """Without a journal nothing is put back."""
        self._vehicle, self._journal, self._tell = vehicle, journal, tell

    def set(self, name: str, value: float, why: str = "") -> None:
        """Raises VehicleError when it is unknown or refused, JournalError when it could not be remembered."""
        before = self._vehicle.parameter(name)
        if same(before, value):
            return
        if self._journal is not None:
            self._journal.changing(name, before, value)
        self._vehicle.set_parameter(name, value)
        self._tell("parameter", f"{name} was {before:g}{why}: set to {value:g}")

    @property
    def outstanding(self) -> Mapping[str, Change]:
        """What is to be put back, by name."""
        return {} if self._journal is None else dict(self._journal.outstanding)

    def close(self) -> None:
        if self._journal is not None:
            self._journal.close()

    def put_back(self) -> None:
        """Only on the ground and disarmed; what cannot be put back is told and stays in the journal.

        Raises SilentError, JournalError.
        """
        for name, change in self.outstanding.items():
            if self._vehicle.telemetry.armed:
                self.leave("the vehicle is armed")
                return
            try:
                self._put_back(name, change)
                self._settled(name)
            except SilentError:
                raise
            except VehicleError as error:
                self._tell("error", f"{name} could not be put back to {change.before:g}: {error}")

    def leave(self, why: str) -> None:
        """Tell what stays as it was set for the flight."""
        left = [f"{name} (was {change.before:g})" for name, change in self.outstanding.items()]
        if left:
            self._tell("error", f"not put back, {why}: {', '.join(left)}; the next flight of this vehicle does it")

    def _put_back(self, name: str, change: Change) -> None:
        """What somebody else has set meanwhile is theirs."""
        found = self._vehicle.parameter(name)
        if same(found, change.before):
            pass  # it was never set, or an autopilot that forgets has started anew
        elif any(same(found, value) for value in change.values):
            self._vehicle.set_parameter(name, change.before)
            self._tell("parameter", f"{name} put back to {change.before:g}")
        else:
            self._tell("parameter", f"{name} is {found:g} by somebody else's hand, not {change.values[-1]:g}: left so")

    def _settled(self, name: str) -> None:
        if self._journal is not None:
            self._journal.settled(name)
