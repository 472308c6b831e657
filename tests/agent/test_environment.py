"""The batched environment against a plain NumPy episode: loops over users, equations as the paper prints or PAPER fixes
them, sharing nothing with the radio model but the random draws."""

import math

import numpy as np
import pytest
import torch

from agent.decoding import RawActionError, action_size
from agent.environment import Environment
from agent.observation import state_size
from rf_model.scenario import Scenario, preset
from rf_model.surfaces import surface_of
from rf_model.world import slot_rates, track_power

SMALL = preset("physical_small")


def random_raw(scenario: Scenario, batch: int, seed: int) -> torch.Tensor:
    return torch.rand(batch, action_size(scenario), generator=torch.Generator().manual_seed(seed)) * 2 - 1


def reward_by_hand(scenario: Scenario, raw: np.ndarray, world, row: int):
    """Decode and rate one world with plain arithmetic: (reward, displacement, rates, power)."""
    N, M, J = scenario.elements, scenario.antennas, scenario.users
    reach = scenario.v_max_mps * scenario.slot_s
    if scenario.motion == "spherical":
        distance, elevation, azimuth = (raw[0] + 1) / 2 * reach, raw[1] * math.pi / 2, (raw[2] + 1) * math.pi
        move = distance * np.array(
            [math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), math.sin(elevation)]
        )
    else:
        move = raw[:3] * reach
        move = move * min(1, reach / np.linalg.norm(move))
    if scenario.climb_up_mps is not None:
        move[2] = min(max(move[2], -scenario.climb_down_mps), scenario.climb_up_mps)

    theta = math.pi * raw[3 : 3 + N]
    split = (raw[3 + N : 3 + 2 * N] + 1) / 2 * math.pi / 2
    w = raw[3 + 2 * N : 3 + 2 * N + 2 * M * J].reshape(M, J, 2)
    W = w[..., 0] + 1j * w[..., 1]
    W = W * math.sqrt(10 ** ((scenario.p_max_dbm - 30) / 10)) / np.linalg.norm(W)
    sign = np.where(raw[3 + 2 * N + 2 * M * J :] > 0, 1, -1)
    phi = {
        False: np.sin(split) * np.exp(1j * theta),
        True: np.cos(split) * np.exp(1j * (theta + sign * math.pi / 2)),
    }
    noise = 10 ** ((-174 + 7 + 60 - 30) / 10)
    rates = []
    for j in range(J):
        side = bool(world.channels.transmission[row, j])
        h_b = world.channels.direct[row, j].numpy().astype(complex)
        h_s = world.channels.ris_user[row, j].numpy().astype(complex)
        H = world.channels.bs_ris[row].numpy().astype(complex)
        g = h_b + h_s @ np.diag(phi[side]) @ H
        powers = [abs(g @ W[:, k]) ** 2 for k in range(J)]
        rates.append(1e6 * math.log2(1 + powers[j] / (sum(powers) - powers[j] + noise)))
    fair = J**2 / sum(1 / max(r, 1.0) for r in rates)

    v = move / scenario.slot_s
    rho, A, s, tip, weight = 1.225, 0.503, 0.05, 120.0, 25.0
    v_i = math.sqrt(weight / (2 * rho * A)) if scenario.induced_velocity == "consistent" else 4.028
    hover_induced = weight**1.5 / math.sqrt(2 * rho * A)
    hover_blade = 0.012 / 8 * rho * s * A * tip**3
    V = math.hypot(v[0], v[1])
    induced = hover_induced * math.sqrt(math.sqrt(1 + V**4 / (4 * v_i**4)) - V**2 / (2 * v_i**2))
    climb = weight * v[2] if scenario.climb == "signed" else max(0.0, weight * v[2])
    side_elements = scenario.rows * scenario.group
    panel = (side_elements - 1) ** 2 * (299_792_458 / 5e9 / 2) ** 2
    drag = 0.5 * rho * panel * 2.1 * abs(v[0]) ** 3  # the panel's normal points east
    power = hover_blade * (1 + 3 * V**2 / tip**2) + induced + 0.5 * rho * s * A * 0.6 * V**3 + climb + drag
    return fair / 1e6 - 0.1 * power / (hover_blade + hover_induced), move, rates, power


@pytest.mark.parametrize(
    "scenario",
    [SMALL, preset("prototype_s4"), preset("prototype_s4", motion="spherical")],
    ids=["physical_small", "prototype_s4 cartesian", "prototype_s4 spherical"],
)
def test_steps_agree_with_a_plain_episode(scenario):
    environment = Environment(scenario, batch=3, seed=11)
    environment.reset()
    for slot in range(6):
        raw = random_raw(scenario, 3, slot)
        before = environment.world
        step = environment.step(raw)
        for row in range(3):
            reward, move, rates, power = reward_by_hand(scenario, raw[row].double().numpy(), before, row)
            np.testing.assert_allclose(step.rates.rate_bps[row], rates, rtol=2e-4)
            assert step.power_w[row].item() == pytest.approx(power, rel=1e-4)
            assert step.reward[row].item() == pytest.approx(reward, rel=2e-4, abs=1e-5)
            expected = np.clip(before.position_enu[row].numpy() + move, *np.array(scenario.box_enu).T)
            np.testing.assert_allclose(environment.world.position_enu[row], expected, atol=1e-4)


def test_same_seed_and_batch_give_the_same_episodes_bit_for_bit():
    def rollout(seed: int) -> torch.Tensor:
        environment = Environment(SMALL, batch=5, seed=seed)
        seen = []
        for episode in range(2):
            seen.append(environment.reset())
            for slot in range(4):
                step = environment.step(random_raw(SMALL, 5, 10 * episode + slot))
                seen += [step.observation, step.reward[:, None].expand(-1, state_size(SMALL))]
        return torch.stack(seen)

    assert torch.equal(rollout(1), rollout(1))
    assert not torch.equal(rollout(1), rollout(2))


def test_a_world_does_not_feel_what_others_do():
    first, second = Environment(SMALL, batch=4, seed=0), Environment(SMALL, batch=4, seed=0)
    first.reset(), second.reset()
    for slot in range(3):
        raw = random_raw(SMALL, 4, slot)
        other = raw.clone()
        other[1:] = -other[1:]
        ours, theirs = first.step(raw), second.step(other)
        assert torch.equal(ours.reward[0], theirs.reward[0])
        assert torch.equal(ours.observation[0], theirs.observation[0])


def test_the_reward_is_of_the_channels_observed_and_the_move_acts_on_the_next_slot():
    """`timing: pre`: another move changes the power of the slot, not its rates."""
    still, moving = Environment(SMALL, batch=2, seed=0), Environment(SMALL, batch=2, seed=0)
    still.reset(), moving.reset()
    raw = random_raw(SMALL, 2, 0)
    raw[:, :3] = 0
    moved = raw.clone()
    moved[:, 1] = 1
    a, b = still.step(raw), moving.step(moved)
    assert torch.equal(a.rates.rate_bps, b.rates.rate_bps)
    assert not torch.equal(a.power_w, b.power_w)
    assert not torch.equal(still.step(raw).rates.rate_bps, moving.step(raw).rates.rate_bps)


def test_with_timing_post_the_reward_is_of_the_channels_after_the_move():
    """The same worlds unfold; only which channels a slot's action is rated in differs."""
    pre, post = (Environment(preset("physical_small", timing=timing), batch=3, seed=0) for timing in ("pre", "post"))
    pre.reset(), post.reset()
    for slot in range(3):
        raw = random_raw(SMALL, 3, slot)
        before, after = pre.step(raw), post.step(raw)
        assert torch.equal(before.observation, after.observation)
        assert torch.equal(before.power_w, after.power_w)
        expected = slot_rates(SMALL, post.world.channels, after.action.trc, after.action.beamforming)
        assert torch.equal(after.rates.rate_bps, expected.rate_bps)
        assert not torch.equal(before.rates.rate_bps, after.rates.rate_bps)


def test_imperfect_csi_is_observed_and_exact_channels_are_rated():
    exact = Environment(SMALL, batch=2, seed=0)
    noisy = Environment(preset("physical_small", csi_error_variance=0.3), batch=2, seed=0)
    first, seen = exact.reset(), noisy.reset()
    assert torch.equal(first[:, :3], seen[:, :3])
    assert (first[:, 3:] != seen[:, 3:]).all()
    raw = random_raw(SMALL, 2, 0)
    assert torch.equal(exact.step(raw).rates.rate_bps, noisy.step(raw).rates.rate_bps)


def test_stale_csi_is_that_of_earlier_slots_in_every_episode():
    exact = Environment(preset("physical_small", slots=4), batch=2, seed=0)
    stale = Environment(preset("physical_small", slots=4, csi_delay_slots=2), batch=2, seed=0)
    for _ in range(2):
        now, late = [exact.reset()], [stale.reset()]
        for slot in range(4):
            raw = random_raw(SMALL, 2, slot)
            now.append(exact.step(raw).observation)
            late.append(stale.step(raw).observation)
        for slot in range(5):
            assert torch.equal(late[slot][:, 3:], now[max(0, slot - 2)][:, 3:])
            assert torch.equal(late[slot][:, :3], now[slot][:, :3])


@pytest.mark.parametrize("surface", ["coupled", "independent", "dual", "conventional"])
@pytest.mark.parametrize("bits", [None, 2])
def test_every_surface_can_be_lived_with(surface, bits):
    scenario = preset("physical_small", surface=surface, phase_bits=bits)
    environment = Environment(scenario, batch=2, seed=0)
    environment.reset()
    step = environment.step(random_raw(scenario, 2, 0))
    surface_of(scenario).check(step.action.trc)
    assert torch.isfinite(step.reward).all()


def test_a_flown_tilt_changes_what_the_surface_sees():
    level = Environment(SMALL, batch=2, seed=0)
    tilted = Environment(preset("physical_small", attitude="flown"), batch=2, seed=0)
    assert torch.allclose(level.reset(), tilted.reset(), atol=1e-5)  # at rest it is upright
    raw = random_raw(SMALL, 2, 0)
    raw[:, :3] = torch.tensor([1.0, 0.0, 0.0])
    level.step(raw), tilted.step(raw)
    assert not torch.allclose(level.world.channels.ris_user, tilted.world.channels.ris_user, rtol=1e-2)
    assert torch.equal(level.world.channels.direct, tilted.world.channels.direct)


def test_with_inertia_the_power_is_the_mean_over_the_velocities_on_the_way():
    """Against the flown track sampled finely; from rest and from speed."""
    environment = Environment(SMALL, batch=3, seed=0, acceleration_mps2=3.0)
    environment.reset()
    for slot in range(3):
        raw = random_raw(SMALL, 3, slot)
        before = environment.world.velocity_enu.double()
        step = environment.step(raw)
        after = environment.world.velocity_enu.double()
        time = torch.linspace(0, 1, 2001, dtype=torch.float64)
        ramp = (after - before).norm(dim=-1, keepdim=True) / 3.0
        for row in range(3):
            share = (time[:, None] / ramp[row].clip(min=1e-9)).clip(max=1.0)
            track = before[row] + share * (after[row] - before[row])
            expected = track_power(SMALL, time, track, torch.tensor(0.0, dtype=torch.float64))
            assert step.power_w[row].item() == pytest.approx(
                expected.item(), rel=4e-3
            )  # the ramp may cross from descent to climb, where power has a kink


@pytest.mark.parametrize("batch", [1, 64, 500], ids=["an episode at once", "some slots at once", "slot by slot"])
def test_every_slot_has_fading_of_its_own_however_many_are_drawn_at_once(batch):
    scenario = preset("physical_small", slots=40, user_speed_mps=0.0)
    environment = Environment(scenario, batch=batch, seed=0)
    resting = torch.zeros(batch, action_size(scenario))
    seen = [environment.reset(), *(environment.step(resting).observation for _ in range(40))]
    H, h_b, h_s = torch.split(torch.stack(seen)[:, 0, 3:], [2 * 16 * 4, 2 * 4 * 4, 2 * 4 * 16], dim=-1)
    for link in (H, h_b, h_s):
        assert len(link.unique(dim=0)) == 41


def test_at_the_box_the_vehicle_stops_and_pays_for_what_it_moved():
    """Pushing north (edge-on) against the wall would else cost less than the hovering that it is."""
    scenario = preset("physical_small", start_enu=(0.0, 100.0, 60.0))
    environment = Environment(scenario, batch=1, seed=0)
    environment.reset()
    raw = random_raw(scenario, 1, 0)
    raw[0, :3] = torch.tensor([0.0, 1.0, 0.0])
    step = environment.step(raw)
    assert environment.world.position_enu[0].tolist() == [0.0, 100.0, 60.0]
    assert step.action.displacement_enu[0, 1].item() == pytest.approx(10)
    assert step.power_w.item() == pytest.approx(scenario.hover_power_w, rel=1e-5)


def test_an_episode_lasts_its_slots_and_then_wants_a_reset():
    scenario = preset("physical_small", slots=3)
    environment = Environment(scenario, batch=2, seed=0)
    with pytest.raises(RuntimeError, match="reset first"):
        environment.step(random_raw(scenario, 2, 0))
    environment.reset()
    assert [environment.step(random_raw(scenario, 2, 0)).truncated for _ in range(3)] == [False, False, True]
    with pytest.raises(RuntimeError, match="reset first"):
        environment.step(random_raw(scenario, 2, 0))


def test_every_preset_can_be_lived_in():
    for name in ("paper_literal", "physical_1km", "physical_small", "prototype_s4"):
        environment = Environment(preset(name), batch=2, seed=0)
        environment.reset()
        step = environment.step(random_raw(preset(name), 2, 0))
        assert torch.isfinite(step.reward).all()
        assert torch.isfinite(step.observation).all()
        assert step.observation.shape == (2, state_size(preset(name)))


def test_a_broken_action_is_refused():
    environment = Environment(SMALL, batch=1, seed=0)
    environment.reset()
    with pytest.raises(RawActionError, match="number 3 is not finite"):
        environment.step(torch.full((1, 83), 0.5).index_fill(1, torch.tensor([3]), math.nan))
