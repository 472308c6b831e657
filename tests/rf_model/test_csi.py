"""Imperfect channel state information: as wrong and as late as the scenario says, and exact by default."""

import pytest
import torch

from rf_model.channels import Channels
from rf_model.csi import Observed, estimate
from rf_model.scenario import preset


def channels(seed: int, batch: int = 1) -> Channels:
    generator = torch.Generator().manual_seed(seed)

    def drawn(scale, *shape):
        return scale * torch.randn(batch, *shape, dtype=torch.complex128, generator=generator)

    direct = drawn(1e-6, 3, 4) * torch.tensor([1.0, 10.0, 0.0])[:, None]
    return Channels(direct, drawn(1e-3, 8, 4), drawn(1e-4, 3, 8), torch.tensor([seed % 2 == 0, True, False]))


def test_error_has_the_variance_relative_to_each_link():
    true = channels(1, batch=4000)
    seen = estimate(true, 0.25, torch.Generator().manual_seed(2))
    for link in ("direct", "bs_ris", "ris_user"):
        error = getattr(seen, link) - getattr(true, link)
        rows = (0, 2) if link != "bs_ris" else (0, 1, 2)
        ratio = error.abs().square().mean(rows) / getattr(true, link).abs().square().mean(rows).clamp_min(1e-300)
        silent = getattr(true, link).abs().square().mean(rows) == 0
        torch.testing.assert_close(ratio[~silent], torch.full_like(ratio[~silent], 0.25), rtol=0.03, atol=0)
        assert (error.abs().square().mean(rows)[silent] == 0).all()
        circular = (error**2).mean().abs() / error.abs().square().mean()
        assert circular < 0.05
    assert torch.equal(seen.transmission, true.transmission)


def test_exact_by_default_and_nothing_drawn():
    generator = torch.Generator().manual_seed(0)
    before = generator.get_state()
    true = channels(1)
    assert Observed(preset("physical_small")).of(true, generator) is true
    assert torch.equal(generator.get_state(), before)


@pytest.mark.parametrize("delay", [1, 3])
def test_channels_come_late_and_the_first_ones_stay_until_then(delay):
    observed = Observed(preset("physical_small", csi_delay_slots=delay))
    generator = torch.Generator()
    drawn = [channels(slot) for slot in range(6)]
    for _ in range(2):
        for slot, true in enumerate(drawn):
            seen = observed.of(true, generator)
            assert torch.equal(seen.bs_ris, drawn[max(0, slot - delay)].bs_ris)
            assert torch.equal(seen.transmission, true.transmission)
        observed.forget()
