"""Flights as training data: every transition of a run folder, rebuilt from its recording alone."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from agent.observation import Normalisation, observe_message
from agent.offline import Transitions
from bus import topics
from bus.messages import ChannelState, Complex, FlownSlot, RisConfiguration, SlotOpened, Vec3
from mission.flight_log import FlightLogError, read
from mission.mission_file import Mission, load
from mission.run_folder import MISSION_NAME
from rf_model.channels import Channels
from rf_model.reward import reward
from rf_model.scenario import Scenario
from rf_model.slot_radio import SlotRadio
from rf_model.star_ris import Trc
from rf_model.world import slot_rates, track_power

EXACT = {
    "timing": "pre",
    "surface": "coupled",
    "phase_bits": None,
    "element_loss_db": 0.0,
    "csi_error_variance": 0.0,
    "csi_delay_slots": 0,
}
"""What a scenario must say for a recording to hold all that a transition takes."""


@dataclass(frozen=True)
class Transition:
    """One slot that was flown."""

    slot: int
    observation: Tensor
    """[S] at the slot's opening."""
    action: Tensor
    """[A] raw action that decodes to what was executed: the displacement planned after limits and envelope, and the
    coefficients and beamforming in force (which are the last ones, or neutral, when the slot's own action was refused
    or never came)."""
    reward: float
    next_observation: Tensor
    """[S] at the next slot's opening."""


def transitions(run: Path) -> list[Transition]:
    """Every slot of which opening, configuration and flight were recorded, in order.

    The channels that the closing slot would have had are drawn again as the rf node would have drawn them. Raises
    FlightLogError or MissionError when the folder holds no readable flight.
    """
    mission = load(run / MISSION_NAME)
    require_exact(mission.scenario, run)
    log = read(run)
    opened = log.by_slot(topics.SLOT)
    channels = log.by_slot(topics.CSI)
    configurations = log.by_slot(topics.CONFIGURATION)
    for opening in opened.values():
        if opening.closing:
            channels.setdefault(opening.slot, _after_the_end(mission, opening))
    normalisation = Normalisation.of(mission.scenario)
    observations = {slot: observe_message(state, normalisation) for slot, state in channels.items()}
    found = []
    for slot in sorted(configurations):
        flown = opened[slot + 1].flown if slot + 1 in opened else None
        if flown is None or slot not in observations or slot + 1 not in observations:
            continue
        configuration = configurations[slot]
        found.append(
            Transition(
                slot=slot,
                observation=observations[slot],
                action=encode(flown.planned_enu, configuration, mission.scenario),
                reward=slot_reward(mission.scenario, channels[slot], configuration, flown),
                next_observation=observations[slot + 1],
            )
        )
    return found


def require_exact(scenario: Scenario, run: Path) -> None:
    """Raise FlightLogError for a scenario in which a slot's worth is not that of what the agent saw and sent.

    There the channels in the recording are not those of the rates, or the action is not that of the surface.
    """
    for field, exact in EXACT.items():
        value = getattr(scenario, field)
        if value != exact:
            raise FlightLogError(f"{run}: scenario.{field}: {value!r}: transitions are rebuilt only with {exact!r}")


def data_set(runs: Sequence[Path]) -> tuple[Scenario, Transitions]:
    """All transitions of several runs of one scenario, for offline training.

    Raises FlightLogError when the runs are of different scenarios or hold no transition.
    """
    scenario = load(runs[0] / MISSION_NAME).scenario
    rows: list[Transition] = []
    for run in runs:
        other = load(run / MISSION_NAME).scenario
        if other.model_copy(update={"slots": scenario.slots}) != scenario:
            raise FlightLogError(f"{run}: another scenario than that of {runs[0]}; train on runs of one scenario")
        rows += transitions(run)
    if not rows:
        raise FlightLogError(f"{', '.join(map(str, runs))}: no transition was recorded")
    return scenario, Transitions(
        observation=torch.stack([row.observation for row in rows]).numpy(),
        action=torch.stack([row.action for row in rows]).numpy(),
        reward=np.array([row.reward for row in rows], dtype=np.float32),
        next_observation=torch.stack([row.next_observation for row in rows]).numpy(),
        terminated=np.zeros(len(rows), dtype=np.bool_),
    )


def slot_reward(scenario: Scenario, channels: ChannelState, configuration: RisConfiguration, flown: FlownSlot) -> float:
    """What a slot was worth, computed anew from channels, configuration and flown track."""
    trc = Trc(
        torch.tensor(configuration.theta_reflection, dtype=torch.float64),
        torch.tensor(configuration.split_angle, dtype=torch.float64),
        torch.tensor(configuration.sign, dtype=torch.float64),
    )
    drawn = Channels(
        direct=_complex(channels.direct),
        bs_ris=_complex(channels.bs_ris),
        ris_user=_complex(channels.ris_user),
        transmission=torch.tensor([region == "transmission" for region in channels.regions]),
    )
    rates = slot_rates(scenario, drawn, trc, _complex(configuration.beamforming))
    time_s = torch.tensor([sample.time_s for sample in flown.track], dtype=torch.float64)
    velocity = torch.tensor([sample.velocity_enu for sample in flown.track], dtype=torch.float64)
    yaw = torch.tensor(channels.attitude_rad[2], dtype=torch.float64)
    return reward(scenario, rates.fair_rate_bps, track_power(scenario, time_s, velocity, yaw)).item()


def encode(displacement_enu: Vec3, configuration: RisConfiguration, scenario: Scenario) -> Tensor:
    """Raw action [3 + 3N + 2MJ], float32, that `agent.decoding.decode` turns into this decision."""
    beams = torch.view_as_real(_complex(configuration.beamforming)).flatten()
    parts = (
        _motion(displacement_enu, scenario),
        torch.tensor(configuration.theta_reflection, dtype=torch.float64) / math.pi,
        torch.tensor(configuration.split_angle, dtype=torch.float64) * (4 / math.pi) - 1,
        beams / beams.abs().max().clip(min=1e-12),
        torch.tensor(configuration.sign, dtype=torch.float64),
    )
    return torch.cat(parts).to(torch.float32).clip(-1, 1)


def _motion(displacement_enu: Vec3, scenario: Scenario) -> Tensor:
    reach = scenario.v_max_mps * scenario.slot_s
    if scenario.motion == "cartesian":
        return torch.tensor(displacement_enu, dtype=torch.float64) / reach
    east, north, up = displacement_enu
    distance = math.hypot(east, north, up)
    elevation = math.asin(up / distance) if distance > 0 else 0.0
    azimuth = math.atan2(north, east) % (2 * math.pi)
    return torch.tensor(
        [2 * distance / reach - 1, elevation / (math.pi / 2), azimuth / math.pi - 1], dtype=torch.float64
    )


def _after_the_end(mission: Mission, closing: SlotOpened) -> ChannelState:
    opened = SlotOpened(
        slot=closing.slot,
        slots=closing.slots,
        time_s=closing.time_s,
        position_enu=closing.position_enu,
        velocity_enu=closing.velocity_enu,
        attitude_rad=closing.attitude_rad,
        closing=False,
        flown=None,
    )
    (state,) = SlotRadio(mission.scenario, mission.seed).open(opened)
    assert isinstance(state, ChannelState)
    return state


def _complex(rows: list[list[Complex]]) -> Tensor:
    return torch.view_as_complex(torch.tensor(rows, dtype=torch.float64))
