"""The local origin on the globe: a flat map about the start, good for a few kilometres."""

import math
from dataclasses import dataclass

EARTH_RADIUS_M = 6371000.0
"""CONSTANTS_RADIUS_OF_EARTH in PX4."""


@dataclass(frozen=True)
class Origin:
    """Where local north, east, down are zero [deg, deg, m above mean sea level]."""

    latitude: float = 47.397743
    longitude: float = 8.545594
    altitude: float = 489.4

    def globe(self, north: float, east: float) -> tuple[float, float]:
        """Latitude and longitude [deg] of a local point."""
        around = EARTH_RADIUS_M * math.cos(math.radians(self.latitude))
        longitude = self.longitude + math.degrees(east / around)
        return self.latitude + math.degrees(north / EARTH_RADIUS_M), math.remainder(longitude, 360.0)

    def local(self, latitude: float, longitude: float) -> tuple[float, float]:
        """North and east [m] of a point on the globe."""
        around = EARTH_RADIUS_M * math.cos(math.radians(self.latitude))
        return (
            math.radians(latitude - self.latitude) * EARTH_RADIUS_M,
            math.radians(math.remainder(longitude - self.longitude, 360.0)) * around,
        )


def read_origin(text: str) -> Origin:
    """`LAT,LON,ALT` of a command line. Raises ValueError with what is allowed."""
    try:
        latitude, longitude, altitude = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"{text!r} is not LAT,LON,ALT") from None
    if not (abs(latitude) <= 85.0 and abs(longitude) <= 180.0 and abs(altitude) <= 10000.0):
        raise ValueError(f"{text!r}: allowed are -85 to 85 deg, -180 to 180 deg, -10000 to 10000 m")
    return Origin(latitude, longitude, altitude)
