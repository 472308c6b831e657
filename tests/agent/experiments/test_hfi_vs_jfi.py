"""The indices against closed forms, and what optimising for each does."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from agent.experiments.hfi_vs_jfi import optimised_rates, spreads
from agent.experiments.snapshots import snapshots
from rf_model.fairness import hfi, jfi
from rf_model.reference.solve import solve
from rf_model.scenario import preset


def indices(rates):
    rates = torch.tensor(rates, dtype=torch.float64) * 1e6
    return hfi(rates).item(), jfi(rates).item()


def spread(family, users):
    (found,) = (one for one in spreads(points=2000) if (one.family, one.users) == (family, users))
    return found


def test_one_rich_user_is_the_designs_counterexample():
    harmonic, jain = indices([10.0, *[1.0] * 7])
    assert (round(harmonic, 2), round(jain, 2)) == (0.53, 0.34)


@given(st.integers(2, 32), st.floats(1e-3, 2000.0))
def test_jfi_is_stricter_on_one_rich_user_exactly_up_to_users_less_one_squared(users, times):
    harmonic, jain = indices([times, *[1.0] * (users - 1)])
    edge = (users - 1) ** 2
    if 1.01 < times < 0.99 * edge:
        assert jain < harmonic
    elif times < 0.99 or times > 1.01 * max(edge, 1.0):
        assert harmonic < jain


def test_jfi_follows_from_the_variation_alone():
    for one in spreads():
        assert one.jfi.numpy() == pytest.approx(1 / (1 + one.variation.numpy() ** 2), rel=1e-6)


def test_two_users_hfi_by_the_variation_and_always_the_stricter():
    for family in ("one poor", "one rich", "even", "exponential"):
        two = spread(family, 2)
        assert two.hfi.numpy() == pytest.approx(1 - two.variation.numpy() ** 2, abs=1e-6)
        assert (two.hfi <= two.jfi + 1e-9).all()


def test_poor_users_make_hfi_the_stricter_and_more_users_the_more_so():
    at = np.linspace(0.05, 0.3, 6)
    before = 1 - at**2
    for users in (4, 8, 16):
        even = spread("even", users)
        assert (even.hfi <= even.jfi + 1e-9).all()
        assert (spread("one poor", users).hfi <= spread("one poor", users).jfi + 1e-9).all()
        here = np.interp(at, even.variation, even.hfi)
        assert (here < before).all()
        before = here


def test_one_rich_user_is_minded_less_the_more_users():
    at = np.linspace(0.1, 1.0, 10)
    found = [np.interp(at, one.variation, one.hfi) for one in (spread("one rich", users) for users in (4, 8, 16))]
    assert (found[0] < found[1]).all()
    assert (found[1] < found[2]).all()


def test_the_climb_for_hfi_reaches_what_the_reference_does():
    scenario = preset("prototype_s4")
    channels = snapshots(scenario, 8, 1)
    climbed = 16 / (1 / optimised_rates(scenario, channels)["hfi"]).sum(-1)
    assert climbed.mean() > 0.97 * solve(scenario, channels, 40).utility_bps[..., -1].mean()


def test_hfi_leaves_fewer_below_qos_when_all_can_be_carried_and_more_when_starved():
    def shares(power):
        scenario = preset("prototype_s4", p_max_dbm=power)
        rates = optimised_rates(scenario, snapshots(scenario, 16, 2))
        return {name: (rate < scenario.qos_bps).double().mean().item() for name, rate in rates.items()}

    carried, starved = shares(29.0), shares(15.0)
    assert carried["hfi"] <= carried["jfi"]
    assert carried["hfi"] < 0.02
    assert starved["hfi"] > starved["jfi"] + 0.1
    assert carried["sum_rate"] > 0.5


def test_snapshots_share_users_and_sights_between_sizes():
    small, large = (snapshots(preset("physical_1km", rows=side, columns=side, kappa=1e6), 4, 3) for side in (4, 6))
    # At this Rician factor the amplitude of a link in sight is the path loss, and the others' scatter about theirs.
    seen = small.ris_user.abs().std(-1) < 0.01 * small.ris_user.abs().mean(-1)
    assert seen.any()
    assert not seen.all()
    assert torch.equal(seen, large.ris_user.abs().std(-1) < 0.01 * large.ris_user.abs().mean(-1))
    near = small.ris_user[seen].abs().mean(-1)
    assert near.numpy() == pytest.approx(large.ris_user[seen].abs().mean(-1).numpy(), rel=0.01)
    assert math.isfinite(near.sum())
