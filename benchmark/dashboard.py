"""The W&B workspace of a project: curves over lambda, causes of failure, episodes, trainings.

python -m benchmark.dashboard
"""

import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from benchmark.settings.command import run_command
from benchmark.settings.config import WandbConfig
from benchmark.settings.setting import SettingError
from benchmark.settings.task import chosen_task

if TYPE_CHECKING:
    from wandb_workspaces.workspaces import Workspace

    from envs.task import Task


@dataclass
class DashboardConfig:
    """Builds the workspace of a W&B project: curves over lambda, causes of failure, episodes, trainings."""

    project: str = WandbConfig.project
    """Project that the runs went to."""
    task: str = "block_push"
    """Whose scores and causes are shown (see benchmark.run)."""
    entity: str = ""
    """User or team of the project; empty for the account's own."""


def main(config: DashboardConfig) -> None:
    """Save the workspace in the project and print where it is."""
    import wandb

    from benchmark.artifacts.wandb_run import PATIENCE

    wandb.setup(wandb.Settings(silent=True))  # Nothing is asked.
    try:
        entity = config.entity or wandb.Api(timeout=PATIENCE).default_entity
        print(workspace(entity, config.project, chosen_task(config.task)).save().url)
    except (wandb.Error, OSError) as error:  # The HTTP clients' errors are OSErrors.
        raise SettingError(
            f"W&B kept no workspace of project={config.project}: {error} It needs a network and an account: make one "
            "at wandb.ai, then give its key to `wandb login` or as WANDB_API_KEY."
        ) from error


def workspace(entity: str, project: str, task: "Task") -> "Workspace":
    """What is drawn from the runs of `benchmark.run`, `benchmark.train` and `benchmark.source_policies`."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # It is written in an older style of pydantic.
        import wandb_workspaces.reports.v2 as panels
        import wandb_workspaces.workspaces as views

    curves = [
        panels.LinePlot(
            title=f"{score}, all policies, with its interval",
            x="lambda",
            y=[f"curve/{score}", f"curve/{score}_low", f"curve/{score}_high"],
            range_y=(0, 1),
        )
        for score in task.score_names
    ]
    differences = [
        panels.LinePlot(title=f"{score} minus direct transfer", x="lambda", y=[f"curve/{score}_difference"])
        for score in task.score_names
    ]
    policies = [
        panels.ScatterPlot(
            title=f"{score}, each policy", x=panels.Config("lambda"), y=panels.SummaryMetric(score), range_y=(0, 1)
        )
        for score in task.score_names
    ]
    causes = panels.BarPlot(
        title="Failed episodes by cause", metrics=[panels.SummaryMetric(f"failed/{cause}") for cause in task.causes]
    )
    training = [
        panels.LinePlot(y=[name])
        for name in ("train/loss", "train/lr", "train/grad_norm", f"validation/{task.ranking[0]}")
    ]
    sections: dict[str, Any] = {
        "Success over lambda": [*curves, *differences],
        "Policies": policies,
        "Failures": [causes],
        "Episodes": [panels.WeavePanelSummaryTable(table_name="episodes"), panels.MediaBrowser(media_keys=["video"])],
        "Training": training,
    }
    return views.Workspace(
        entity=entity,
        project=project,
        name="Policy transfer",
        sections=[views.Section(name=name, panels=shown, is_open=True) for name, shown in sections.items()],
    )


if __name__ == "__main__":
    run_command(main, DashboardConfig, "dashboard")
