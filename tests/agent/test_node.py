"""The agent node over a real zenoh session between two peers."""

import queue
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import pytest
import torch
import zenoh

from agent import node
from agent.daddpg import DualActorDdpg
from agent.decoding import decode
from agent.observation import Normalisation, observe
from agent.policies import TrainedPolicy, sizes
from agent.policy import PolicyConfig
from agent.training import save_policy
from agent.training_config import TrainingConfig
from bus import messages as m
from bus import topics
from bus.session import free_endpoint, open_session
from rf_model.channels import Channels, draw_channels
from rf_model.mobility import initial_users
from rf_model.scenario import Scenario, preset

SMALL = preset("physical_small")
VEHICLE = "uav1"


def channel_state(slot: int, scenario: Scenario = SMALL) -> m.ChannelState:
    generator = torch.Generator().manual_seed(slot)
    users = initial_users(scenario, (), generator)
    position = torch.tensor(scenario.start_enu)
    channels = draw_channels(scenario, position, torch.tensor(0.0), users.position_enu, generator)
    return m.ChannelState(
        slot=slot,
        time_s=10.0 + slot,
        position_enu=tuple(position.tolist()),
        attitude_rad=(0.0, 0.0, 0.0),
        users_enu=[tuple(user) for user in users.position_enu.tolist()],
        regions=["transmission" if t else "reflection" for t in channels.transmission.tolist()],
        direct=torch.view_as_real(channels.direct).tolist(),
        bs_ris=torch.view_as_real(channels.bs_ris).tolist(),
        ris_user=torch.view_as_real(channels.ris_user).tolist(),
    )


class World:
    """The rest of the loop: a session that sends channel states and hears everything the agent says."""

    def __init__(self, session: zenoh.Session, vehicle: str = VEHICLE) -> None:
        self.session = session
        self.actions: queue.Queue[m.Action] = queue.Queue()
        self.health: queue.Queue[m.NodeHealth] = queue.Queue()
        self.alive: queue.Queue[tuple[str, bool]] = queue.Queue()
        self.csi = topics.Publisher(session, vehicle, topics.CSI)
        self.event = topics.Publisher(session, vehicle, topics.EVENT)
        self.held = [
            topics.subscribe(session, vehicle, topics.ACTION, self.actions.put, topics.Counter()),
            topics.subscribe(session, vehicle, topics.HEALTH, self.health.put, topics.Counter()),
            topics.watch_alive(session, vehicle, lambda name, alive: self.alive.put((name, alive))),
        ]

    def ask(self, message: m.ChannelState) -> m.Action:
        self.csi.send(message)
        return self.actions.get(timeout=20)

    def wait_alive(self, name: str) -> None:
        while self.alive.get(timeout=20) != (name, True):
            pass

    def end(self) -> None:
        self.event.send(m.MissionEvent(time_s=0.0, source="bridge", kind="ended", text="landed", exit_code=0))


@contextmanager
def flying(
    policy: PolicyConfig, seed: int = 0, scenario: Scenario = SMALL
) -> Iterator[tuple[World, Callable[[], int]]]:
    """A running node and its world; the function waits for the node's end and gives its exit code."""
    endpoint = free_endpoint()
    codes: queue.Queue[int] = queue.Queue()
    with open_session(listen=endpoint) as ours, open_session(connect=[endpoint]) as its:
        world = World(ours)
        thread = threading.Thread(
            target=lambda: codes.put(node.run({VEHICLE: node.Task(policy, scenario, seed)}, its, until_ended=True)),
            daemon=True,
        )
        thread.start()
        world.wait_alive("agent")
        yield world, lambda: codes.get(timeout=20)
        world.end()
        thread.join(20)
        assert not thread.is_alive()


@pytest.fixture
def trained(tmp_path: Path) -> PolicyConfig:
    config = TrainingConfig(hidden=(32, 16))
    save_policy(tmp_path / "p.safetensors", DualActorDdpg(sizes(SMALL), config), SMALL, config, {})
    return PolicyConfig(checkpoint=str(tmp_path / "p.safetensors"))


def test_every_channel_state_is_answered_with_its_decoded_action(trained):
    with flying(trained) as (world, _):
        for slot in range(4):
            csi = channel_state(slot)
            action = world.ask(csi)
            assert (action.slot, action.time_s, action.source) == (slot, csi.time_s, "p")
            assert len(action.raw) == 83
            expected = decode(torch.tensor(action.raw, dtype=torch.float64), SMALL)
            assert list(action.displacement_enu) == expected.displacement_enu.tolist()
            assert action.theta_reflection == expected.theta_reflection.tolist()
            assert action.split_angle == expected.split_angle.tolist()
            assert action.sign == expected.sign.tolist()
            beams = torch.view_as_complex(torch.tensor(action.beamforming, dtype=torch.float64))
            assert torch.equal(beams, expected.beamforming)


def test_a_policy_in_flight_sees_users_and_time(tmp_path):
    """It acts as it would by the state that training gives, and otherwise at another time."""
    scenario, config = preset("physical_small", slots=2, state_extra=["users", "time"]), TrainingConfig(hidden=(32, 16))
    path = tmp_path / "p.safetensors"
    save_policy(path, DualActorDdpg(sizes(scenario), config), scenario, config, {})
    csi = channel_state(0, scenario)
    with flying(PolicyConfig(checkpoint=str(path)), scenario=scenario) as (world, _):
        flown = [world.ask(msgspec.structs.replace(csi, slot=slot)).raw for slot in range(2)]
    assert flown[0] != flown[1]
    policy = TrainedPolicy(path, scenario)
    for slot, raw in enumerate(flown):
        channels = Channels(
            *(torch.view_as_complex(torch.tensor(part)) for part in (csi.direct, csi.bs_ris, csi.ris_user)),
            transmission=torch.tensor([region == "transmission" for region in csi.regions]),
        )
        position, users = torch.tensor(csi.position_enu), torch.tensor(csi.users_enu)
        state = observe(position, users, slot, channels, Normalisation.of(scenario))
        torch.testing.assert_close(torch.tensor(raw), policy(state, slot), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("kind", ["random", "hover"])
def test_same_channel_states_and_seed_give_the_same_actions_also_after_a_restart(kind):
    def fly(slots: list[int]) -> list[m.Action]:
        with flying(PolicyConfig(kind=kind), seed=5) as (world, _):
            return [world.ask(channel_state(slot)) for slot in slots]

    assert fly([0, 1, 2])[2:] == fly([2])


@contextmanager
def flying_two(tasks: dict[str, node.Task]) -> Iterator[tuple[list[World], Callable[[], int], threading.Thread]]:
    """One node for two vehicles, and the world of each."""
    endpoint = free_endpoint()
    codes: queue.Queue[int] = queue.Queue()
    with open_session(listen=endpoint) as ours, open_session(connect=[endpoint]) as its:
        worlds = [World(ours, name) for name in tasks]
        thread = threading.Thread(target=lambda: codes.put(node.run(tasks, its, until_ended=True)), daemon=True)
        thread.start()
        for world in worlds:
            world.wait_alive("agent")
        yield worlds, lambda: codes.get(timeout=20), thread
        for world in worlds:
            world.end()
        thread.join(20)
        assert not thread.is_alive()


def test_each_of_two_vehicles_is_flown_by_its_own_policy_and_seed_until_both_have_ended():
    tasks = {
        "a": node.Task(PolicyConfig(kind="random"), SMALL, 5),
        "b": node.Task(PolicyConfig(kind="random"), SMALL, 6),
    }
    alone = []
    for task in tasks.values():
        with flying(task.policy, seed=task.seed) as (world, _):
            alone.append([world.ask(channel_state(slot)) for slot in range(2)])
    with flying_two(tasks) as ((first, second), exit_code, thread):
        together = [[world.ask(channel_state(slot)) for world in (first, second)] for slot in range(2)]
        assert [list(actions) for actions in zip(*together, strict=True)] == alone
        assert alone[0] != alone[1]
        first.end()
        while first.alive.get(timeout=20) != ("agent", False):
            pass
        assert second.ask(channel_state(2)).slot == 2
        assert thread.is_alive()
        second.end()
        assert exit_code() == 0


def test_a_vehicle_on_which_the_policy_fails_is_left_and_the_other_flies_on(monkeypatch, capsys):
    """Nothing that comes over the bus makes a policy fail, so one is made that does."""
    sound = node.make_policy

    class Failing:
        name = "failing"

        def __call__(self, state: torch.Tensor, slot: int) -> torch.Tensor:
            raise ZeroDivisionError

    monkeypatch.setattr(node, "make_policy", lambda *task: Failing() if task[2] == 99 else sound(*task))
    hover = PolicyConfig(kind="hover")
    with flying_two({"a": node.Task(hover, SMALL, 1), "b": node.Task(hover, SMALL, 99)}) as ((first, second), code, _):
        second.csi.send(channel_state(0))
        while second.alive.get(timeout=20) != ("agent", False):
            pass
        assert first.ask(channel_state(0)).slot == 0
        first.end()
        assert code() == 1
    assert "agent: b failed" in capsys.readouterr().err


def test_it_ends_with_the_bridges_last_event(trained):
    with flying(trained) as (world, exit_code):
        world.ask(channel_state(0))
        world.end()
        assert exit_code() == 0


def test_it_ends_when_the_bridge_is_gone(trained):
    with flying(trained) as (world, exit_code):
        bridge = topics.declare_alive(world.session, VEHICLE, "bridge")
        world.ask(channel_state(0))
        bridge.undeclare()
        assert exit_code() == 0


def test_a_channel_state_of_other_sizes_is_counted_and_not_answered(trained):
    with flying(trained) as (world, exit_code):
        world.csi.send(channel_state(0, preset("physical_small", users=5)))
        assert world.ask(channel_state(1)).slot == 1
        world.session.put(topics.key(VEHICLE, topics.CSI.name), b"{}")
        assert world.ask(channel_state(2)).slot == 2
        world.end()
        assert exit_code() == 0
        while (counters := world.health.get(timeout=20).counters)["received"] < 3:
            pass  # the last report comes as the node ends
        assert counters["decided"] == 2
        assert counters["wrong_size"] == 1
        assert counters["refused rf/csi"] == 1


def test_a_policy_gone_mad_is_counted_and_not_answered(tmp_path):
    config = TrainingConfig(hidden=(32, 16))
    mad = DualActorDdpg(sizes(SMALL), config)
    torch.nn.init.constant_(mad.continuous_actor.out.bias, float("nan"))
    save_policy(tmp_path / "mad.safetensors", mad, SMALL, config, {})
    with flying(PolicyConfig(checkpoint=str(tmp_path / "mad.safetensors"))) as (world, _):
        world.csi.send(channel_state(0))
        while world.health.get(timeout=20).counters["not_finite"] == 0:
            pass
        assert world.actions.empty()
