import msgspec
import numpy as np
import pytest
import torch

from agent.decoding import action_size
from agent.environment import Environment
from agent.observation import Normalisation, ObservationError, ends, observe, observe_message, state_size
from bus.messages import ChannelState
from bus.topics import decode, encode
from rf_model.channels import draw_channels
from rf_model.mobility import initial_users
from rf_model.scenario import PRESETS, Scenario, preset
from rf_model.world import reference_gains

SMALL = preset("physical_small")


def drawn(scenario: Scenario, batch: int, dtype: torch.dtype = torch.float32):
    generator = torch.Generator().manual_seed(0)
    users = initial_users(scenario, (batch,), generator, dtype)
    position = torch.tensor(scenario.start_enu, dtype=dtype).expand(batch, 3)
    channels = draw_channels(scenario, position, torch.zeros(batch, dtype=dtype), users.position_enu, generator)
    return position, users, channels


def test_size_is_the_papers():
    assert state_size(PRESETS["paper_literal"]) == 291
    assert state_size(PRESETS["physical_1km"]) == 3 + 2 * (4 * 256 + 4 * 4 + 256 * 4)


@pytest.mark.parametrize("extra", [[], ["users"], ["time"], ["users", "time"], ["time", "users"]], ids=str)
@pytest.mark.parametrize("norm", ["raw", "link_reference"])
def test_layout_by_manual_indexing(norm, extra):
    scenario = preset("physical_small", state_norm=norm, rows=2, columns=3, antennas=2, users=3, state_extra=extra)
    N, M, J = 6, 2, 3
    position, users, channels = drawn(scenario, 2)
    state = observe(position, users.position_enu, 12, channels, Normalisation.of(scenario))
    gains = reference_gains(scenario)
    h, d, s = (gains.bs_ris, gains.direct, gains.ris_user) if norm == "link_reference" else (1, 1, 1)
    assert state.shape == (2, state_size(scenario))
    for b in range(2):
        expected = [0, 0, (60 - 75) / 45] if norm == "link_reference" else [0, 0, 60]
        for block, rows, columns, scale in (
            (channels.bs_ris, N, M, h),
            (channels.direct, J, M, d),
            (channels.ris_user, J, N, s),
        ):
            for row in range(rows):
                for column in range(columns):
                    number = complex(block[b, row, column]) / scale
                    expected += [number.real, number.imag]
        if "users" in extra:
            edges = (100, 100, 45) if norm == "link_reference" else (1, 1, 1)
            for user in users.position_enu[b].tolist():
                expected += [(at - of) / edge for at, of, edge in zip(user, (0, 0, 60), edges, strict=True)]
        if "time" in extra:
            expected += [12 / 30]
        np.testing.assert_allclose(state[b], expected, rtol=1e-5, atol=1e-7)


def test_normalised_links_are_of_order_one():
    """Else batch norm's epsilon erases the channels (they are 1e-3 to 1e-8)."""
    position, users, channels = drawn(SMALL, 2000)
    state = observe(position, users.position_enu, 0, channels, Normalisation.of(SMALL))
    at = 3
    for numbers in (2 * 16 * 4, 2 * 4 * 4, 2 * 4 * 16):
        power = 2 * state[:, at : at + numbers].square().mean()  # of the complex number
        assert 0.5 < power < 2
        at += numbers
    assert state[:, :3].abs().max() <= 1


def message_of(scenario: Scenario, dtype: torch.dtype) -> tuple[ChannelState, torch.Tensor]:
    position, users, channels = drawn(scenario, 1, dtype)
    message = ChannelState(
        slot=7,
        time_s=0.0,
        position_enu=tuple(position[0].tolist()),
        attitude_rad=(0.0, 0.0, 0.0),
        users_enu=[tuple(user) for user in users.position_enu[0].tolist()],
        regions=["transmission" if t else "reflection" for t in channels.transmission[0].tolist()],
        direct=torch.view_as_real(channels.direct[0]).tolist(),
        bs_ris=torch.view_as_real(channels.bs_ris[0]).tolist(),
        ris_user=torch.view_as_real(channels.ris_user[0]).tolist(),
    )
    state = observe(position, users.position_enu, 7, channels, Normalisation.of(scenario))[0]
    return decode(encode(message), ChannelState), state


@pytest.mark.parametrize("extra", [[], ["users", "time"]], ids=str)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_message_gives_the_same_state_as_the_environment(dtype, extra):
    scenario = preset("physical_small", state_extra=extra)
    message, state = message_of(scenario, dtype)
    torch.testing.assert_close(observe_message(message, Normalisation.of(scenario)), state, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("field", ["direct", "bs_ris", "ris_user"])
def test_a_message_of_other_sizes_is_refused_by_field(field):
    message, _ = message_of(SMALL, torch.float32)
    other = Normalisation.of(preset("physical_small", users=5, antennas=3, rows=5))
    with pytest.raises(ObservationError, match=r"the scenario has \d+ x \d+"):
        observe_message(message, other)
    broken = {name: getattr(message, name) for name in message.__struct_fields__} | {field: [[(1.0, 0.0)]]}
    with pytest.raises(ObservationError, match=f"{field}: 1 x 1 numbers"):
        observe_message(ChannelState(**broken), Normalisation.of(SMALL))


def test_a_message_of_fewer_user_positions_is_refused():
    message, _ = message_of(SMALL, torch.float32)
    fewer = msgspec.structs.replace(message, users_enu=message.users_enu[1:])
    with pytest.raises(ObservationError, match="users_enu: 3 positions, the scenario has 4 users"):
        observe_message(fewer, Normalisation.of(SMALL))


def test_the_environment_observes_by_it():
    environment = Environment(SMALL, batch=2, seed=0)
    state = environment.reset()
    world = environment.world
    wanted = observe(world.position_enu, world.users.position_enu, 0, world.channels, Normalisation.of(SMALL))
    assert torch.equal(state, wanted)


def test_what_is_added_follows_the_same_worlds_state_and_follows_them():
    """The first numbers are those of the default state, bit for bit, whatever is added."""
    scenario = preset("physical_small", slots=4, state_extra=["users", "time"])
    plain, added = (Environment(of, batch=3, seed=2) for of in (preset("physical_small", slots=4), scenario))
    size = state_size(plain.scenario)
    raw = torch.full((3, action_size(scenario)), 0.3)
    assert torch.equal(added.reset()[:, :size], plain.reset())
    for slot in range(1, 5):
        state, other = added.step(raw).observation, plain.step(raw).observation
        assert torch.equal(state[:, :size], other)
        away = state[:, size:-1].unflatten(-1, (4, 3)) * torch.tensor([100.0, 100.0, 45.0])
        at = away + added.world.position_enu.unsqueeze(1)
        torch.testing.assert_close(at, added.world.users.position_enu, rtol=0, atol=1e-4)
        assert state[:, -1].tolist() == pytest.approx([slot / 4] * 3)
        assert ends(state).tolist() == [slot == 4] * 3
