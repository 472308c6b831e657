"""The failure matrix: one row for each fault, which its test flies and docs/safety.md shows.

A row says what is expected; `judge` holds a flight to it by what was recorded and by a witness of the truth.
"""

from dataclasses import dataclass, field
from enum import StrEnum

from bus import topics


class End(StrEnum):
    """Where the vehicle is at the end."""

    HOLDING = "holding"
    HOME = "home"
    LANDED = "landed inside the fence"
    DOWN = "on the ground"
    """Outside causes only: maybe outside the fence, brought there by the autopilot alone."""


HOME_M = 2.0
"""So near to where it took off it is home."""
STILL_MPS = 0.5
LOGGED_S = 1.0
"""What is older than this at the moment of the fault must be on disk."""
ARMED = 128
"""Of HEARTBEAT.base_mode."""


@dataclass(frozen=True)
class Row:
    """One fault."""

    fault: str
    injected: str
    detected: str
    vehicle: str
    """What it does meanwhile."""
    ends: tuple[End, ...]
    codes: tuple[int, ...]
    """Exit codes of the bridge, or of `fly` where there is a bridge no more."""
    told: tuple[tuple[str, str], ...] = ()
    """Events that must be in the MCAP: kind, and what the text holds."""
    personalities: tuple[str, ...] = field(default=("px4",))

    @property
    def markdown(self):
        """Its line in docs/safety.md."""
        told = ", ".join(f"`{kind}` {text}" if text else f"`{kind}`" for kind, text in self.told)
        cells = (
            self.fault,
            self.injected,
            self.detected,
            self.vehicle,
            " or ".join(self.ends),
            " or ".join(map(str, self.codes)),
            told,
            ", ".join(self.personalities),
        )
        return f"| {' | '.join(cells)} |"


HEADER = (
    "| fault | injected how | detected in | meanwhile the vehicle | ends | exit | logged, besides `phase` | with |",
    "| --- | --- | --- | --- | --- | --- | --- | --- |",
)
BOTH = ("px4", "arducopter")
DOWN = (End.HOME, End.LANDED)

_TABLE = (
    Row(
        "MAVLink loss 10 %",
        "each datagram lost by chance, both ways, from slot 2 on",
        "nobody's: setpoints come at 20 Hz",
        "flies on",
        (End.LANDED,),
        (0,),
    ),
    Row(
        "MAVLink loss 30 %",
        "as above",
        "nobody's; commands are repeated until telemetry shows them",
        "flies on",
        (End.LANDED,),
        (0,),
    ),
    Row(
        "MAVLink loss 60 %",
        "as above",
        "as above",
        "flies on, or the autopilot's failsafe brings it home",
        DOWN,
        (0, 3),
        personalities=BOTH,
    ),
    Row(
        "MAVLink duplicate",
        "each datagram twice, both ways",
        "nobody's",
        "flies on",
        (End.LANDED,),
        (0,),
    ),
    Row(
        "MAVLink reorder",
        "every other datagram after the next one, both ways",
        "nobody's",
        "flies on",
        (End.LANDED,),
        (0,),
    ),
)
_TABLE += (
    Row(
        "GPS loss",
        "`inject gps_loss` in slot 2, for good",
        "the autopilot's estimator, after 5 s (ArduCopter 11 s)",
        "flies on by dead reckoning, then descends; no setpoints",
        (End.DOWN,),
        (3,),
        (("mode", "obeyed"),),
        BOTH,
    ),
    Row(
        "battery low",
        "`inject battery` below what the autopilot calls critical, in slot 2",
        "the autopilot's battery failsafe",
        "holds for the autopilot's 5 s (ArduCopter at once), returns; no setpoints",
        (End.HOME,),
        (3,),
        (("mode", "obeyed"),),
        BOTH,
    ),
    Row(
        "fence breach by wind",
        "`inject wind`, more than the vehicle can stand against, for 30 s from slot 2 on",
        "bridge, 1 m outside the fence",
        "is blown out; the autopilot returns as far as it can; no setpoints",
        (End.HOME,),
        (3,),
        (("failsafe", "outside the fence"),),
        BOTH,
    ),
    Row(
        "a motor fails",
        "`inject motor 1 fail` in slot 2",
        "the ground",
        "falls",
        (End.DOWN,),
        (3,),
        (),
        BOTH,
    ),
)
_TABLE += (
    Row(
        "MAVLink delay 500 ms",
        "a UDP relay holds each datagram back for 500 ms, both ways, from slot 2 on",
        "nobody's",
        "flies on",
        (End.LANDED,),
        (0,),
    ),
    Row(
        "link dead 3 s",
        "a UDP relay passes nothing, both ways",
        "PX4: COM_OF_LOSS_T; bridge: no position for 1 s",
        "flies its last velocity until PX4 notices, returns; no setpoints from 1.5 s on",
        (End.HOME,),
        (3,),
        (("ladder", "-> HOLD_MODE"), ("mode", "obeyed")),
    ),
    Row(
        "link dead 3 s (ArduCopter)",
        "as above",
        "bridge: no position for 1 s; ArduCopter: GUID_TIMEOUT",
        "flies its last velocity, stands; no setpoints from 1.5 s on; goes on when the mode is known anew",
        (End.LANDED,),
        (0,),
        (("ladder", "-> HOLD_MODE"),),
        ("arducopter",),
    ),
    Row(
        "link dead 10 s",
        "as above",
        "PX4: COM_OF_LOSS_T, ArduCopter: GUID_TIMEOUT, FS_GCS_TIMEOUT; bridge: no position for 1 s",
        "returns by its autopilot's failsafe, obeyed when the link is back",
        (End.HOME,),
        (3,),
        (("ladder", "-> HOLD_MODE"),),
        BOTH,
    ),
    Row(
        "link dead 60 s",
        "as above",
        "as above, and silence of 3 s on the wall clock",
        "as above",
        (End.HOME,),
        (3,),
        (("failsafe", "no telemetry for 3 s"),),
        BOTH,
    ),
    Row(
        "autopilot's MAVLink side restarted in flight",
        "a UDP relay: time since boot from 0, sequence numbers and rates as at power-on; the airframe flies on",
        "bridge: the clock went back",
        "its autopilot's failsafe acts; no setpoints",
        (End.HOME,),
        (3,),
        (("failsafe", "clock went back"),),
        personalities=BOTH,
    ),
    Row(
        "autopilot's clock jumps 5 s back",
        "a UDP relay: time since boot 5 s less",
        "bridge: the clock went back",
        "as above",
        (End.HOME,),
        (3,),
        (("failsafe", "clock went back"),),
    ),
    Row(
        "autopilot's clock jumps 5 s ahead",
        "a UDP relay: time since boot 5 s more",
        "bridge: steps skipped, counted",
        "holds for want of actions in slots that were over at once, flies on",
        (End.LANDED,),
        (0,),
    ),
)
_TABLE += (
    Row(
        "agent sending NaN",
        "actions of NaN, of infinity and of no JSON at all in slots 2 to 5",
        "bridge: the message's schema",
        "holds, then flies on",
        (End.LANDED,),
        (0,),
        (("slot", "rejected: malformed action"),),
    ),
    Row(
        "agent sending NaN for good",
        "actions of NaN from slot 2 on",
        "as above, and the grace",
        "holds, returns",
        (End.HOME,),
        (3,),
        (("slot", "rejected: malformed action"), ("failsafe", "no good action")),
        BOTH,
    ),
    Row(
        "zenoh session lost and back",
        "a TCP relay between the bridge's session and the others' is cut for 1 s in slot 2",
        "liveliness token, deadline",
        "holds, then flies on",
        (End.LANDED,),
        (0,),
        (("node_lost", "agent"), ("node_back", "agent")),
    ),
    Row(
        "zenoh session lost for good",
        "the relay is cut in slot 2",
        "liveliness token, deadline, grace",
        "holds, returns",
        (End.HOME,),
        (3,),
        (("node_lost", "agent"), ("failsafe", "no good action")),
    ),
)
for _node, _seen in (("agent", "liveliness token"), ("rf", "liveliness token; the agent is silent without channels")):
    _TABLE += (
        Row(
            f"{_node} killed",
            "SIGKILL in slot 2",
            _seen,
            "holds until it is started again and answers, flies on",
            (End.LANDED,),
            (0,),
            (("node_lost", _node), ("node_back", _node)),
        ),
        Row(
            f"{_node} killed, not to be started again",
            "SIGKILL in slot 2, `restart: never`",
            _seen + ", grace",
            "holds, returns",
            (End.HOME,),
            (3,),
            (("node_lost", _node), ("failsafe", "no good action")),
        ),
        Row(
            f"{_node} frozen",
            "SIGSTOP in slot 2, SIGCONT on the way home",
            "deadline, grace",
            "holds, returns",
            (End.HOME,),
            (3,),
            (("failsafe", "no good action"),),
        ),
        Row(
            f"{_node} slow",
            "in slots 2 to 5 SIGSTOP but for one answer after half of the slot",
            "deadline",
            "holds, then flies on",
            (End.LANDED,),
            (0,),
            (("slot", "late"),),
        ),
    )
_TABLE += (
    Row(
        "rf sending malformed",
        "rf node stopped in slots 2 to 5, nonsense on `rf/csi` in its place",
        "agent: the message's schema, its sizes; bridge: deadline",
        "holds, then flies on",
        (End.LANDED,),
        (0,),
        (("slot", "missing"),),
    ),
)
_TABLE += (
    Row(
        "bridge killed",
        "SIGKILL in slot 2",
        "PX4: COM_OF_LOSS_T; ArduCopter: GUID_TIMEOUT, FS_GCS_TIMEOUT; `fly`: its process is gone",
        "PX4 returns; ArduCopter brakes after 3 s, returns after 5 s",
        (End.HOME,),
        (3,),
        personalities=BOTH,
    ),
    Row(
        "bridge frozen",
        "SIGSTOP in slot 2, for good",
        "as above; `fly`: its autopilot has landed",
        "as above",
        (End.HOME,),
        (3,),
        personalities=BOTH,
    ),
    Row(
        "bridge frozen for 10 s",
        "SIGSTOP in slot 2, SIGCONT 10 s later",
        "as above; the bridge: it has not listened for 0.5 s",
        "as above; no setpoint after it woke",
        (End.HOME,),
        (3,),
        (("mode", "obeyed"),),
        BOTH,
    ),
    Row(
        "mission process killed",
        "SIGKILL in slot 2",
        "nobody's: nobody needs it",
        "flies on",
        (End.LANDED,),
        (0,),
    ),
    Row(
        "disk full",
        "RLIMIT_FSIZE 0 for all of our processes in slot 2: every write fails",
        "write error; `fly`: recording stopped",
        "flies on",
        (End.LANDED,),
        (1,),
    ),
)
ROWS = {row.fault: row for row in _TABLE}


def judge(row, witness, log, frames, fence_m, code, fault_s):
    """Hold a flight to its row: where the vehicle truly is, the exit code, what was told, what the logs still hold.

    `log` is the MCAP, `frames` are the tlog's, `fault_s` is the vehicle time of the fault. A simulator that its bridge
    ends as soon as it hears the disarming may be gone before the witness hears it: the autopilot's last HEARTBEAT in
    the tlog counts too.
    """
    told = [(event.kind, event.text) for event in log.messages(topics.EVENT)]
    end = witness.last
    beats = [frame for frame in frames if frame.get_type() == "HEARTBEAT" and frame.get_srcSystem() == 1]
    down = end.landed and not (end.armed and beats[-1].base_mode & ARMED)
    inside = max(map(abs, end.position_enu[:2])) <= fence_m
    found = {
        End.HOLDING: end.armed and not end.landed and end.speed_mps < STILL_MPS and inside,
        End.HOME: down and end.from_home_m < HOME_M,
        End.LANDED: down and inside,
        End.DOWN: down,
    }
    assert any(found[wanted] for wanted in row.ends), f"not {row.ends}: {end}; {told}"
    assert code in row.codes, f"exit {code}; {told}"
    for kind, text in row.told:
        assert any(kind == k and text in t for k, t in told), f"{kind} {text!r} was not told: {told}"
    recorded = [state.time_s for state in log.messages(topics.STATE)]
    heard = [frame.time_boot_ms / 1000 for frame in frames if frame.get_type() == "LOCAL_POSITION_NED"]
    for name, times in (("MCAP", recorded), ("tlog", heard)):
        newest = max((time_s for time_s in times if time_s <= fault_s), default=0.0)
        assert newest >= fault_s - LOGGED_S, f"{name}: nothing between {newest:.1f} s and the fault at {fault_s:.1f} s"
