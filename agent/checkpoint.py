"""Policies on disk: safetensors with JSON metadata, so that a file that flies can run no code.

Nothing here needs torch, so that a mission file's checkpoint can be judged before anything starts.
"""

import importlib.metadata
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from agent.training_config import TrainingConfig
from rf_model.scenario import Scenario

LIBRARIES = ("aerial-star", "numpy", "torch", "safetensors")


class CheckpointError(ValueError):
    """The file is no usable checkpoint; the text says which file and why, in one line."""


class Metadata(BaseModel):
    """All that is needed to know what a checkpoint is and to train it again."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    format: Literal["aerialstar-daddpg-1"] = "aerialstar-daddpg-1"
    elements: int
    """N"""
    antennas: int
    """M"""
    users: int
    """J"""
    motion: str
    state_norm: str
    hidden: tuple[int, ...]
    config: dict[str, Any]
    """The `TrainingConfig`, as JSON."""
    scenario: dict[str, Any]
    """The `Scenario` it was trained in, as JSON."""
    training: dict[str, Any]
    """What training came to: episodes, evaluation beside random and hovering."""
    versions: dict[str, str]


@dataclass(frozen=True)
class Checkpoint:
    """Weights by name (`continuous_actor.*`, `discrete_actor.*`) and what they are."""

    metadata: Metadata
    arrays: dict[str, NDArray[np.float32]]


def describe(scenario: Scenario, config: TrainingConfig, training: dict[str, Any]) -> Metadata:
    """Metadata of a policy trained with `config` in `scenario`."""
    return Metadata(
        elements=scenario.elements,
        antennas=scenario.antennas,
        users=scenario.users,
        motion=scenario.motion,
        state_norm=scenario.state_norm,
        hidden=config.hidden,
        config=config.model_dump(mode="json"),
        scenario=scenario.model_dump(mode="json"),
        training=training,
        versions={name: importlib.metadata.version(name) for name in LIBRARIES},
    )


def save(path: Path, checkpoint: Checkpoint) -> None:
    """Write a checkpoint whole or not at all. Raises OSError when the folder cannot be written."""
    part = path.with_name(path.name + ".part")
    save_file(checkpoint.arrays, part, metadata={"aerialstar": checkpoint.metadata.model_dump_json()})
    part.replace(path)


def read_metadata(path: Path) -> Metadata:
    """What a checkpoint is, without its weights. Raises CheckpointError."""
    return _read(path, weights=False).metadata


def load(path: Path) -> Checkpoint:
    """Read a checkpoint. Raises CheckpointError."""
    return _read(path, weights=True)


def require_fit(path: Path, metadata: Metadata, scenario: Scenario) -> None:
    """Raise CheckpointError when a policy's inputs or outputs are not those of `scenario`."""
    for name, symbol in (
        ("elements", " N"),
        ("antennas", " M"),
        ("users", " J"),
        ("motion", ""),
        ("state_norm", ""),
    ):
        has, wants = getattr(metadata, name), getattr(scenario, name)
        if has != wants:
            raise CheckpointError(f"checkpoint {path}: trained with {name}{symbol} = {has}, the scenario has {wants}")
    for name, before in (("surface", "coupled"), ("state_extra", [])):  # which older checkpoints do not name
        has, wants = metadata.scenario.get(name, before), scenario.model_dump(mode="json", include={name})[name]
        if has != wants:
            raise CheckpointError(f"checkpoint {path}: trained with {name} = {has}, the scenario has {wants}")


def _read(path: Path, *, weights: bool) -> Checkpoint:
    if not path.is_file():
        raise CheckpointError(f"checkpoint {path}: no such file")
    try:
        with safe_open(path, framework="numpy") as file:
            text = (file.metadata() or {}).get("aerialstar")
            arrays = {name: file.get_tensor(name) for name in file.keys()} if weights else {}  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        raise CheckpointError(f"checkpoint {path}: not a safetensors file ({error})") from error
    if text is None:
        raise CheckpointError(f"checkpoint {path}: a safetensors file, but not one of Aerial-STAR's")
    try:
        metadata = Metadata.model_validate_json(text)
    except ValidationError as error:
        detail = error.errors()[0]
        where = ".".join(str(part) for part in detail["loc"]) or "JSON"
        raise CheckpointError(f"checkpoint {path}: metadata {where}: {detail['msg']}") from error
    return Checkpoint(metadata, arrays)
