"""Settings for all tests."""

import os

from hypothesis import settings

# No example may fail for being slow. CI judges a change by the same examples every time; elsewhere they vary.
settings.register_profile("aerialstar", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("aerialstar")


def pytest_addoption(parser):
    parser.addoption(
        "--autopilot",
        metavar="URL",
        help="fly test_vehicle_contract.py against the autopilot there, e.g. a real PX4 SITL at udpin://0.0.0.0:14540",
    )
