"""What of the channels is known: estimated with an error, and late."""

from collections import deque
from dataclasses import replace

import torch
from torch import Tensor

from rf_model.channels import Channels
from rf_model.fading import rayleigh
from rf_model.scenario import Scenario


def estimate(channels: Channels, error_variance: float, generator: torch.Generator) -> Channels:
    """Channels with independent CN errors added: `error_variance` times the mean power of each link's coefficients.

    A link is the whole of H, and each user's row of h_b and of h_s. The same channels come back for variance 0, and
    nothing is drawn. Which side a user is on is known.
    """
    if error_variance == 0.0:
        return channels
    return replace(
        channels,
        direct=_noisy(channels.direct, (-1,), error_variance, generator),
        bs_ris=_noisy(channels.bs_ris, (-2, -1), error_variance, generator),
        ris_user=_noisy(channels.ris_user, (-1,), error_variance, generator),
    )


class Observed:
    """The channels that the agent observes, slot by slot: estimates that are `csi_delay_slots` old.

    In the first slots the oldest estimate there is. Regions are of the slot itself, since positions are known.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._error_variance = scenario.csi_error_variance
        self._estimates: deque[Channels] = deque(maxlen=scenario.csi_delay_slots + 1)

    def of(self, channels: Channels, generator: torch.Generator) -> Channels:
        """What is observed in the slot of these channels, which are estimated now and become known later."""
        estimated = estimate(channels, self._error_variance, generator)
        if self._estimates.maxlen == 1:
            return estimated
        self._estimates.append(estimated)
        return replace(self._estimates[0], transmission=channels.transmission)

    def forget(self) -> None:
        """Begin afresh: the next slot is the first."""
        self._estimates.clear()


def _noisy(link: Tensor, within: tuple[int, ...], variance: float, generator: torch.Generator) -> Tensor:
    power = link.abs().square().mean(within, keepdim=True)
    error = rayleigh(tuple(link.shape), generator, link.real.dtype)
    return link + error * (variance * power).sqrt()
