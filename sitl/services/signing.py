"""SETUP_SIGNING: a new key for all links of the vehicle.

Taken from any link while there is no key (all are loopback), and after that only when signed with the key in force,
which the network has checked before. Never while armed: a vehicle in flight must not lose its pilot.
"""

from sitl.links.frames import Message
from sitl.links.link import Link
from sitl.personality import WARNING
from sitl.vehicle import Vehicle


def setup_signing(v: Vehicle, link: Link, message: Message) -> None:
    """A key and a timestamp of zeros end signing. Not acknowledged, as the protocol has it; the log tells."""
    try:
        if message.target_system != link.system:
            raise ValueError("for everybody")
        if v.commander.armed:
            raise ValueError("armed")
        link.signing.set_up(bytes(message.secret_key), message.initial_timestamp)
    except ValueError as error:
        link.counters["key refused"] += 1
        v.commander.say(f"Signing key refused: {error}", WARNING)
        return
    v.commander.say("Signing key set" if link.signing.active else "Signing ended")
