"""`aerialstar train`: configs read, progress shown, the outcome told beside what no learning gives."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import ValidationError
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from agent.training_config import TrainingConfig
from mission.yaml_file import YamlError, read_mapping
from rf_model import scenario as scenarios
from rf_model.config_errors import one_line

if TYPE_CHECKING:
    from agent.training import Result


class TrainInputError(ValueError):
    """Something asked for cannot be; one line naming field, value and what is allowed."""


def load_config(path: Path | None, **overrides: int | None) -> TrainingConfig:
    """Hyper-parameters from a YAML file, or the defaults; `overrides` that are not None win.

    Raises TrainInputError.
    """
    try:
        fields = {} if path is None else read_mapping(path, TrainingConfig.model_fields)
    except YamlError as error:
        raise TrainInputError(str(error)) from error
    fields |= {name: value for name, value in overrides.items() if value is not None}
    try:
        return TrainingConfig.model_validate(fields)
    except ValidationError as error:
        source = f"{path}: " if path is not None else ""
        raise TrainInputError(f"{source}{one_line(error, TrainingConfig)}") from error


def learn_online(preset: str, config: TrainingConfig, out: Path, *, resume: bool) -> None:
    """Train in the batched environment of a preset. Raises TrainInputError, ScenarioError, OSError."""
    scenario = scenarios.preset(preset)
    from agent import training  # torch

    _make(out)
    with _bar() as bar:
        task = bar.add_task("training", total=config.episodes, note="")

        def show(progress: training.Progress) -> None:
            bar.start()
            note = f"reward {progress.reward:8.2f}"
            if progress.evaluation is not None:
                bar.console.print(f"{progress.episodes:7d} episodes: evaluated {progress.evaluation}", highlight=False)
            bar.update(task, completed=progress.episodes, note=note)

        try:
            result = training.train(scenario, config, out, resume=resume, report=show)
        except training.TrainingError as error:
            raise TrainInputError(str(error)) from error
    _tell(result)


def learn_offline(runs: list[Path], config: TrainingConfig, out: Path) -> None:
    """Train on what was flown. Raises TrainInputError, FlightLogError, MissionError, OSError."""
    from agent import training
    from agent.offline import OfflineProgress, train_offline
    from mission.transitions import data_set

    scenario, data = data_set(runs)
    _make(out)
    with _bar() as bar:
        task = bar.add_task("training", total=config.clone_updates + config.offline_updates, note="")

        def show(progress: OfflineProgress) -> None:
            bar.start()
            note = f"{'cloning' if progress.cloning else 'DA-DDPG'} loss {progress.loss:.4f}"
            bar.update(task, completed=progress.updates, note=note)

        bar.console.print(f"{len(data.reward)} transitions of {len(runs)} runs", highlight=False)
        try:
            result = train_offline(scenario, config, data, out, report=show)
        except training.TrainingError as error:
            raise TrainInputError(str(error)) from error
    _tell(result)


def _make(out: Path) -> None:
    """Make the output folder before hours are spent. Raises TrainInputError."""
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TrainInputError(
            f"--out: {str(out)!r} cannot be made ({error.strerror}); name a writable folder"
        ) from error


@contextmanager
def _bar() -> Iterator[Progress]:
    """A bar to `start` with the first progress, so that what is refused before that draws none."""
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}"),
    )
    try:
        yield bar
    finally:
        if bar.live.is_started:
            bar.stop()


def _tell(result: "Result") -> None:
    table = Table(title="episode reward in worlds never trained on", title_justify="left")
    table.add_column("policy")
    table.add_column("mean ± 95 %", justify="right")
    for name, evaluation in {"trained": result.trained, **result.baselines}.items():
        table.add_row(name, str(evaluation))
    console = Console()
    console.print(table)
    console.print(f"policy: {result.policy_file}", highlight=False, soft_wrap=True)
