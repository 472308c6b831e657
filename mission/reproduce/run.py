"""Run one figure: compute, write, tell."""

from importlib import import_module
from pathlib import Path

import matplotlib as mpl
import torch
from rich.console import Console

from mission.reproduce import ReproduceError
from mission.reproduce.reproduction import Reproduction, write
from mission.style import STYLE


def run(name: str, folder: Path, seed: int, episodes: int | None, console: Console) -> None:
    """Reproduce one of `FIGURES` into a folder, which is made. Raises ReproduceError, OSError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ReproduceError(
            f"--out: {str(folder)!r} cannot be made ({error.strerror}); name a writable folder"
        ) from error
    # More threads only wait for each other on tensors this small, and their number could change the last digits.
    torch.set_num_threads(1)
    with mpl.rc_context(STYLE):
        reproduction: Reproduction = import_module(f"mission.reproduce.{name}").reproduce(seed, episodes)
        written = write(name, reproduction, folder)
    for shown in reproduction.tables:
        console.print(shown)
    console.print(reproduction.note, highlight=False)
    for path in written:
        console.print(f"written: {path}", highlight=False, soft_wrap=True)
