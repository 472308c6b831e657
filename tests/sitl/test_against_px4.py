"""The vehicle against recordings of real PX4 (AUTOPILOT.md 4; data/README.md)."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest

from sitl.control import Setpoint
from sitl.flight_model import NAN3, FlightModel
from sitl.parameters import Parameters
from sitl.px4.parameters import TABLE
from sitl.px4.vehicle_setup import gains, rotorcraft

DATA = Path(__file__).parent / "data"


@pytest.fixture(scope="module")
def flight():
    """Times, commanded, recorded and simulated velocity over the recorded flight while setpoints streamed."""
    with (DATA / "px4_step_response.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if float(row["boot_s"]) < 97.3]
    times = np.array([float(row["boot_s"]) for row in rows])
    asked = np.array([[float(row[f"cmd_v{axis}"]) for axis in "ned"] for row in rows])
    recorded = np.array([[float(row[f"v{axis}"]) for axis in "ned"] for row in rows])
    p = Parameters(TABLE)
    model = FlightModel(gains(p), rotorcraft(p))
    model.body.position[2] = -10.0
    model.body.motors[:] = model.gains.hover_thrust
    simulated = np.zeros_like(recorded)
    now_ms = round(times[0] * 1000)
    for k in range(1, len(times)):
        setpoint = Setpoint(NAN3, tuple(asked[k - 1].tolist()), NAN3, math.nan, 0.0, math.inf, p["MPC_THR_MIN"])
        tick_ms = round(times[k] * 1000) - now_ms
        model.advance(setpoint, True, tick_ms)
        now_ms += tick_ms
        simulated[k] = model.body.velocity
    return times, asked, recorded, simulated


def test_velocity_matches_over_the_whole_offboard_flight(flight, record_property):
    """Issue 4's goal: at most 0.35 m/s RMS over the recorded flight's offboard part."""
    _, _, recorded, simulated = flight
    rms = math.sqrt(((simulated - recorded) ** 2).sum(axis=1).mean())
    record_property("rms_mps", rms)
    assert rms < 0.35


def rise_s(times, velocity, start, level):
    """Time from index `start` until the velocity passes `level`."""
    passed = np.nonzero(velocity[start:] >= level)[0]
    return times[start + passed[0]] - times[start]


def test_step_to_5_north_rises_as_recorded(flight):
    times, asked, recorded, simulated = flight
    start = int(np.nonzero(asked[:, 0] == 5.0)[0][0])
    assert rise_s(times, simulated[:, 0], start, 2.5) == pytest.approx(
        rise_s(times, recorded[:, 0], start, 2.5), abs=0.25
    )
    assert rise_s(times, simulated[:, 0], start, 4.0) == pytest.approx(
        rise_s(times, recorded[:, 0], start, 4.0), abs=1.0
    )


def test_step_to_5_north_falls_short_by_drag_as_recorded(flight):
    """SIH's drag keeps the velocity 10 to 13 % short of the command 8 s after the step."""
    _, asked, recorded, simulated = flight
    end = int(np.nonzero(asked[:, 0] == 5.0)[0][-1])
    assert simulated[end, 0] == pytest.approx(recorded[end, 0], abs=0.2)


def test_climb_of_3_rises_as_recorded(flight):
    times, asked, recorded, simulated = flight
    start = int(np.nonzero(asked[:, 2] == -3.0)[0][0])
    assert rise_s(times, -simulated[:, 2], start, 1.5) == pytest.approx(
        rise_s(times, -recorded[:, 2], start, 1.5), abs=0.25
    )


def test_return_takes_as_long_as_recorded(hovering):
    """From (101, 38, -9.8) m the recorded PX4 needed 35.3 s of AUTO.RTL to reach home and start down; within 10 %."""
    hovering.commander.set_home((-101.2, -38.0, 0.2))
    assert hovering.command(20) == 0
    took = hovering.until(lambda: "RTL: land at destination" in hovering.texts(), 60)
    assert took == pytest.approx(35.3, rel=0.1)
    assert hovering.latest["EXTENDED_SYS_STATE"].landed_state in (2, 4)
