"""Steps per second of the batched environment beside a plain per-user-loop NumPy one, on one thread.

    python benchmarks/environment.py [--seconds 3]

The NumPy version is what one writes first: one world, a loop over users, the same physics (fresh fading, decoding,
SINR, rates, power, reward, motion, users walking, observation). Steps are per second of processor time of the one
thread, so that a machine shared with others is judged fairly; ratios are those of this run on this machine. That both
do the same is to be seen by their mean episode rewards under random actions, each with its standard error. The last
line is the peak memory of 1024 worlds of 256 elements, in a process of their own.
"""

import argparse
import math
import os
import resource
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import gymnasium
import numpy as np
import torch

import agent  # noqa: F401 - registers AerialStar-v0
from agent.decoding import action_size
from agent.environment import Environment
from agent.observation import Normalisation
from rf_model.scenario import Scenario, preset

Vector = np.ndarray


class PlainWorld:
    """One world of `physical_small` or `physical_1km`, in scalars and small arrays."""

    def __init__(self, scenario: Scenario, seed: int) -> None:
        self.s = scenario
        self.rng = np.random.default_rng(seed)
        self.norm = Normalisation.of(scenario)
        self.reset()

    def reset(self) -> Vector:
        s, rng = self.s, self.rng
        self.slot = 0
        self.position = np.array(s.start_enu)
        self.users, self.headings = [], []
        for j in range(s.users):
            inner, outer = s.user_radius_m
            radius = math.sqrt(inner**2 + rng.random() * (outer**2 - inner**2))
            angle = (math.pi if j < s.reflection_count else 0.0) + (2 * rng.random() - 1) * s.user_half_angle_rad
            self.users.append(np.array([radius * math.cos(angle), radius * math.sin(angle), s.user_height_m]))
            self.headings.append(2 * math.pi * rng.random())
        return self.open_slot()

    def scatter(self, *shape: int) -> Vector:
        return (self.rng.standard_normal(shape) + 1j * self.rng.standard_normal(shape)) / math.sqrt(2)

    def panel_phases(self, direction: Vector) -> Vector:
        s = self.s
        phases = np.empty(s.elements)
        for n in range(s.elements):
            column, row = n % s.columns, n // s.columns
            phases[n] = 2 * math.pi * s.group / s.mu * (column * direction[1] + row * direction[2])
        return np.exp(1j * phases)

    def open_slot(self) -> Vector:
        s = self.s
        base = np.array(s.base_station_enu)
        los, nlos = math.sqrt(s.kappa / (s.kappa + 1)), math.sqrt(1 / (s.kappa + 1))
        carrier_db = 20 * math.log10(s.carrier_hz / 1e9)
        to_base = base - self.position
        distance = np.linalg.norm(to_base)
        gain = 10 ** (-(carrier_db + 28 + 22 * math.log10(distance) - s.ris_gain_db) / 20)
        departure = np.exp(1j * math.pi * np.arange(s.antennas) * (-to_base[1] / distance))
        arrival = self.panel_phases(to_base / distance)
        self.H = gain * (los * np.outer(arrival, departure.conj()) + nlos * self.scatter(s.elements, s.antennas))
        self.h_b, self.h_s, self.across = [], [], []
        for user in self.users:
            far = np.linalg.norm(user - base)
            loss = 36.7 * math.log10(far) + 22.7 + 26 * math.log10(s.carrier_hz / 1e9) - 0.3 * (s.user_height_m - 1.5)
            loss = max(loss, carrier_db + 28 + 22 * math.log10(far)) + s.direct_extra_db
            self.h_b.append(10 ** (-loss / 20) * self.scatter(s.antennas))
            to_user = user - self.position
            near = np.linalg.norm(to_user)
            amplitude = 10 ** (-(carrier_db + 28 + 22 * math.log10(near)) / 20)
            elevation = math.degrees(math.asin(-to_user[2] / near))
            if self.rng.random() < 1 / (1 + 9.61 * math.exp(-0.16 * (elevation - 9.61))):
                h = amplitude * (los * self.panel_phases(to_user / near) + nlos * self.scatter(s.elements))
            else:
                h = amplitude * 0.1 * self.scatter(s.elements)
            self.h_s.append(h)
            self.across.append(to_user[0] * to_base[0] < 0)
        n = self.norm
        parts = [(self.position - n.centre.numpy()) / n.half_size.numpy()]
        for block, scale in ((self.H, n.bs_ris), (np.array(self.h_b), n.direct), (np.array(self.h_s), n.ris_user)):
            parts += [np.stack([block.real, block.imag], -1).ravel() / scale]
        return np.concatenate(parts)

    def step(self, raw: Vector) -> tuple[Vector, float]:
        s = self.s
        N, M, J = s.elements, s.antennas, s.users
        reach = s.v_max_mps * s.slot_s
        move = raw[:3] * reach
        move = move * min(1.0, reach / np.linalg.norm(move))
        move[2] = min(max(move[2], -s.climb_down_mps), s.climb_up_mps)
        theta, split = math.pi * raw[3 : 3 + N], (raw[3 + N : 3 + 2 * N] + 1) * math.pi / 4
        w = raw[3 + 2 * N : 3 + 2 * N + 2 * M * J].reshape(M, J, 2)
        W = w[..., 0] + 1j * w[..., 1]
        W = W * math.sqrt(s.p_max_w) / np.linalg.norm(W)
        sign = np.where(raw[3 + 2 * N + 2 * M * J :] > 0, 1, -1)
        reflection = np.sin(split) * np.exp(1j * theta)
        transmission = np.cos(split) * np.exp(1j * (theta + sign * math.pi / 2))
        rates = []
        for j in range(J):
            phi = transmission if self.across[j] else reflection
            g = self.h_b[j] + (self.h_s[j] * phi) @ self.H
            powers = [abs(g @ W[:, k]) ** 2 for k in range(J)]
            rates.append(s.bandwidth_hz * math.log2(1 + powers[j] / (sum(powers) - powers[j] + s.noise_w)))
        fair = J**2 / sum(1 / max(rate, 1.0) for rate in rates)

        low, high = np.array(s.box_enu).T
        position = np.clip(self.position + move, low, high)
        wing, v = s.wing, (position - self.position) / s.slot_s
        V = math.hypot(v[0], v[1])
        blade = wing.air_density * wing.profile_drag * wing.disc_area_m2 * wing.solidity * wing.tip_speed_mps**3 / 8
        power = blade * (1 + 3 * V**2 / wing.tip_speed_mps**2)
        a = V**2 / (2 * wing.induced_velocity_mps**2)
        hover = wing.weight_n**1.5 / math.sqrt(2 * wing.air_density * wing.disc_area_m2)
        power += hover * math.sqrt(math.sqrt(1 + a * a) - a)
        power += 0.5 * wing.air_density * wing.solidity * wing.disc_area_m2 * wing.fuselage_drag_ratio * V**3
        power += max(0.0, wing.weight_n * v[2])
        power += 0.5 * wing.air_density * s.panel.area_m2 * s.panel.drag_coefficient * abs(v[0]) ** 3
        reward = s.alpha * fair / 1e6 - s.beta * power / s.hover_power_w

        self.slot += 1
        self.position = position
        for j in range(J):
            self.headings[j] += 0.5 * self.rng.standard_normal()
            step = s.user_speed_mps * s.slot_s
            moved = self.users[j] + step * np.array([math.cos(self.headings[j]), math.sin(self.headings[j]), 0.0])
            side = -1 if j < s.reflection_count else 1
            if s.user_radius_m[0] <= math.hypot(moved[0], moved[1]) <= s.user_radius_m[1] and side * moved[0] >= 0:
                self.users[j] = moved
            else:
                self.headings[j] += math.pi
        return self.open_slot(), reward


def rate(step: Callable[[], None], seconds: float) -> float:
    """Calls of `step` per second of processor time, warmed up first."""
    step()
    count, start = 0, time.process_time()
    while time.process_time() - start < seconds:
        step()
        count += 1
    return count / (time.process_time() - start)


def batched(scenario: Scenario, batch: int, seconds: float) -> float:
    environment = Environment(scenario, batch, seed=0)
    raw = torch.rand(batch, action_size(scenario), generator=torch.Generator().manual_seed(0)) * 2 - 1

    def step() -> None:
        if environment.step(raw).truncated:
            environment.reset()

    with torch.inference_mode():
        environment.reset()
        return batch * rate(step, seconds)


def vector(scenario: Scenario, batch: int, seconds: float) -> float:
    envs = gymnasium.make_vec("AerialStar-v0", num_envs=batch, scenario=scenario)
    envs.reset(seed=0)
    raw = envs.action_space.sample()
    return batch * rate(lambda: envs.step(raw), seconds)


def front(scenario: Scenario, seconds: float) -> float:
    env = gymnasium.make("AerialStar-v0", scenario=scenario)
    env.reset(seed=0)
    raw = env.action_space.sample()

    def step() -> None:
        if env.step(raw)[3]:
            env.reset()

    return rate(step, seconds)


def plain(scenario: Scenario, seconds: float) -> float:
    world = PlainWorld(scenario, seed=0)
    raw = np.random.default_rng(0).uniform(-1, 1, action_size(scenario))

    def step() -> None:
        world.step(raw)
        if world.slot == scenario.slots:
            world.reset()

    return rate(step, seconds)


def episode_rewards(scenario: Scenario) -> dict[str, tuple[float, float]]:
    """Mean and standard error of an episode's reward under random actions, batched and plain."""
    generator, rng = torch.Generator().manual_seed(1), np.random.default_rng(1)
    environment, world = Environment(scenario, EPISODES["batched"], seed=1), PlainWorld(scenario, seed=1)
    size = action_size(scenario)
    batched, plain = torch.zeros(EPISODES["batched"]), np.zeros(EPISODES["plain NumPy"])
    with torch.inference_mode():
        environment.reset()
        for _ in range(scenario.slots):
            batched += environment.step(torch.rand(len(batched), size, generator=generator) * 2 - 1).reward
    for episode in range(len(plain)):
        world.reset()
        plain[episode] = sum(world.step(rng.uniform(-1, 1, size))[1] for _ in range(scenario.slots))
    return {
        name: (float(rewards.mean()), float(rewards.std(ddof=1)) / math.sqrt(len(rewards)))
        for name, rewards in (("batched", batched.numpy()), ("plain NumPy", plain))
    }


def peak_memory_mib() -> float:
    """Of this process after a few steps of 1024 worlds of `physical_1km`."""
    scenario = preset("physical_1km")
    environment = Environment(scenario, 1024, seed=0)
    with torch.inference_mode():
        environment.reset()
        for _ in range(3):
            environment.step(torch.rand(1024, action_size(scenario)) * 2 - 1)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


GOALS = {
    ("physical_small", "Gymnasium, 1 world"): 1_500,
    ("physical_small", "batched, 1024 worlds"): 120_000,
    ("physical_1km", "batched, 256 worlds"): 8_000,
}
"""Steps per second on one core."""


EPISODES = {"batched": 2048, "plain NumPy": 512}
"""Flown to compare rewards."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=3.0, help="time for each measurement")
    seconds = parser.parse_args().seconds
    torch.set_num_threads(1)
    print(f"torch {torch.__version__}, numpy {np.__version__}, one thread\n")
    for name, batches in (("physical_small", (1, 64, 1024)), ("physical_1km", (1, 64, 256))):
        scenario = preset(name, motion="cartesian")
        measured = {"plain NumPy, loop per user": plain(scenario, seconds)}
        measured["Gymnasium, 1 world"] = front(scenario, seconds)
        for batch in batches:
            measured[f"batched, {batch} worlds"] = batched(scenario, batch, seconds)
        measured[f"Gymnasium vector, {batches[-1]}"] = vector(scenario, batches[-1], seconds)
        base = measured["plain NumPy, loop per user"]
        print(f"{name}: N={scenario.elements} M={scenario.antennas} J={scenario.users}")
        earned = episode_rewards(scenario)
        said = ", ".join(f"{who} {mean:.3f} +- {error:.3f}" for who, (mean, error) in earned.items())
        print(f"  episode reward of random actions, mean +- standard error: {said}")
        print(f"  {'':28}{'steps/s':>12}{'ratio':>9}{'goal':>12}")
        for what, speed in measured.items():
            goal = GOALS.get((name, what))
            print(f"  {what:28}{speed:12,.0f}{speed / base:9.1f}{f'{goal:,}' if goal else '':>12}")
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        print(f"peak memory, N=256, 1024 worlds: {pool.submit(peak_memory_mib).result():,.0f} MiB (goal: below 2048)")


if __name__ == "__main__":
    main()
