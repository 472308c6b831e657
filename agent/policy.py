"""What a mission file may name as its policy. Light to import: no torch here, `agent.policies` builds the rest."""

from pathlib import Path
from typing import TYPE_CHECKING, Literal, Protocol

from pydantic import BaseModel, ConfigDict, model_validator

if TYPE_CHECKING:
    from torch import Tensor

SHIPPED_FOLDER = Path(__file__).parent / "checkpoints"
DEFAULT_CHECKPOINT = "physical_small"
SUFFIX = ".safetensors"


class Policy(Protocol):
    """A decision rule: observations in, raw actions out. Stateless: the same arguments give the same answer."""

    @property
    def name(self) -> str:
        """Who decides, as `Action.source` and tables show it."""

    def __call__(self, observation: "Tensor", slot: int) -> "Tensor":
        """Raw actions [..., 3 + 3N + 2MJ] in [-1, 1] for observations [..., S] made at the opening of `slot`."""


class PolicyConfig(BaseModel):
    """Which policy flies: a trained DA-DDPG actor pair, random actions, or hovering with a neutral surface."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    kind: Literal["da_ddpg", "random", "hover"] = "da_ddpg"
    checkpoint: str | None = None
    """Only for `da_ddpg`: a file ending in `.safetensors`, or the name of a shipped checkpoint."""

    @model_validator(mode="after")
    def _checkpoint_belongs_to_kind(self) -> "PolicyConfig":
        if self.kind != "da_ddpg" and self.checkpoint is not None:
            raise ValueError(f"checkpoint: {self.checkpoint!r} given, but kind {self.kind!r} takes none")
        if self.checkpoint is not None and not self.checkpoint.endswith(SUFFIX):
            shipped = shipped_checkpoints()
            if self.checkpoint not in shipped:
                raise ValueError(
                    f"checkpoint: {self.checkpoint!r} is neither a file ending in {SUFFIX} "
                    f"nor a shipped one ({', '.join(shipped) or 'none'})"
                )
        return self

    @property
    def checkpoint_path(self) -> Path | None:
        """The checkpoint's file (it may not exist yet); None when the kind needs none."""
        if self.kind != "da_ddpg":
            return None
        name = self.checkpoint or DEFAULT_CHECKPOINT
        return Path(name) if name.endswith(SUFFIX) else SHIPPED_FOLDER / f"{name}{SUFFIX}"


def shipped_checkpoints() -> list[str]:
    """Names of the checkpoints that come with the package."""
    return sorted(path.stem for path in SHIPPED_FOLDER.glob(f"*{SUFFIX}"))
