"""Flights as training data: every transition of a run folder, rebuilt from its recording alone."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
import torch
from torch import Tensor

from agent.decoding import PhysicalAction, decode, encode
from agent.observation import Normalisation, observe_message
from agent.offline import Transitions
from bus import topics
from bus.messages import ChannelState, Complex, FlownSlot, RisConfiguration, SlotOpened
from mission.flight_log import FlightLogError, read
from mission.mission_file import Mission, load
from mission.run_folder import MISSION_NAME
from rf_model.channels import Channels
from rf_model.reward import reward
from rf_model.scenario import Scenario
from rf_model.slot_radio import SlotRadio
from rf_model.surfaces import read_coefficients
from rf_model.world import slot_rates, track_power

TOLERANCE = 1e-3
"""Of coefficients, of beams relative to the root of P_max and of moves [m]: within it a raw action gives a decision."""


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
    """Every slot of which opening, configuration and flight were recorded, in order; see `rebuilt`.

    Raises FlightLogError or MissionError when the folder holds no readable flight, FlightLogError when channels that
    nobody published cannot be drawn again.
    """
    mission = load(run / MISSION_NAME)
    log = read(run)
    try:
        return rebuilt(mission, log.by_slot(topics.SLOT), log.by_slot(topics.CSI), log.by_slot(topics.CONFIGURATION))
    except ValueError as error:
        raise FlightLogError(f"{run}: {error}") from error


def rebuilt(
    mission: Mission,
    opened: Mapping[int, SlotOpened],
    observed: Mapping[int, ChannelState],
    configurations: Mapping[int, RisConfiguration],
) -> list[Transition]:
    """Transitions from a flight's messages, each kind by slot.

    What nobody published is drawn again as the rf node would have drawn it: what would have been observed in the
    closing slot, and, where the agent saw estimates (`csi_error_variance`, `csi_delay_slots`), the channels themselves.
    Slots are left out that were not recorded whole, and those in which the surface or the base station did what no raw
    action says (as beams of less than full power). Raises ValueError when the mission's seed draws other users than
    were recorded.
    """
    scenario = mission.scenario
    seen = _drawn_again(scenario, mission.seed, opened, observed) | dict(observed)
    exact = scenario.model_copy(update={"csi_error_variance": 0.0, "csi_delay_slots": 0})
    channels = seen if exact == scenario else _drawn_again(exact, mission.seed, opened, observed)
    normalisation = Normalisation.of(scenario)
    found = []
    for slot in sorted(configurations):
        flown = opened[slot + 1].flown if slot + 1 in opened else None
        rated = slot if scenario.timing == "pre" else slot + 1
        if flown is None or slot not in seen or slot + 1 not in seen or rated not in channels:
            continue
        action = _executed(flown, configurations[slot], scenario)
        raw = encode(action, scenario)
        if not _same(decode(raw, scenario), action, scenario):
            continue
        yaw_rad = seen[slot].attitude_rad[2]
        found.append(
            Transition(
                slot=slot,
                observation=observe_message(seen[slot], normalisation),
                action=raw.to(torch.float32),
                reward=_slot_reward(scenario, channels[rated], action, flown, yaw_rad),
                next_observation=observe_message(seen[slot + 1], normalisation),
            )
        )
    return found


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


def _executed(flown: FlownSlot, configuration: RisConfiguration, scenario: Scenario) -> PhysicalAction:
    """What was planned after limits and envelope, and what surface and base station were set to."""
    independent = scenario.surface == "independent"  # of all others theta_transmission follows from the rest
    angles = (configuration.theta_reflection, configuration.split_angle, configuration.sign)
    free = configuration.theta_transmission if independent else []
    return PhysicalAction(
        displacement_enu=torch.tensor(flown.planned_enu, dtype=torch.float64),
        trc=read_coefficients(scenario, *(torch.tensor(field, dtype=torch.float64) for field in (*angles, free))),
        beamforming=_complex(configuration.beamforming),
    )


def _same(first: PhysicalAction, second: PhysicalAction, scenario: Scenario) -> bool:
    pairs = [(first.displacement_enu, second.displacement_enu)]
    pairs += list(zip(first.trc.coefficients(), second.trc.coefficients(), strict=True))
    pairs.append((first.beamforming / scenario.p_max_w**0.5, second.beamforming / scenario.p_max_w**0.5))
    return all((a - b).abs().max() <= TOLERANCE for a, b in pairs)


def _slot_reward(
    scenario: Scenario, channels: ChannelState, action: PhysicalAction, flown: FlownSlot, yaw_rad: float
) -> float:
    """What a slot was worth, computed anew from channels, what was executed and the flown track."""
    drawn = Channels(
        direct=_complex(channels.direct),
        bs_ris=_complex(channels.bs_ris),
        ris_user=_complex(channels.ris_user),
        transmission=torch.tensor([region == "transmission" for region in channels.regions]),
    )
    rates = slot_rates(scenario, drawn, action.trc, action.beamforming)
    time_s = torch.tensor([sample.time_s for sample in flown.track], dtype=torch.float64)
    velocity = torch.tensor([sample.velocity_enu for sample in flown.track], dtype=torch.float64)
    yaw = torch.tensor(yaw_rad, dtype=torch.float64)
    return reward(scenario, rates.fair_rate_bps, track_power(scenario, time_s, velocity, yaw)).item()


def _drawn_again(
    scenario: Scenario, seed: int, opened: Mapping[int, SlotOpened], observed: Mapping[int, ChannelState]
) -> dict[int, ChannelState]:
    """What the rf node publishes at these openings, by slot; at the closing one, what it would if it were not that."""
    radio = SlotRadio(scenario, seed)
    states = {}
    for slot in sorted(opened):
        for message in radio.open(msgspec.structs.replace(opened[slot], closing=False)):
            if isinstance(message, ChannelState):
                states[slot] = message
    for slot in sorted(states.keys() & observed.keys()):
        if not np.allclose(states[slot].users_enu, observed[slot].users_enu):
            raise ValueError(f"seed: {seed} draws other users than the recorded ones, first in slot {slot}")
    return states


def _complex(rows: list[list[Complex]]) -> Tensor:
    return torch.view_as_complex(torch.tensor(rows, dtype=torch.float64))
