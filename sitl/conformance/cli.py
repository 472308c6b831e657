"""Command line of the conformance kit: `aerialstar conformance`."""

import sys
from pathlib import Path
from typing import Annotated, Literal

import typer


def conformance(
    url: Annotated[
        str, typer.Argument(metavar="URL", help="udpin:HOST:PORT (listen), udpout:HOST:PORT or tcp:HOST:PORT.")
    ],
    personality: Annotated[
        Literal["px4", "arducopter"] | None,
        typer.Option(help="Which autopilot to expect; else what its HEARTBEAT says."),
    ] = None,
    level: Annotated[
        int,
        typer.Option(min=0, max=3, help="Up to which level: 0 connect, 1 fly, 2 parameters and plans, 3 failures."),
    ] = 3,
    only: Annotated[list[str] | None, typer.Option(metavar="CHECK", help="Only this check; may be repeated.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object in place of the table.")] = False,
    tlog: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Keep every MAVLink frame, both ways, in a .tlog.")
    ] = None,
) -> None:
    """Fly a MAVLink quadrotor autopilot and say what of the protocol it keeps.

    It arms and flies the vehicle within 60 m of where it stands, up to 20 m high: in a simulator, or where
    nobody can be hurt. At the end, also by Ctrl-C, the vehicle is landed and disarmed, and its parameters and plans are
    as they were.

    Exit codes: 0 nothing failed, 1 something failed, 2 bad URL or option.
    """
    from sitl.conformance.main import main
    from sitl.conformance.wire import WireError

    try:
        code = main(url, personality, level, only or [], json, tlog)
    except (WireError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        raise typer.Exit(2) from None
    raise typer.Exit(code)
