"""AVAILABLE_MODES: the modes of this vehicle, for ground stations that know none by heart."""

from sitl.links.frames import pack
from sitl.links.link import Link
from sitl.personality import Result
from sitl.vehicle import Vehicle


def available_modes(v: Vehicle, link: Link, index: float) -> Result:
    """REQUEST_MESSAGE of AVAILABLE_MODES: param2 is the mode's index from 1 on, 0 all of them."""
    modes = v.personality.modes
    if index not in range(len(modes) + 1):
        return Result.DENIED
    for number, mode in enumerate(modes, 1):
        if index in (0, number):
            link.send(
                pack(
                    "AVAILABLE_MODES",
                    number_modes=len(modes),
                    mode_index=number,
                    standard_mode=mode.standard,
                    custom_mode=mode.custom_mode,
                    properties=0,
                    mode_name=mode.name.encode(),
                )
            )
    return Result.ACCEPTED
