"""What a slot was worth (paper, reward equation)."""

from torch import Tensor

from rf_model.scenario import Scenario


def reward(scenario: Scenario, fair_rate_bps: Tensor, power_w: Tensor) -> Tensor:
    """alpha HFI sum R [Mbit/s] - beta P / P_hover, [...]: both terms of order one, where the paper gives no units."""
    return scenario.alpha * 1e-6 * fair_rate_bps - (scenario.beta / scenario.hover_power_w) * power_w
