"""Who sets the surface and the beams in a slot: the agent, or the rf node by itself from what it observes."""

from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from rf_model.scenario import Scenario

if TYPE_CHECKING:
    from rf_model.channels import Channels
    from rf_model.reference.solve import Solution


class RisControlError(ValueError):
    """A way to set the surface that the scenario does not allow; one line names field, value and what is allowed."""


class RisControl(BaseModel):
    """How the surface is set; a mode's name stands for it with the other fields at their defaults."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    mode: Literal["agent", "closed_form", "optimised"] = "agent"
    """`agent`: from the action. `closed_form`, `optimised`: from the channels observed, by the reference of that name;
    an action then moves the vehicle and nothing else."""
    iterations: Annotated[int, Field(ge=0, le=10_000)] = 40
    """Of `optimised`."""

    @model_validator(mode="before")
    @classmethod
    def _named(cls, value: Any) -> Any:  # noqa: ANN401 - whatever the file holds
        return {"mode": value} if isinstance(value, str) else value

    @property
    def by_itself(self) -> bool:
        """Whether the rf node sets the surface without the agent."""
        return self.mode != "agent"

    def require_fit(self, scenario: Scenario) -> None:
        """Raise RisControlError when the scenario does not allow the mode."""
        if self.by_itself and scenario.sinr != "power":
            raise RisControlError(
                f"ris.mode: {self.mode!r} is not allowed with scenario.sinr {scenario.sinr!r}: 'agent' is, "
                "or any mode with sinr 'power'"
            )


def reference_solution(scenario: Scenario, ris: RisControl, observed: "Channels") -> "Solution":
    """What the surface and the beams are set to, by the mode `closed_form` or `optimised`, phase bits included.

    Raises ReferenceInputError.
    """
    from rf_model.reference.solve import closed_form, quantised, solve

    found = closed_form(scenario, observed) if ris.mode == "closed_form" else solve(scenario, observed, ris.iterations)
    return quantised(scenario, observed, found)
