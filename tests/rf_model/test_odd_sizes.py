"""The rf node's world lives with sizes that are unusual, whoever sets the surface."""

import math

import pytest

from bus.messages import ChannelState, LinkReport
from rf_model.ris_control import RisControl
from rf_model.scenario import preset
from rf_model.slot_radio import SlotRadio
from tests.rf_model.test_slot_radio import opened


@pytest.mark.parametrize(
    "fields",
    [
        {"reflection_users": 0, "region": "fixed"},
        {"reflection_users": 4, "region": "fixed"},
        {"users": 1},
        {"users": 6, "antennas": 2},
        {"antennas": 1},
        {"rows": 2, "columns": 5},
        {"rows": 1, "columns": 1},
    ],
    ids=["P = 0", "Q = 0", "J = 1", "M < J", "M = 1", "not square", "N = 1"],
)
@pytest.mark.parametrize("ris", ["agent", "closed_form", "optimised"])
def test_reports_of_odd_sizes_are_whole(fields, ris):
    scenario = preset("physical_small", **fields)
    radio = SlotRadio(scenario, 0, RisControl(mode=ris, iterations=2))
    *_, state = radio.open(opened(0))
    assert isinstance(state, ChannelState)
    assert [len(state.direct), len(state.bs_ris)] == [scenario.users, scenario.elements]
    (report,) = (out for out in radio.open(opened(1, closing=True)) if isinstance(out, LinkReport))
    assert len(report.rate_bps) == scenario.users
    assert all(math.isfinite(rate) and rate >= 0 for rate in report.rate_bps)
    if "reflection_users" in fields:
        assert report.regions.count("reflection") == fields["reflection_users"]


@pytest.mark.parametrize(
    "position", [(50.0, 10.0, 1.5), (-1000.0, 0.0, 25.0)], ids=["at ground", "at the base station"]
)
def test_a_vehicle_that_strays_onto_user_or_base_station_is_reported_in_finite_numbers(position):
    """Distances count as at least 1 m: a flight does not end because of where the vehicle is."""
    radio = SlotRadio(preset("physical_small", path_loss="3gpp"), 0)
    radio.open(opened(0, position_enu=position))
    (report,) = (out for out in radio.open(opened(1, closing=True)) if isinstance(out, LinkReport))
    assert all(math.isfinite(rate) for rate in report.rate_bps)
    assert math.isfinite(report.reward)
