"""What cannot be rebuilt from a recording is refused; what can is tested on a real flight in tests/e2e."""

import pytest
import yaml

from mission.flight_log import FlightLogError
from mission.transitions import transitions


@pytest.mark.parametrize(
    ("field", "value"),
    [("timing", "post"), ("surface", "independent"), ("phase_bits", 2), ("csi_delay_slots", 1)],
)
def test_a_recording_that_does_not_hold_a_whole_transition_is_refused_by_field(tmp_path, field, value):
    scenario = {"preset": "physical_small", field: value}
    (tmp_path / "mission.yaml").write_text(
        yaml.safe_dump({"name": "other", "scenario": scenario, "policy": {"kind": "random"}})
    )
    with pytest.raises(FlightLogError, match=rf"scenario\.{field}: .*only with"):
        transitions(tmp_path)
