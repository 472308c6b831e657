"""Time per slot of the compiled reference beside the same algorithm in plain NumPy, on one thread.

    python benchmarks/reference.py [--seconds 2]

Each row is a fresh slot of the scenario (M = 4, J = 4), solved through the front `rf_model.reference.solve`, one at a
time, channels in and tensors out. Goals are the project's. Ratios are those of this run on this machine.
"""

import argparse
import math
import os
import time
from collections.abc import Callable
from itertools import cycle

os.environ["OMP_NUM_THREADS"] = "1"
os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ["NUMBA_NUM_THREADS"] = "1"

import numpy as np
import torch

from rf_model.channels import Channels, draw_channels
from rf_model.mobility import initial_users
from rf_model.reference.solve import closed_form, solve
from rf_model.scenario import Scenario, preset

GOAL_MS = {("closed form", 16): 0.2, ("closed form", 256): 0.2, ("40 iterations", 16): 0.6, ("40 iterations", 256): 6.0}
SLOTS, BATCH = 32, 256

Array = np.ndarray


class PlainReference:
    """Section by section what the kernel does, in array operations: coupled surface, harmonic objective."""

    def __init__(self, scenario: Scenario, channels: Channels) -> None:
        scale = math.sqrt(scenario.p_max_w / scenario.noise_w)
        self.h_b, self.H = channels.direct.numpy() * scale, channels.bs_ris.numpy() * scale
        self.h_s, self.side = channels.ris_user.numpy(), channels.transmission.numpy().astype(int)
        self.bit = scenario.bandwidth_hz / math.log(2)

    def utility(self, E: Array) -> float:
        power = np.abs(E) ** 2
        own = power.diagonal()
        return len(E) ** 2 / (1 / np.log1p(own / (power.sum(1) - own + 1))).sum()

    def channel(self, phi: Array) -> Array:
        return self.h_b + (self.h_s * phi[self.side]) @ self.H

    def project(self, d: Array) -> Array:
        m = (d[1].conj() * d[0]).imag
        w = np.arctan2(2 * abs(m), abs(d[1]) ** 2 - abs(d[0]) ** 2) / 2
        turn = np.where(m > 0, 1j, -1j)
        S = np.cos(w) * d[1].conj() + turn * np.sin(w) * d[0].conj()
        phasor = S.conj() / abs(S)
        return np.stack((turn * np.sin(w) * phasor, np.cos(w) * phasor))

    def sides(self, by_user: Array) -> Array:
        return np.stack([by_user[self.side == side].sum(0) for side in (0, 1)])

    def zero_forcing(self, G: Array, power: Array) -> Array:
        W = np.linalg.inv(np.eye(G.shape[1]) + (G.conj().T * power) @ G) @ G.conj().T
        return W * np.sqrt(power) / np.linalg.norm(W, axis=0)

    def receivers(self, E: Array) -> tuple[Array, Array]:
        total, own = (np.abs(E) ** 2).sum(1) + 1, E.diagonal()
        error = 1 - np.abs(own) ** 2 / total
        return 1 / np.log(1 / error) ** 2 / error, own.conj() / total

    def beam_step(self, G: Array, W: Array) -> Array:
        E = G @ W
        weight, u = self.receivers(E)
        values, basis = np.linalg.eigh((G.conj().T * (weight * abs(u) ** 2)) @ G)
        target = basis.conj().T @ (G.conj().T * (weight * u.conj()))
        strength = (np.abs(target) ** 2).sum(1)
        low, high = 0.0, math.sqrt(strength.sum())
        for _ in range(50):
            middle = (low + high) / 2
            low, high = (middle, high) if (strength / (values + middle) ** 2).sum() > 1 else (low, middle)
        best = basis @ (target / (values + high)[:, None])
        return max((W + t * (best - W) for t in (0.0, 0.3, 0.6, 1.0)), key=lambda beams: self.utility(G @ beams))

    def closed_form(self) -> tuple[Array, Array]:
        v = np.linalg.svd(self.H)[2][0].conj()
        phasor = np.exp(-1j * np.angle(self.h_b @ v))[:, None]
        phi = self.project(self.sides(phasor * self.h_s * (self.H @ v)).conj())
        return phi, self.zero_forcing(self.channel(phi), np.full(len(self.h_b), 1 / len(self.h_b)))

    def solve(self, iterations: int) -> float:
        phi, W = self.closed_form()
        for _ in range(3):
            W = self.beam_step(self.channel(phi), W)
        step = 1.0
        for _ in range(iterations):
            E = self.channel(phi) @ W
            weight, u = self.receivers(E)
            slope = weight[:, None] * (np.diag(u) - (np.abs(u) ** 2)[:, None] * E.conj())
            gradient = self.sides((self.h_s * (slope @ (self.H @ W).T)).conj())
            gradient /= np.sqrt((np.abs(gradient) ** 2).mean())
            power = (np.abs(W) ** 2).sum(0)
            tried = []
            for factor in (0.4, 1.0, 2.5):
                trial = self.project(phi + step * factor * gradient)
                G = self.channel(trial)
                tried += [(self.utility(G @ V), factor, trial, V) for V in (W, self.zero_forcing(G, power))]
            value, factor, trial, beams = max(tried, key=lambda entry: entry[0])
            if value > self.utility(E):
                phi, W, step = trial, beams, step * factor
            else:
                step /= 2
            W = self.beam_step(self.channel(phi), W)
        return self.utility(self.channel(phi) @ W) * self.bit


def milliseconds(call: Callable[[], object], seconds: float) -> float:
    """Median time of a call, warmed up first (which also compiles)."""
    call()
    times: list[float] = []
    stop = time.perf_counter() + seconds
    while time.perf_counter() < stop or len(times) < 5:
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times))


def slots(scenario: Scenario, count: int) -> Channels:
    generator = torch.Generator().manual_seed(0)
    position = torch.tensor(scenario.start_enu, dtype=torch.float64).expand(count, 3)
    users = initial_users(scenario, (count,), generator, torch.float64)
    return draw_channels(scenario, position, torch.zeros(count, dtype=torch.float64), users.position_enu, generator)


def rows(channels: Channels, count: int) -> list[Channels]:
    fields = (channels.direct, channels.bs_ris, channels.ris_user, channels.transmission)
    return [Channels(*(field[row] for field in fields)) for row in range(count)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=2.0, help="time for each measurement")
    seconds = parser.parse_args().seconds
    torch.set_num_threads(1)
    print(f"numpy {np.__version__}, one thread; ms a slot, median")
    for name in ("prototype_s4", "physical_1km"):
        scenario = preset(name)
        batch = slots(scenario, BATCH)
        single = rows(batch, SLOTS)
        plain = [PlainReference(scenario, channels) for channels in single]
        ours = float(np.mean([float(solve(scenario, channels, 40).utility_bps[-1]) for channels in single]))
        theirs = float(np.mean([reference.solve(40) for reference in plain]))
        print(f"\n{name}: N={scenario.elements} M={scenario.antennas} J={scenario.users}")
        print(f"fair rate after 40 iterations: {ours / 1e6:.4f} Mbit/s, plain NumPy {theirs / 1e6:.4f}")
        print(
            f"  {'':16}{'goal':>8}{'one slot':>10}{'of goal':>9}{f'batch {BATCH}':>11}{'NumPy':>9}{'NumPy / one':>13}"
        )
        for label, iterations in (("closed form", None), *((f"{n} iterations", n) for n in (0, 1, 10, 40, 100))):

            def compiled(
                channels: Channels, iterations: int | None = iterations, scenario: Scenario = scenario
            ) -> None:
                if iterations is None:
                    closed_form(scenario, channels)
                else:
                    solve(scenario, channels, iterations)

            def by_numpy(reference: PlainReference, iterations: int | None = iterations) -> None:
                if iterations is None:
                    reference.closed_form()
                else:
                    reference.solve(iterations)

            slot, slow = cycle(single), cycle(plain)
            one = milliseconds(lambda slot=slot, run=compiled: run(next(slot)), seconds)
            many = milliseconds(lambda batch=batch, run=compiled: run(batch), seconds) / BATCH
            numpy_one = milliseconds(lambda slow=slow, run=by_numpy: run(next(slow)), seconds)
            goal = GOAL_MS.get((label, scenario.elements))
            of_goal = f"{goal:8.1f}{one:10.3f}{one / goal:9.2f}" if goal else f"{'':8}{one:10.3f}{'':9}"
            print(f"  {label:16}{of_goal}{many:11.3f}{numpy_one:9.2f}{numpy_one / one:13.0f}")


if __name__ == "__main__":
    main()
