"""The failure matrix: one row for each fault, which a test flies and docs/safety.md shows.

A row says what is expected; `judge` holds a flight to it by a witness of the truth and by what was recorded.
`python -m tests.failure_matrix.rows` prints the table.
"""

from dataclasses import dataclass
from enum import StrEnum

from bus import topics


class End(StrEnum):
    """Where the vehicle is at the end."""

    HOME = "home"
    LANDED = "landed inside the fence"
    DOWN = "on the ground, maybe outside the fence"
    """Outside causes only: brought there by the autopilot alone."""


HOME_M = 2.0
"""So near to where it took off it is home."""
BREACH_M = 1.0
"""A fence is left when it is left by more than this: velocity loops are not ideal."""
LOGGED_S = 1.0
"""What is older than this at the moment of the fault must be on disk."""
ARMED = 128
"""Of HEARTBEAT.base_mode."""
BOTH = ("px4", "arducopter")


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
    """Exit codes of the bridge; of `fly` where a process is the fault's."""
    told: tuple[tuple[str, str], ...] = ()
    """Events that must be in the MCAP: kind, and what the text holds."""
    personalities: tuple[str, ...] = ("px4",)
    outside: bool = False
    """An outside cause, which may take it out of the fence."""

    @property
    def markdown(self):
        """Its line in docs/safety.md."""
        cells = (
            self.fault + ("" if self.personalities == BOTH else f" ({', '.join(self.personalities)})"),
            self.injected,
            self.detected,
            self.vehicle,
            " or ".join(self.ends),
            " or ".join(map(str, self.codes)),
            "; ".join(f"`{kind}`: {text}" for kind, text in self.told),
        )
        return f"| {' | '.join(cells)} |"


HEADER = (
    "| fault | injected how | detected in | meanwhile the vehicle | ends | exit | events told |",
    "| --- | --- | --- | --- | --- | --- | --- |",
)

_LADDER = (("ladder", "HOLD -> HOLD_MODE"), ("ladder", "HOLD_MODE -> RETURN"))
_NO_ACTION = "bridge: no good action, the ladder"


def _node(name, lost):
    return (
        Row(
            f"{name} killed",
            "SIGKILL in slot 2",
            f"bridge: its liveliness token; `fly`{lost}",
            "holds until it is started again and answers, flies on",
            (End.LANDED,),
            (0,),
            (("node_lost", name), ("node_back", name)),
        ),
        Row(
            f"{name} killed, not started again",
            "SIGKILL in slot 2, `restart: never`",
            f"as above; {_NO_ACTION}",
            "holds, returns",
            (End.HOME,),
            (3,),
            (("node_lost", name), *_LADDER),
        ),
        Row(
            f"{name} frozen",
            "SIGSTOP in slot 2, SIGCONT on the way home",
            f"{_NO_ACTION}{lost}",
            "holds, returns; what it says then is not flown",
            (End.HOME,),
            (3,),
            _LADDER,
        ),
        Row(
            f"{name} slow",
            "SIGSTOP from slot 2 on, but for four answers after half of their slots",
            f"bridge: the slot's deadline{lost}",
            "holds, then flies on",
            (End.LANDED,),
            (0,),
            (("slot", "late"),),
        ),
    )


def _loss(percent, detected, vehicle, ends, codes, personalities=("px4",)):
    return Row(
        f"MAVLink loss {percent} %",
        "each datagram lost by chance, both ways, from slot 2 on",
        detected,
        vehicle,
        ends,
        codes,
        (),
        personalities,
    )


_TABLE = (
    *_node("agent", ""),
    Row(
        "agent sending NaN",
        "actions of NaN, of infinity, and of no JSON at all in slots 2 to 5",
        "bridge: the message's schema",
        "holds, then flies on",
        (End.LANDED,),
        (0,),
        (("slot", "rejected: malformed action"),),
    ),
    Row(
        "agent sending NaN for good",
        "actions of NaN from slot 2 on",
        f"as above; {_NO_ACTION}",
        "holds, returns",
        (End.HOME,),
        (3,),
        (("slot", "rejected: malformed action"), *_LADDER),
        BOTH,
    ),
    *_node("rf", "; the agent is silent without channels"),
    Row(
        "rf sending malformed",
        "rf node stopped from slot 2 on, six kinds of nonsense on `rf/csi` in each of four slots in its place",
        "agent: the message's schema, its sizes; bridge: the slot's deadline",
        "holds, then flies on",
        (End.LANDED,),
        (0,),
        (("slot", "missing"),),
    ),
    Row(
        "bridge killed",
        "SIGKILL in slot 2",
        "PX4: COM_OF_LOSS_T; ArduCopter: GUID_TIMEOUT, FS_GCS_TIMEOUT; `fly`: its process is gone",
        "PX4 returns after 1 s; ArduCopter brakes after 1 s, returns after 5 s",
        (End.HOME,),
        (3,),
        (),
        BOTH,
    ),
    Row(
        "bridge frozen",
        "SIGSTOP in slot 2, for good",
        "as above; `fly`: nothing is heard of it",
        "as above",
        (End.HOME,),
        (3,),
        (),
        BOTH,
    ),
    Row(
        "bridge frozen for 10 s",
        "SIGSTOP in slot 2, SIGCONT 10 s later",
        "as above; bridge: it has not listened for so long",
        "as above; no setpoint after it woke",
        (End.HOME,),
        (3,),
        (("mode", "obeyed"),),
        BOTH,
    ),
    Row(
        "zenoh session lost and back",
        "a TCP relay between the bridge's session and the agent's is cut for 1 s in slot 2",
        "bridge: liveliness token, the slot's deadline",
        "holds, then flies on",
        (End.LANDED,),
        (0,),
        (("node_lost", "agent"), ("node_back", "agent")),
    ),
    Row(
        "zenoh session lost for good",
        "the same, cut in slot 2 and not mended",
        f"bridge: liveliness token; {_NO_ACTION}",
        "holds, returns",
        (End.HOME,),
        (3,),
        (("node_lost", "agent"), *_LADDER),
    ),
    _loss(10, "nobody: setpoints come at 20 Hz", "flies on", (End.LANDED,), (0,)),
    _loss(30, "nobody; commands are repeated until telemetry shows them", "flies on", (End.LANDED,), (0,)),
    _loss(
        60,
        "as above; PX4: COM_OF_LOSS_T",
        "flies on, or its autopilot's failsafe brings it home",
        (End.HOME, End.LANDED),
        (0, 3),
        BOTH,
    ),
    Row(
        "MAVLink duplicate",
        "each datagram twice, both ways, from slot 2 on",
        "nobody",
        "flies on",
        (End.LANDED,),
        (0,),
    ),
    Row(
        "MAVLink reorder",
        "every other datagram after the next one, both ways, from slot 2 on",
        "bridge: what is older than the newest is dropped",
        "flies on",
        (End.LANDED,),
        (0,),
    ),
    Row(
        "MAVLink delay 500 ms",
        "a UDP relay holds each datagram back for 500 ms, both ways, from slot 2 on",
        "nobody",
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
        "link dead 3 s, GUIDED",
        "as above",
        "bridge: no position for 1 s; ArduCopter: GUID_TIMEOUT",
        "flies its last velocity; no setpoints from 1.5 s on; goes on once the mode is known anew",
        (End.LANDED,),
        (0,),
        (("ladder", "-> HOLD_MODE"),),
        ("arducopter",),
    ),
    Row(
        "link dead 10 s",
        "as above",
        "PX4: COM_OF_LOSS_T; ArduCopter: GUID_TIMEOUT, FS_GCS_TIMEOUT; bridge: no position for 1 s",
        "returns by its autopilot's failsafe, which is obeyed when the link is back",
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
        (("ladder", "-> HOLD_MODE"),),
        BOTH,
    ),
    Row(
        "link dead at full speed",
        "every datagram lost, both ways, at more than 8 m/s towards a wall of the box, 30 m before it",
        "PX4: COM_OF_LOSS_T 1 s; ArduCopter: GUID_TIMEOUT, FS_GCS_TIMEOUT; bridge: no position for 1 s",
        "flies its last velocity until its autopilot notices: 1.25 s at 10 m/s beyond the box at most; returns",
        (End.HOME,),
        (1, 3),
        (("ladder", "-> HOLD_MODE"),),
        BOTH,
    ),
    Row(
        "autopilot's MAVLink side restarted in flight",
        "a UDP relay: time since boot from 0, sequence numbers and rates as at power-on; the airframe flies on",
        "bridge: the clock went back, or no position any more",
        "its autopilot's failsafe, or return",
        (End.HOME,),
        (3,),
        (),
        BOTH,
    ),
    Row(
        "clock jumps 5 s back",
        "a UDP relay: the autopilot's time since boot is 5 s less from slot 2 on",
        "bridge: the clock went back",
        "its autopilot's failsafe; no setpoints",
        (End.HOME,),
        (3,),
        (("failsafe", "clock went back"),),
    ),
    Row(
        "clock jumps 5 s ahead",
        "a UDP relay: 5 s more",
        "bridge: steps skipped, counted",
        "holds in slots that were over at once, flies on",
        (End.LANDED,),
        (0,),
    ),
    Row(
        "GPS loss",
        "`inject gps_loss` in slot 2, for good",
        "autopilot's estimator, after 5 s (ArduCopter 11 s)",
        "flies on by dead reckoning, then lands without a position; no setpoints",
        (End.DOWN,),
        (3,),
        (("mode", "obeyed"),),
        BOTH,
        outside=True,
    ),
    Row(
        "battery low",
        "`inject battery` below what the autopilot calls critical, in slot 2",
        "autopilot's battery failsafe",
        "PX4 holds for 5 s and returns, ArduCopter returns; no setpoints",
        (End.HOME,),
        (3,),
        (("mode", "obeyed"),),
        BOTH,
    ),
    Row(
        "fence breach by wind",
        "`inject wind` of 30 m/s, more than it can stand against, for 20 s from slot 2 on",
        "bridge: 1 m outside the fence",
        "is blown out of the fence; the autopilot returns, once it can; no setpoints",
        (End.HOME,),
        (3,),
        (("failsafe", "outside the fence"),),
        BOTH,
        outside=True,
    ),
    Row(
        "a motor fails",
        "`inject motor 1 fail` in slot 2",
        "autopilot: the ground",
        "falls",
        (End.DOWN,),
        (3,),
        (),
        BOTH,
        outside=True,
    ),
    Row(
        "disk full",
        "RLIMIT_FSIZE 0 for all of our processes in slot 2: no write to a file succeeds any more",
        "whoever writes: counted; `fly`: recording stopped",
        "flies on",
        (End.LANDED,),
        (1,),
    ),
    Row(
        "mission process killed",
        "SIGKILL in slot 2",
        "nobody: nobody needs it in flight",
        "flies on",
        (End.LANDED,),
        (0,),
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
    furthest = [max(map(abs, sight.position_enu[:2])) for sight in witness.sights]
    found = {
        End.HOME: down and end.from_home_m < HOME_M,
        End.LANDED: down and furthest[-1] <= fence_m,
        End.DOWN: down,
    }
    assert any(found[wanted] for wanted in row.ends), f"not {row.ends}: {end}; {told}"
    assert row.outside or max(furthest) <= fence_m + BREACH_M, f"{max(furthest):.1f} m, the fence is at {fence_m:g} m"
    assert code in row.codes, f"exit {code}; {told}"
    for kind, text in row.told:
        assert any(kind == k and text in t for k, t in told), f"{kind} {text!r} was not told: {told}"
    recorded = [state.time_s for state in log.messages(topics.STATE)]
    heard = [frame.time_boot_ms / 1000 for frame in frames if frame.get_type() == "LOCAL_POSITION_NED"]
    for name, times in (("MCAP", recorded), ("tlog", heard)):
        newest = max((time_s for time_s in times if time_s <= fault_s), default=0.0)
        assert newest >= fault_s - LOGGED_S, f"{name}: nothing between {newest:.1f} s and the fault at {fault_s:.1f} s"


def table():
    """The matrix as lines of Markdown."""
    return [*HEADER, *(row.markdown for row in ROWS.values())]


if __name__ == "__main__":
    print("\n".join(table()))
