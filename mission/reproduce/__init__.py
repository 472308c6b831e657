"""`aerialstar reproduce`: the paper's figures, each computed, drawn and told beside what the paper says of it."""

from collections.abc import Mapping
from types import MappingProxyType

FIGURES: Mapping[str, str] = MappingProxyType(
    {
        "power_vs_speed": "power against speed for 0 to 1024 elements",
        "hfi_vs_jfi": "fairness indices against spread, QoS violations under each",
        "efficiency_vs_elements": "sum rate over power against the surface's size",
        "ris_types": "coupled, independent, dual and conventional surface",
        "complexity": "operations and parameters of the networks",
    }
)
"""Names and what they show. Each is a module of this package with `reproduce(seed, episodes)`."""


class ReproduceError(ValueError):
    """Something asked for cannot be; one line naming field, value and what is allowed."""
