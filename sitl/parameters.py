"""The vehicle's parameters by name: what may be set, what is held, how a value travels."""

import math
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from difflib import get_close_matches

INT8, INT16, INT32, REAL32 = 2, 4, 6, 9
"""MAV_PARAM_TYPE."""


class ParameterError(ValueError):
    """An unknown name or a value that is not allowed; the text names both and says what is."""


@dataclass(frozen=True)
class Parameter:
    """One parameter and the values it may take."""

    name: str
    default: float
    low: float
    high: float
    mav_type: int
    """MAV_PARAM_TYPE."""
    among: tuple[int, ...] = ()
    """Allowed values of an enumeration; empty = all in [low, high]."""

    @property
    def integer(self) -> bool:
        return self.mav_type != REAL32

    def checked(self, value: float) -> float:
        """The value as it will be held (float32, or a whole number). Raises ParameterError."""
        allowed = f"one of {', '.join(map(str, self.among))}" if self.among else f"{self.low:g} to {self.high:g}"
        if not math.isfinite(value) or (self.integer and value != int(value)):
            raise ParameterError(f"parameter {self.name}: {value:g} is not allowed, {allowed} is")
        if (self.among and int(value) not in self.among) or not self.low <= value <= self.high:
            raise ParameterError(f"parameter {self.name}: {value:g} is not allowed, {allowed} is")
        return float(int(value)) if self.integer else float(struct.unpack("<f", struct.pack("<f", value))[0])


class Parameters:
    """The values of a table of parameters, in alphabetical order."""

    def __init__(self, table: Iterable[Parameter]) -> None:
        self._known = {parameter.name: parameter for parameter in sorted(table, key=lambda p: p.name)}
        self._values = {name: parameter.checked(parameter.default) for name, parameter in self._known.items()}
        self.names = list(self._known)
        self.changes = 0
        """Grows with every change, so that what is derived from parameters knows when to follow."""

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self._known.values())

    def __contains__(self, name: str) -> bool:
        return name in self._known

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def parameter(self, name: str) -> Parameter:
        """Raises ParameterError when there is no such parameter."""
        if name not in self._known:
            near = get_close_matches(name.upper(), self.names, n=3, cutoff=0.0)
            raise ParameterError(f"parameter {name}: unknown name; nearest are {', '.join(near)}")
        return self._known[name]

    def set(self, name: str, value: float) -> None:
        """Raises ParameterError for an unknown name or a value that is not allowed; nothing changes then."""
        self._values[name] = self.parameter(name).checked(value)
        self.changes += 1

    def assign(self, assignment: str) -> None:
        """`NAME=VALUE` from a command line. Raises ParameterError."""
        name, equals, text = assignment.partition("=")
        parameter = self.parameter(name.strip()) if equals else None
        if parameter is None:
            raise ParameterError(f"parameter: {assignment!r} is not NAME=VALUE")
        try:
            value = float(text)
        except ValueError:
            raise ParameterError(f"parameter {parameter.name}: {text!r} is not a number") from None
        self.set(parameter.name, value)


def to_wire(parameter: Parameter, value: float, bytewise: bool) -> bytes:
    """PARAM_VALUE.param_value, 4 bytes: an integer's own bytes (`bytewise`, PX4), or its value as a float."""
    return struct.pack("<i", int(value)) if parameter.integer and bytewise else struct.pack("<f", value)


def from_wire(parameter: Parameter, wire: bytes, bytewise: bool) -> float:
    """The other way round."""
    return float(struct.unpack("<i" if parameter.integer and bytewise else "<f", wire)[0])
